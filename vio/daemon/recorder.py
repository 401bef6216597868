"""Writes the flight log while it flies, in a thread of its own that nothing waits for.

Rows reach the kernel at once (a killed program loses none), the disk at every sync (a power cut
loses what came since). Where the disk is full or fails, recording ends and the flight goes on.
"""

import json
import logging
import os
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

from tagvo import geometry as geo
from tagvo.records import Frame
from vio.config.daemon import RecordConfig
from vio.filter.health import Health
from vio.mavlink.messages import Outgoing
from vio.records import Ground, ImuSample, NavState
from vio.sinks.log_writer import LogWriter
from vio.sinks.tum import tum_line

LOG = logging.getLogger("vio.record")
_MOST_JOBS, _MOST_IMAGES = 20_000, 30  # waiting for the disk
_HEALTH_EVERY_NS = 1_000_000_000
_HEALTH = "#timestamp [ns],state,reasons,resets,sigma_m,sigma_deg,age_s"
_SENT = {"VISION_POSITION_ESTIMATE", "ODOMETRY", "VISION_SPEED_ESTIMATE", "STATUSTEXT"}
Job = Callable[[], None]


class Recorder:
    """A sink of the run, and of what is sent; `stopped`: why it records no more, None: it does.

    mav0/ holds what came in, in the order of arrival; flown/ what went out: vo.tum and vio.tum as
    the offline run writes them, health.csv, sent.jsonl.
    """

    def __init__(
        self,
        writer: LogWriter,
        config: RecordConfig,
        say: Callable[[str, bool], None] = lambda text, bad: None,
    ) -> None:
        self._writer, self._config, self._say = writer, config, say
        self._jobs: queue.Queue[Job | None] = queue.Queue()
        self._images = self._frames = 0
        self._last_t: dict[str, int] = {}
        self._last_health: tuple[int, Any] | None = None
        self.stopped: str | None = None
        self.counters: Counter[str] = Counter()
        self._thread = threading.Thread(target=self._live, name="recorder", daemon=True)

    @property
    def path(self) -> str:
        """The folder that it records to."""
        return str(self._writer.path)

    def start(self) -> None:
        """Begin to write."""
        self._thread.start()

    def stop(self, timeout_s: float = 0.6) -> None:
        """Write what waits, for so long at most, and close."""
        self._jobs.put(None)
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    # what comes in and goes out, from any thread

    def event(self, event: ImuSample | Frame | Ground) -> None:
        """Record an event that the run takes."""
        if isinstance(event, ImuSample):
            self._put(lambda: self._writer.imu(event))
        elif isinstance(event, Ground):
            self._put(lambda: self._writer.ground(event))
        else:
            self._put_frame(event)

    def _put_frame(self, frame: Frame) -> None:
        every, k = self._config.images_every, self._frames
        self._frames += 1
        wanted = frame.image is not None and every > 0 and k % every == 0
        if wanted and self._images >= _MOST_IMAGES:
            self.counters["record_images_dropped"] += 1
            wanted = False
        if not wanted:
            frame = replace(frame, image=None)
            self._put(lambda: self._writer.frame(frame))
            return
        self._images += 1

        def write() -> None:
            self._images -= 1
            self._writer.frame(frame)

        self._put(write)

    def output(self, name: str, output: NavState) -> None:
        """Record an estimator's word; at one stamp the first counts, as in a run."""
        if self._last_t.get(name) == output.t_ns:
            return
        self._last_t[name] = output.t_ns

        def write() -> None:
            line = tum_line(output.t_ns, output.p_WI, geo.quat_from_matrix(output.R_WI))
            self._writer.line(f"flown/{name}.tum", line)

        self._put(write)

    def health(self, t_ns: int, health: Health) -> None:
        """Record the filter's health where it changes, and once a second."""
        now = (health.state, health.reasons, health.resets)
        last = self._last_health
        if last is not None and last[1] == now and t_ns - last[0] < _HEALTH_EVERY_NS:
            return
        self._last_health = (t_ns, now)
        s = health.signs
        figures = ",," if s is None else f"{s.sigma_m:.6f},{s.sigma_deg:.6f},{s.age_s:.3f}"
        row = f"{t_ns},{health.state.value},{' '.join(health.reasons)},{health.resets},{figures}"
        self._put(lambda: self._writer.line("flown/health.csv", row, _HEALTH))

    def sent(self, message: Outgoing, now_ns: int) -> None:
        """Record a pose or a text that has left."""
        if message.name in _SENT:
            self._put(lambda: self._write_sent(message, now_ns))

    def _write_sent(self, message: Outgoing, now_ns: int) -> None:
        row = {"sent_ns": now_ns, "name": message.name, **message.fields}
        self._writer.line("flown/sent.jsonl", json.dumps(row, default=_plain))

    def _put(self, job: Job) -> None:
        if self.stopped is not None:
            return
        if self._jobs.qsize() >= _MOST_JOBS:
            if not self.counters["record_rows_dropped"]:
                LOG.warning("%s: the disk is too slow, rows are lost", self.path)
            self.counters["record_rows_dropped"] += 1
            return
        self._jobs.put(job)

    # the recorder's thread

    def _live(self) -> None:
        synced = time.monotonic()
        while self.stopped is None:
            job = self._jobs.get()
            if job is None:
                break
            try:
                job()
                if time.monotonic() - synced > self._config.sync_s:
                    self._writer.sync()
                    synced = time.monotonic()
                    self._check_space()
            except OSError as err:
                self._give_up(err.strerror or str(err))
            except Exception:
                LOG.exception("recording goes on after a fault")
                self.counters["record_faults"] += 1
        with suppress(OSError):
            self._writer.close()

    def _check_space(self) -> None:
        disk = os.statvfs(self._writer.path)
        free_mb = disk.f_bavail * disk.f_frsize / 1e6
        if free_mb < self._config.min_free_mb:
            self._give_up(f"{free_mb:.0f} MB are free, less than min_free_mb")

    def _give_up(self, why: str) -> None:
        self.stopped = why
        self.counters["record_stopped"] += 1
        LOG.warning("%s: %s; recording has ended, the flight goes on", self.path, why)
        self._say("recording ended: disk", True)


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as JSON's own."""
    return value.tolist() if hasattr(value, "tolist") else str(value)
