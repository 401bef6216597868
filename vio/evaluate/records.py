"""The records that the judges pass on: what an estimator said, when, and how far off it was."""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray

MAX_GAP_NS = 100_000_000  # truth is interpolated over gaps of at most this


class TruthLike(Protocol):
    """Truth as a log holds it: t_ns (n,), p_WI (n, 3) [m], q_WI (n, 4) wxyz, v_WI (n, 3) or None.

    Rows may be unusable (NaN), repeated or out of order; `clean_truth` sorts that out.
    """

    @property
    def t_ns(self) -> IntArray: ...
    @property
    def p_WI(self) -> Array: ...
    @property
    def q_WI(self) -> Array: ...
    @property
    def v_WI(self) -> Array | None: ...


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """The outputs of one estimator, n rows.

    t_ns (n,) the moment a pose is for (capture time); known_ns (n,) when it was known (arrival);
    p_WI (n, 3) [m]; R_WI (n, 3, 3); v_WI (n, 3) [m/s] or None; cov (n, 6, 6) of [p in W, right
    rotation in I] [m^2, rad^2] or None.
    """

    name: str
    t_ns: IntArray
    known_ns: IntArray
    p_WI: Array
    R_WI: Array
    v_WI: Array | None = None
    cov: Array | None = None

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class Window:
    """The part of a log that is judged, both ends included; None: open."""

    t_start_ns: int | None = None
    t_end_ns: int | None = None

    def holds(self, t_ns: IntArray) -> BoolArray:
        """Which stamps lie in the window; (n,) -> (n,)."""
        keep = np.ones(len(t_ns), dtype=bool)
        if self.t_start_ns is not None:
            keep &= t_ns >= self.t_start_ns
        if self.t_end_ns is not None:
            keep &= t_ns <= self.t_end_ns
        return keep


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Estimate minus truth at m moments, one view of one estimator.

    t_ns (m,); p_W (m, 3) [m]; rotation_I (m, 3) = Log(R_truth^T R_estimate) [rad]; v_W (m, 3)
    [m/s], NaN where truth's is not known, or None; cov (m, 6, 6) as in `Trajectory`, or None;
    coverage: share of truth stamps with an output, None where there are no truth stamps.
    """

    t_ns: IntArray
    p_W: Array
    rotation_I: Array
    v_W: Array | None
    cov: Array | None
    coverage: float | None

    def __len__(self) -> int:
        return len(self.t_ns)


def take(trajectory: Trajectory, rows: BoolArray | IntArray) -> Trajectory:
    """The chosen outputs of a trajectory; rows: mask (n,) or indices (k,)."""
    v, cov = trajectory.v_WI, trajectory.cov
    return replace(
        trajectory,
        t_ns=trajectory.t_ns[rows],
        known_ns=trajectory.known_ns[rows],
        p_WI=trajectory.p_WI[rows],
        R_WI=trajectory.R_WI[rows],
        v_WI=None if v is None else v[rows],
        cov=None if cov is None else cov[rows],
    )


def only_finite(trajectory: Trajectory) -> Trajectory:
    """The outputs whose pose holds numbers only."""
    numbers = np.isfinite(trajectory.p_WI).all(axis=-1)
    numbers = numbers & np.isfinite(trajectory.R_WI).all(axis=(-2, -1))
    return trajectory if numbers.all() else take(trajectory, np.flatnonzero(numbers))
