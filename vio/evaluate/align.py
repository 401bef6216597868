"""Moves an estimate into truth's frame before it is judged: not at all, by a yaw, or rigidly."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tagvo import geometry as geo
from tagvo.errors import choose_one_of
from tagvo.geometry import Array
from vio.errors import EvaluationError
from vio.evaluate.records import Trajectory

Z_AXIS = (0.0, 0.0, 1.0)
_FLAT = 1e-12  # share of the spread below which a direction counts as not moved in


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Pose of the estimate's own world E in W: R_WE (3, 3), p_WE (3,) [m]."""

    R_WE: Array
    p_WE: Array


def identity(p_E: Array, p_W: Array, axis_W: Array) -> Alignment:
    """No alignment at all, whatever the points."""
    return Alignment(np.eye(3), np.zeros(3))


def yaw(p_E: Array, p_W: Array, axis_W: Array) -> Alignment:
    """Least-squares turn about axis_W (3,) and shift that bring points p_E (n, 3) onto p_W."""
    axis = axis_W / np.linalg.norm(axis_W)
    a, b = p_E - p_E.mean(axis=0), p_W - p_W.mean(axis=0)
    a, b = a - np.outer(a @ axis, axis), b - np.outer(b @ axis, axis)
    sine, cosine = float(np.sum(np.cross(a, b) @ axis)), float(np.sum(a * b))
    if np.hypot(sine, cosine) <= _FLAT * max(float(np.sum(p_E**2)), float(np.sum(p_W**2))):
        raise EvaluationError(_too_flat("yaw", len(p_E), "two places beside each other"))
    return _shifted(geo.exp(np.arctan2(sine, cosine) * axis), p_E, p_W)


def se3(p_E: Array, p_W: Array, axis_W: Array) -> Alignment:
    """Least-squares rotation and shift (Umeyama, no scale) of points p_E (n, 3) onto p_W."""
    a, b = p_E - p_E.mean(axis=0), p_W - p_W.mean(axis=0)
    spread = b.T @ a
    scale = np.linalg.svd(spread, compute_uv=False)
    if scale[1] <= _FLAT * max(scale[0], float(np.sum(p_E**2)), float(np.sum(p_W**2))):
        raise EvaluationError(_too_flat("se3", len(p_E), "three places off one line"))
    return _shifted(geo.project_to_so3(spread), p_E, p_W)


ALIGN: dict[str, Callable[[Array, Array, Array], Alignment]] = {
    "none": identity,
    "yaw": yaw,
    "se3": se3,
}


def estimate_alignment(
    kind: str, p_E: Array, p_W: Array, axis_W: tuple[float, float, float] = Z_AXIS
) -> Alignment:
    """Alignment by name from pairs of positions (n, 3) [m]; axis_W: what `yaw` turns about."""
    if kind not in ALIGN:
        raise EvaluationError(choose_one_of("align", kind, ALIGN))
    if kind == "none" or len(p_E) == 0:
        return identity(p_E, p_W, np.array(axis_W))
    return ALIGN[kind](p_E, p_W, np.array(axis_W, dtype=float))


def apply(alignment: Alignment, trajectory: Trajectory) -> Trajectory:
    """The trajectory seen in W: poses, velocities and the position part of the covariance."""
    R_WI, p_WI = geo.compose(alignment.R_WE, alignment.p_WE, trajectory.R_WI, trajectory.p_WI)
    turn = np.eye(6)
    turn[:3, :3] = alignment.R_WE
    v, cov = trajectory.v_WI, trajectory.cov
    return replace(
        trajectory,
        p_WI=p_WI,
        R_WI=R_WI,
        v_WI=None if v is None else v @ alignment.R_WE.T,
        cov=None if cov is None else turn @ cov @ turn.T,
    )


def _shifted(R_WE: Array, p_E: Array, p_W: Array) -> Alignment:
    return Alignment(R_WE, p_W.mean(axis=0) - R_WE @ p_E.mean(axis=0))


def _too_flat(kind: str, n: int, needed: str) -> str:
    return f"align {kind}: {n} poses with truth do not fix the rotation; {needed} are needed"
