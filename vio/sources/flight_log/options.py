"""How to read a flight log: which frames, which tags, how late; checked before anything is read."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tagvo.geometry import BoolArray, IntArray
from vio.errors import LogError


@dataclass(frozen=True, slots=True)
class LogOptions:
    """The options of `tagvio run` that concern the log; LogError where one is out of range.

    imu: folder below mav0; use_detections: corners in place of images; only_tags: ids to keep,
    None: all; every: each N-th frame; blackout: (period, length) [s]; latency_s: every frame is
    known that much after its stamp, 0: as the log says.
    """

    imu: str = "imu0"
    use_detections: bool = False
    only_tags: tuple[int, ...] | None = None
    every: int = 1
    blackout: tuple[float, float] | None = None
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        if self.every < 1:
            raise LogError(f"--every: {self.every}; a whole number of at least 1 is needed")
        if not 0.0 <= self.latency_s < 1e6:
            raise LogError(f"--latency: {self.latency_s}; a number of seconds from 0 is needed")
        if self.only_tags is not None and not self.only_tags:
            raise LogError("--only-tags: the list is empty; at least one tag id is needed")
        if self.blackout is not None:
            period, length = self.blackout
            if not (math.isfinite(period) and 0.0 <= length <= period and period >= 1e-3):
                raise LogError(
                    f"--blackout: {period},{length}; PERIOD,LENGTH in seconds with"
                    " 0 <= LENGTH <= PERIOD, PERIOD at least 0.001 are needed"
                )

    @property
    def latency_ns(self) -> int:
        """The latency in whole nanoseconds."""
        return round(self.latency_s * 1e9)

    def shown(self, t_ns: IntArray, t0_ns: int) -> BoolArray:
        """Which stamps (n,) are outside the blackout, time counted from t0_ns; (n,)."""
        if self.blackout is None:
            return np.ones(len(t_ns), dtype=bool)
        period, length = (round(s * 1e9) for s in self.blackout)
        return np.asarray((t_ns - t0_ns) % period >= length)


def only_tags_of(ids: Sequence[int] | None) -> tuple[int, ...] | None:
    """Tag ids, each once, in the order given; None stays None."""
    return None if ids is None else tuple(dict.fromkeys(ids))
