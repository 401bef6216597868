"""Finds the camera pose that the corners of many tags agree on, from any start, in compiled code.

Levenberg-Marquardt on whitened residuals with a robust loss: a tag's chi-square d2 counts whole up
to a limit, and as limit (1 + ln(d2 / limit)) above it, so that a moved tag has a bounded say.
"""

from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.gauss_newton import add_row, clear, damped_step, mirror
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import add_scaled, assign, dot, forward
from tagvo.kernels.so3 import rotated
from tagvo.kernels.tag_residual import TagBatch, residual_factor, tag_rows

_SETTLED = 1e-4  # squared length [sigmas] of a step that is taken as the last, unexamined
_FAR = 100.0  # ten sigmas
_RIDGE = 1e-12  # [1/m^2, 1/rad^2] for a diagonal that is zero
_WIDE, _STAGES = 3.0, 6


class Work(NamedTuple):
    """Scratch of one solution: a factor (n, 8, 8), chi2 (n,), weight (n,) a tag, and small ones."""

    factors: Array
    chi2: Array
    weight: Array
    rows: Array
    L: Array
    H: Array
    g: Array
    small: Array


@njit
def work_for(n: int) -> Work:
    """Scratch of a solution from n tags."""
    return Work(
        np.empty((n, 8, 8)), np.zeros(n), np.zeros(n), np.empty((8, 7)), np.empty((8, 6)),
        np.empty((6, 6)), np.empty(6), np.empty((16, 3)),
    )  # fmt: skip


@bare
def evaluate(R: Array, p: Array, tags: TagBatch, limit: float, anew: bool, work: Work) -> float:
    """Robust cost at a pose, infinite where a tag is behind; writes H, g, chi2 and weight.

    anew: factorise each tag's residual covariance at this pose first.
    """
    cost, rows, H, g = 0.0, work.rows, work.H, work.g
    clear(H, g)
    for i in range(len(work.chi2)):
        if not tag_rows(R, p, tags, i, rows, work.L, work.small):
            return np.inf
        factor = work.factors[i]
        if anew and not residual_factor(work.L, tags.laying[i], tags.sigma_px[i], factor):
            return np.inf
        forward(factor, rows)
        d2 = 0.0
        for k in range(8):
            d2 += rows[k, 0] * rows[k, 0]
        w = 1.0 if d2 <= limit else limit / d2
        cost += d2 if d2 <= limit else limit * (1.0 + np.log(d2 / limit))
        work.chi2[i] = d2
        work.weight[i] = w
        for k in range(8):
            add_row(rows[k, 1:], rows[k, 0], w, H, g)
    mirror(H)
    return cost


@njit
def step(R: Array, p: Array, work: Work, damping: float, R_new: Array, p_new: Array) -> float:
    """Damped Gauss-Newton step; returns its squared length in sigmas, negative on failure."""
    L, b = np.empty((6, 6)), np.empty((6, 1))
    if not damped_step(work.H, work.g, damping, _RIDGE, L, b):
        return -1.0
    length = dot(b[:, 0], work.g)
    if not np.isfinite(length):
        return -1.0
    rotated(R, b[3:, 0], R_new)
    assign(p, p_new)
    add_scaled(b[:3, 0], 1.0, p_new)
    return length


@njit
def _on_factors(other: Work, work: Work) -> Work:
    """`other` with the factors of `work`: the same residual covariances, room for a second pose."""
    return Work(
        work.factors, other.chi2, other.weight, other.rows, other.L, other.H, other.g, other.small
    )


@njit
def _descend(
    R: Array,
    p: Array,
    tags: TagBatch,
    limit: float,
    steps: int,
    cost: float,
    work: Work,
    other: Work,
) -> tuple[float, float, bool]:
    """Levenberg-Marquardt on R, p in place from where `work` was evaluated, at this cost.

    Returns the cost, how far it went (squared sigmas) and whether it settled.
    """
    R_new, p_new = np.empty((3, 3)), np.empty(3)
    damping, moved = 1e-9, 0.0
    if not np.isfinite(cost):
        return cost, moved, False
    for _ in range(steps):
        length = step(R, p, work, damping, R_new, p_new)
        if 0.0 <= length < _SETTLED:
            R[:], p[:] = R_new, p_new
            return cost, moved, True
        cost_new = np.inf
        if length >= 0.0:
            cost_new = evaluate(R_new, p_new, tags, limit, False, _on_factors(other, work))
        if cost_new <= cost:
            R[:], p[:], work.H[:], work.g[:] = R_new, p_new, other.H, other.g
            work.chi2[:], work.weight[:] = other.chi2, other.weight
            cost, damping, moved = cost_new, max(damping * 0.1, 1e-9), moved + length
        else:
            damping = max(damping * 30.0, 1e-4)
            if damping > 1e6:
                return cost, moved, False
    return cost, moved, False


@njit
def minimise(
    R: Array, p: Array, tags: TagBatch, limit: float, steps: int, work: Work, other: Work
) -> tuple[float, bool]:
    """Descend on R, p in place from any start; returns the robust cost and whether it settled."""
    cost, settled = np.inf, False
    for _ in range(2):  # the residuals' covariance is that at the start; anew where it moved far
        far = 0.0
        for stage in range(_STAGES):  # from a poor start the loss tightens step by step
            cost = evaluate(R, p, tags, limit, stage == 0, work)
            if not np.isfinite(cost):
                return np.inf, False
            wide = max(limit, _WIDE * np.median(work.chi2))
            if wide > limit:
                cost = evaluate(R, p, tags, wide, False, work)
            cost, moved, settled = _descend(R, p, tags, wide, steps, cost, work, other)
            far += moved
            if wide == limit:
                break
        if far < _FAR:
            break
    return cost, settled
