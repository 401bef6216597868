"""Truth made fit to judge by: bad rows dropped and counted, interpolated, velocity derived."""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from vio.errors import EvaluationError
from vio.evaluate.records import MAX_GAP_NS, TruthLike

SNAP_NS = 1_000  # a stamp this near to truth's own needs no interpolation (stamps get rounded)
VELOCITY_GAP_NS = 60_000_000  # wider than this, differences of positions are no velocity
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class TruthTrack:
    """Usable truth, stamps strictly ascending, n rows.

    t_ns (n,); p_WI (n, 3) [m]; q_WI (n, 4) wxyz; v_WI (n, 3) [m/s], NaN where it is not known;
    bad, repeated, backward: rows of the file that hold no pose, whose stamp stood before, whose
    stamp is older than that of the row above (those are sorted in).
    """

    t_ns: IntArray
    p_WI: Array
    q_WI: Array
    v_WI: Array
    bad: int
    repeated: int
    backward: int

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def R_WI(self) -> Array:
        """Rotations (n, 3, 3)."""
        return geo.matrix_from_quat(self.q_WI)


@dataclass(frozen=True, slots=True, eq=False)
class TruthAt:
    """Truth at m asked-for moments: known (m,); p_WI, R_WI, v_WI as in TruthTrack."""

    known: BoolArray
    p_WI: Array
    R_WI: Array
    v_WI: Array


def clean_truth(truth: TruthLike) -> TruthTrack:
    """Truth sorted by stamp without bad and repeated rows; of equal stamps the first row stays."""
    norm = np.linalg.norm(truth.q_WI, axis=-1)
    with np.errstate(invalid="ignore"):
        good = np.isfinite(truth.p_WI).all(axis=-1) & (np.abs(norm - 1.0) <= _UNIT_TOLERANCE)
    rows = np.flatnonzero(good)
    if len(rows) == 0:
        raise EvaluationError(
            f"truth: none of {len(good)} rows holds a pose; finite positions and unit quaternions"
            " are needed"
        )
    backward = int(np.sum(np.diff(truth.t_ns[rows]) < 0))
    t_ns, first = np.unique(truth.t_ns[rows], return_index=True)
    kept = rows[first]
    p_WI = np.asarray(truth.p_WI[kept], dtype=float)
    v_WI = None if truth.v_WI is None else np.asarray(truth.v_WI[kept], dtype=float)
    return TruthTrack(
        t_ns,
        p_WI,
        np.asarray(truth.q_WI[kept] / norm[kept, None], dtype=float),
        differentiate(t_ns, p_WI) if v_WI is None or not np.isfinite(v_WI).any() else v_WI,
        bad=len(good) - len(rows),
        repeated=len(rows) - len(kept),
        backward=backward,
    )


def differentiate(t_ns: IntArray, p: Array, max_step_ns: int = VELOCITY_GAP_NS) -> Array:
    """Velocity by central differences (second order at uneven steps); (n,), (n, 3) -> (n, 3).

    NaN at both ends and where a neighbour is further away than `max_step_ns`.
    """
    v = np.full(p.shape, np.nan)
    if len(t_ns) < 3:
        return v
    steps = np.diff(t_ns)
    before, after = steps[:-1, None] * 1e-9, steps[1:, None] * 1e-9
    slope = np.diff(p, axis=0) / (steps[:, None] * 1e-9)
    central = (slope[:-1] * after + slope[1:] * before) / (before + after)
    near = (steps[:-1] <= max_step_ns) & (steps[1:] <= max_step_ns)
    v[1:-1] = np.where(near[:, None], central, np.nan)
    return v


def interpolate(truth: TruthTrack, t_ns: IntArray, max_gap_ns: int = MAX_GAP_NS) -> TruthAt:
    """Truth at stamps (m,): linear position and velocity, slerp; never beyond its ends.

    Known where the rows on both sides are at most `max_gap_ns` apart, or at a row's own stamp.
    """
    last = len(truth) - 1
    left = np.clip(np.searchsorted(truth.t_ns, t_ns, side="right") - 1, 0, last)
    right = np.minimum(left + 1, last)
    t0, t1 = truth.t_ns[left], truth.t_ns[right]
    gap = t1 - t0
    inside = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
    at_row = np.minimum(np.abs(t_ns - t0), np.abs(t_ns - t1)) <= SNAP_NS
    share = np.clip((t_ns - t0) / np.maximum(gap, 1), 0.0, 1.0)[:, None]
    R0 = geo.matrix_from_quat(truth.q_WI[left])
    conjugate = geo.conjugate_quat(truth.q_WI[left])
    turn = geo.log_quat(geo.multiply_quat(conjugate, truth.q_WI[right]))
    return TruthAt(
        (inside & (gap <= max_gap_ns)) | at_row,
        _mix(truth.p_WI[left], truth.p_WI[right], share),
        R0 @ geo.exp(share * turn),
        _mix(truth.v_WI[left], truth.v_WI[right], share),
    )


def _mix(a: Array, b: Array, share: Array) -> Array:
    """(1 - share) a + share b, where a NaN counts only if its share does; (m, 3), (m, 1)."""
    mixed = (1.0 - share) * a + share * b
    return np.where(share == 0.0, a, np.where(share == 1.0, b, mixed))
