"""Keeps which tags were seen from where, for those who ask afterwards whether the map is right."""

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import Observations

if TYPE_CHECKING:
    from tagvo.pipeline import Trace

_EVERY_NS = 100_000_000  # between frames that are kept: nearer ones say the same again
_MOST = 1200  # frames; beyond, every second one is dropped


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """m sightings of tags in f frames.

    frame (m,) which frame, row (m,) which tag of the map; corners_n (m, 4, 2), J_px_n (m, 4, 2, 2),
    sigma_px (m, 4) as in Observations; t_ns (f,), R_WC (f, 3, 3), p_WC (f, 3): cameras as measured.
    seen, rejected: by tag id, in how many frames; rejected: the joint pose gave it little weight.
    """

    frame: IntArray
    row: IntArray
    corners_n: Array
    J_px_n: Array
    sigma_px: Array
    t_ns: IntArray
    R_WC: Array
    p_WC: Array
    seen: Counter[int]
    rejected: Counter[int]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True, slots=True, eq=False)
class Kept:
    """A frame: its stamp, the camera as measured, its tags, and which (n,) were rejected."""

    t_ns: int
    R_WC: Array
    p_WC: Array
    seen: Observations
    rejected: BoolArray


class SightingBook:
    """Owns the frames that were kept; `note` takes each trace of a run."""

    def __init__(self, reject_weight: float) -> None:
        """reject_weight: below it, a tag counts as rejected by the joint pose."""
        self._reject = reject_weight
        self._kept: list[Kept] = []
        self._every_ns = _EVERY_NS
        self._seen: Counter[int] = Counter()
        self._rejected: Counter[int] = Counter()

    def note(self, trace: "Trace") -> None:
        """Take a frame; one without a pose says nothing about its tags."""
        pose, seen = trace.pose, trace.observations
        if pose is None:
            return
        self._seen.update(seen.tag_id.tolist())
        out = trace.rejected(self._reject)
        self._rejected.update(seen.tag_id[out].tolist())
        if self._kept and 0 <= trace.t_ns - self._kept[-1].t_ns < self._every_ns:
            return
        self._kept.append(Kept(trace.t_ns, pose.R_WC, pose.p_WC, seen, out))
        if len(self._kept) > _MOST:
            self._kept = self._kept[::2]
            self._every_ns *= 2

    def sightings(self) -> Sightings | None:
        """All that was kept; None where nothing was."""
        if not self._kept:
            return None
        all_seen = [kept.seen for kept in self._kept]
        counts = [len(seen) for seen in all_seen]
        return Sightings(
            np.repeat(np.arange(len(counts)), counts),
            np.concatenate([seen.row for seen in all_seen]),
            np.concatenate([seen.corners_n for seen in all_seen]),
            np.concatenate([seen.J_px_n for seen in all_seen]),
            np.concatenate([seen.sigma_px for seen in all_seen]),
            np.array([kept.t_ns for kept in self._kept], dtype=np.int64),
            np.stack([kept.R_WC for kept in self._kept]),
            np.stack([kept.p_WC for kept in self._kept]),
            self._seen,
            self._rejected,
        )

    def nearest(self, t_ns: int) -> Kept | None:
        """The kept frame nearest to a stamp; None where nothing was kept."""
        return min(self._kept, key=lambda kept: abs(kept.t_ns - t_ns), default=None)
