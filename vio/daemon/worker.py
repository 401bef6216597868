"""Looks for tags in a thread of its own: the filter's loop takes IMU samples meanwhile.

Detector and tracker are compiled and let other threads run; what comes after takes a millisecond
and is done by the loop, from corners alone, so that a recording of the corners replays to the same
bits.
"""

import logging
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tagvo.errors import TagvoError
from tagvo.pipeline import TagVO
from tagvo.records import Frame, PosePrior
from vio.sources.live_camera import Latest
from vio.stopwatch import Stopwatch

LOG = logging.getLogger("vio.daemon")
_KEEP = 900  # frames whose time is remembered


class Detection:
    """Takes the newest image, hands on the frame with its tags; `watch` times it."""

    def __init__(
        self,
        latest: Latest,
        vo: TagVO,
        hand_on: Callable[[Frame], None],
        prior: Callable[[int], PosePrior | None] = lambda t_ns: None,
    ) -> None:
        """prior: where the camera should be at a stamp, for tracking; asked in this thread."""
        self._latest, self._vo, self._hand_on, self._prior = latest, vo, hand_on, prior
        self.watch = Stopwatch(_KEEP)
        self.counters: Counter[str] = Counter()
        self._thread = threading.Thread(target=self._live, name="detection", daemon=True)

    def start(self) -> None:
        """Make the detector ready by a grey image, so that the first frame does not wait; begin."""
        width, height = self._vo.camera.resolution
        self._vo.detect(Frame(0, np.full((height, width), 128, dtype=np.uint8)))
        self._thread.start()

    def join(self, timeout_s: float | None = None) -> None:
        """Wait until all is done, once the queue is closed."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)

    def _live(self) -> None:
        while (frame := self._latest.take()) is not None:
            try:
                self.watch.start()
                found, how = self._vo.find(frame, self._prior(frame.t_ns))
                self.watch.lap("detect")
            except TagvoError as err:
                self._count("detection_refused", str(err))
            except Exception:
                LOG.exception("detection goes on after a fault")
                self.counters["detection_faults"] += 1
            else:
                self.counters.update({"detected": 1, **how})
                self._hand_on(replace(frame, detections=found))

    def _count(self, what: str, text: str) -> None:
        if not self.counters[what]:
            LOG.warning("%s", text)
        self.counters[what] += 1
