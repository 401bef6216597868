"""Live events in the order in which they became known: threads put them in, one loop takes them.

Each is stamped with its arrival as it goes in, later than the one before: who records the stamps
can run the same events again in the same order.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from dataclasses import replace

from tagvo.records import Frame
from vio.records import Ground, ImuSample

Event = ImuSample | Frame | Ground
_MOST_IMU, _MOST_FRAMES = 2000, 3
_FIRST_FRAMES = 15  # before the loop takes anything: a filter starts from 0.4 s of them, at 30 Hz
_LOOK_S = 0.1  # how often who waits asks whether to stop


class LiveEvents:
    """A bounded queue; what overflows is dropped, oldest first of its kind, and counted.

    Where the loop is slow, frames go before IMU samples do: a filter can miss frames.
    """

    def __init__(
        self, stop: Callable[[], bool], now_ns: Callable[[], int] = time.monotonic_ns
    ) -> None:
        """stop: true ends the iteration; now_ns: the clock in which events arrive."""
        self._stop, self._now_ns = stop, now_ns
        self._ready = threading.Condition()
        self._events: deque[Event] = deque()
        self._count: Counter[type] = Counter()
        self._before_ns = -(1 << 62)
        self._closed = self._taken = False
        self.counters: Counter[str] = Counter()

    def put(self, event: Event) -> None:
        """Add an event; it arrives now."""
        with self._ready:
            self._before_ns = max(self._now_ns(), self._before_ns + 1)
            self._events.append(replace(event, arrival_ns=self._before_ns))
            kind = type(event)
            self._count[kind] += 1
            most = self._most_frames if kind is Frame else _MOST_IMU
            if self._count[kind] > most:
                self._drop_oldest(kind)
            self._ready.notify()

    @property
    def _most_frames(self) -> int:
        return _MOST_FRAMES if self._taken else _FIRST_FRAMES

    def _drop_oldest(self, kind: type) -> None:
        for i, event in enumerate(self._events):
            if type(event) is kind:
                del self._events[i]
                self._count[kind] -= 1
                self.counters["queue_dropped_" + ("frames" if kind is Frame else "imu")] += 1
                return

    def close(self) -> None:
        """No more events will come; those that are there are still taken."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()

    def __len__(self) -> int:
        return len(self._events)

    def __iter__(self) -> Iterator[Event]:
        while True:
            with self._ready:
                while not self._events:
                    if self._closed or self._stop():
                        return
                    self._ready.wait(_LOOK_S)
                self._taken = True
                event = self._events.popleft()
                self._count[type(event)] -= 1
            yield event
