"""Judges one trajectory against truth: at each pose's own moment, and as it was known live."""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from vio.evaluate.records import MAX_GAP_NS, Errors, Trajectory, Window, take
from vio.evaluate.truth import TruthAt, TruthTrack, interpolate

Stats = dict[str, float | int | None]

_POSITION = ("rmse", "mean", "median", "std", "p95", "max")
_ROTATION = ("rmse", "mean", "median", "std")
_MIN_DETERMINANT = 1e-14  # of a correlation matrix: below, a covariance cannot be inverted


def capture_errors(trajectory: Trajectory, truth: TruthTrack, window: Window) -> Errors:
    """Errors of each pose in the window at its own capture time, where truth is known there.

    Coverage: share of truth stamps with a pose captured within half of the longest gap (0.05 s).
    """
    inside = take(trajectory, window.holds(trajectory.t_ns))
    at = interpolate(truth, inside.t_ns)
    stamps = truth.t_ns[window.holds(truth.t_ns)]
    near = _distance_ns(np.sort(trajectory.t_ns), stamps) <= MAX_GAP_NS // 2
    return _errors(take(inside, at.known), _only(at, at.known), _share(near))


def now_errors(trajectory: Trajectory, truth: TruthTrack, window: Window) -> Errors:
    """Errors at each truth stamp in the window of the last output that had arrived by then.

    The last output is held, however old; coverage: share of truth stamps with any.
    """
    order = np.argsort(trajectory.known_ns, kind="stable")
    rows = np.flatnonzero(window.holds(truth.t_ns))
    last = np.searchsorted(trajectory.known_ns[order], truth.t_ns[rows], side="right") - 1
    known = last >= 0
    rows, output = rows[known], order[last[known]]
    held = take(trajectory, output)
    R_WI = geo.matrix_from_quat(truth.q_WI[rows])
    at = TruthAt(np.ones(len(rows), dtype=bool), truth.p_WI[rows], R_WI, truth.v_WI[rows])
    return _errors(held, at, _share(known), truth.t_ns[rows])


def stats(errors: Errors) -> Stats:
    """The contract's STATS of one view; None where a figure cannot be had."""
    position = np.linalg.norm(errors.p_W, axis=-1)
    rotation = np.degrees(np.linalg.norm(errors.rotation_I, axis=-1))
    out: Stats = {f"position_{k}_m": v for k, v in summary(position, _POSITION).items()}
    out |= {f"rotation_{k}_deg": v for k, v in summary(rotation, _ROTATION).items()}
    out["velocity_rmse_m_s"] = None if errors.v_W is None else _velocity_rmse(errors.v_W)
    out["nees_pose"] = None if errors.cov is None else _mean_or_none(nees(errors) / 6.0)
    out["coverage"] = errors.coverage
    out["n"] = len(errors)
    return out


def nees(errors: Errors) -> Array:
    """e^T P^-1 e over the 6 degrees of freedom, NaN where P is no covariance; (m,)."""
    if errors.cov is None:
        return np.full(len(errors), np.nan)
    out = np.full(len(errors), np.nan)
    variance = np.diagonal(errors.cov, axis1=-2, axis2=-1)
    usable = np.isfinite(errors.cov).all((-2, -1)) & (variance > 0.0).all(axis=-1)
    sigma = np.sqrt(variance[usable])
    correlation = errors.cov[usable] / (sigma[:, :, None] * sigma[:, None, :])
    e = np.concatenate([errors.p_W, errors.rotation_I], axis=-1)[usable] / sigma
    regular = np.linalg.det(correlation) > _MIN_DETERMINANT
    rows = np.flatnonzero(usable)[regular]
    solved = np.linalg.solve(correlation[regular], e[regular, :, None])[..., 0]
    out[rows] = np.einsum("ni,ni->n", e[regular], solved)
    return np.where(out >= 0.0, out, np.nan)


def summary(x: Array, names: tuple[str, ...]) -> dict[str, float | None]:
    """Figures of a sample (n,) by name: rmse, mean, median, std (population), p95, max."""
    if len(x) == 0:
        return dict.fromkeys(names)
    figures = {
        "rmse": np.sqrt(np.mean(x * x)),
        "mean": np.mean(x),
        "median": np.median(x),
        "std": np.std(x),
        "p95": np.percentile(x, 95.0),
        "max": np.max(x),
    }
    return {name: float(figures[name]) for name in names}


def _errors(
    outputs: Trajectory, at: TruthAt, coverage: float | None, t_ns: IntArray | None = None
) -> Errors:
    return Errors(
        outputs.t_ns if t_ns is None else t_ns,
        outputs.p_WI - at.p_WI,
        geo.log(np.swapaxes(at.R_WI, -1, -2) @ outputs.R_WI),
        None if outputs.v_WI is None else outputs.v_WI - at.v_WI,
        outputs.cov,
        coverage,
    )


def _only(at: TruthAt, rows: BoolArray) -> TruthAt:
    return TruthAt(at.known[rows], at.p_WI[rows], at.R_WI[rows], at.v_WI[rows])


def _distance_ns(ascending: IntArray, t_ns: IntArray) -> IntArray:
    """Distance of each stamp (m,) to the nearest of the ascending ones (n,) [ns]."""
    if len(ascending) == 0:
        return np.full(len(t_ns), np.iinfo(np.int64).max)
    right = np.minimum(np.searchsorted(ascending, t_ns), len(ascending) - 1)
    left = np.maximum(right - 1, 0)
    distances = np.abs(ascending[np.stack([left, right])] - t_ns)
    return np.asarray(distances.min(axis=0))


def _share(mask: BoolArray) -> float | None:
    return float(mask.mean()) if len(mask) else None


def _velocity_rmse(v: Array) -> float | None:
    squared = np.einsum("ni,ni->n", v, v)
    mean = _mean_or_none(squared)
    return None if mean is None else float(np.sqrt(mean))


def _mean_or_none(x: Array) -> float | None:
    known = x[np.isfinite(x)]
    return float(known.mean()) if len(known) else None
