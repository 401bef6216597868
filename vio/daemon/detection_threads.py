"""Looks for tags in threads of its own: the filter's loop takes IMU samples meanwhile.

Detector and tracker are compiled and let other threads run; what comes after takes a millisecond
and is done by the loop, from corners alone, so that a recording of the corners replays to the same
bits.
"""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tagvo.errors import TagvoError
from tagvo.pipeline import TagVO
from tagvo.records import Frame, PosePrior
from vio.localize.stopwatch import Stopwatch
from vio.sources.live.live_camera import Latest

LOG = logging.getLogger("vio.daemon")
_KEEP = 900  # frames whose time is remembered


class Detection:
    """Takes the newest image, hands on the frame with its tags; `watch` times it.

    Each of several `vos` works in a thread of its own; a frame that a later one has overtaken is
    dropped and counted, so that what is handed on never goes back.
    """

    def __init__(
        self,
        latest: Latest,
        vos: Sequence[TagVO],
        hand_on: Callable[[Frame], None],
        prior: Callable[[int], PosePrior | None] = lambda t_ns: None,
    ) -> None:
        """prior: where the camera should be at a stamp, for tracking; asked in these threads."""
        self._latest, self._vos, self._hand_on, self._prior = latest, vos, hand_on, prior
        self.watch = Stopwatch(_KEEP)
        self.counters: Counter[str] = Counter()
        self._turn, self._word = threading.Lock(), threading.Lock()  # to take; to hand on
        self._taken = self._handed = 0
        names = ("detection" if k == 0 else f"detection {k + 1}" for k in range(len(vos)))
        self._threads = [
            threading.Thread(target=self._live, args=(vo,), name=name, daemon=True)
            for vo, name in zip(vos, names, strict=True)
        ]

    def start(self) -> None:
        """Make detectors ready by a grey image, so that the first frame does not wait; begin."""
        for vo in self._vos:
            width, height = vo.camera.resolution
            vo.detect(Frame(0, np.full((height, width), 128, dtype=np.uint8)))
        for thread in self._threads:
            thread.start()

    def join(self, timeout_s: float | None = None) -> None:
        """Wait until all is done, once the queue is closed."""
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(timeout_s)

    def _take(self) -> tuple[int, Frame | None]:
        with self._turn:
            frame = self._latest.take()
            self._taken += 1
            return self._taken, frame

    def _live(self, vo: TagVO) -> None:
        while True:
            number, frame = self._take()
            if frame is None:
                return
            start = time.perf_counter_ns()
            try:
                found, how = vo.find(frame, self._prior(frame.t_ns))
            except TagvoError as err:
                self._refused(str(err))
            except Exception:
                LOG.exception("detection goes on after a fault")
                with self._word:
                    self.counters["detection_faults"] += 1
            else:
                took_ns = time.perf_counter_ns() - start
                self._found(number, replace(frame, detections=found), how, took_ns)

    def _found(self, number: int, frame: Frame, how: dict[str, int], took_ns: int) -> None:
        with self._word:
            self.watch.add("detect", took_ns)
            self.counters.update({"detected": 1, **how})
            if number < self._handed:
                self.counters["detection_overtaken"] += 1
                return
            self._handed = number
            self._hand_on(frame)

    def _refused(self, text: str) -> None:
        with self._word:
            if not self.counters["detection_refused"]:
                LOG.warning("%s", text)
            self.counters["detection_refused"] += 1
