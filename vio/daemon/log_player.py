"""Plays a log in real time into the daemon's queues, as its camera and IMU gave it."""

import queue
import threading
import time
from collections.abc import Callable

from tagvo.records import Frame
from vio.daemon.latency_meter import Meter
from vio.daemon.time_base import FlightClock
from vio.sources.flight_log.log import Event, FlightLog
from vio.sources.live.events import LiveEvents
from vio.sources.live.live_camera import Latest

_AHEAD = 64  # events read ahead, images decoded


class Player:
    """Two threads: one reads ahead, one hands each event over when its time comes."""

    def __init__(
        self,
        log: FlightLog,
        events: LiveEvents,
        latest: Latest,
        meter: Meter,
        each_frame: Callable[[], None],
    ) -> None:
        self._log, self._events, self._latest = log, events, latest
        self._meter, self._each_frame = meter, each_frame
        self._ahead: queue.Queue[tuple[int, Event] | None] = queue.Queue(_AHEAD)
        self._stop = threading.Event()
        self._clock = FlightClock()
        self.imu = self.frames = 0
        self.ended = threading.Event()
        self._threads = [
            threading.Thread(target=self._read, name="reader", daemon=True),
            threading.Thread(target=self._play, name="player", daemon=True),
        ]

    def start(self, clock: FlightClock) -> None:
        """Begin; clock: when what is in the log happens."""
        self._clock = clock
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End before the log does."""
        self._stop.set()

    def _read(self) -> None:
        try:
            for item in self._log.as_received():
                if self._stop.is_set():
                    return
                self._hold(item)
        finally:
            self._hold(None)

    def _hold(self, item: tuple[int, Event] | None) -> None:
        while not self._stop.is_set():
            try:
                self._ahead.put(item, timeout=0.2)
                return
            except queue.Full:
                continue

    def _play(self) -> None:
        try:
            while not self._stop.is_set():
                item = self._ahead.get()
                if item is None:
                    break
                self._wait(self._clock.to_now(item[0]))
                self._hand_on(*item)
        finally:
            self.ended.set()
            self._latest.close()

    def _wait(self, due_ns: int) -> None:
        left = (due_ns - time.monotonic_ns()) * 1e-9
        if left > 0.0:
            self._stop.wait(left)

    def _hand_on(self, received_ns: int, event: Event) -> None:
        if not isinstance(event, Frame):
            self.imu += 1
            self._events.put(event)
            return
        self.frames += 1
        now = time.monotonic_ns()
        stamp = self._clock.to_now(event.t_ns)
        way = self._clock.to_now(received_ns) - stamp  # from the capture to here
        self._meter.frame(stamp, now, now - way)
        if event.detections is None:
            self._latest.put(event)
        else:
            self._events.put(event)
        self._each_frame()
