"""The challenger: one pose from all corners, which knows how well each tag was laid.

Generalised least squares: each tag's eight residuals are weighed by the inverse of their own
covariance (corner noise and laying errors); a robust loss bounds what a moved tag can do. The
6 x 6 is that of the estimate, with the calibration's errors on top.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, Field, PositiveFloat

from tagvo.compiled import backward, cholesky, forward, inverse_spd, njit, rotated
from tagvo.geometry import Array
from tagvo.information import SYSTEMATIC, TagBatch, residual_factor, systematic_rows, tag_rows

_SETTLED = 1e-4  # squared length [sigmas] of a step that is taken as the last, unexamined
_FAR = 100.0  # ten sigmas
_WIDE, _STAGES = 3.0, 6
_DECISIVE = 9.0  # in minus twice the log-likelihood
_FEWEST_FOR_SHARE = 5


class JointConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Steps of Gauss-Newton, the robust loss (chi-square of a tag's 8 residuals), and whether the
    residuals may show that the map was laid better than it states (`laying_evidence`)."""

    max_steps: int = Field(default=12, ge=1, le=100)
    robust_chi2: PositiveFloat = 26.12  # 99.9 % of chi-square with 8 degrees of freedom
    reject_weight: PositiveFloat = Field(default=0.25, le=1.0)
    laying_evidence: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class JointPose:
    """The joint pose and how each tag fits it.

    p_WC (3,), R_WC (3, 3), cov (6, 6) as in PoseMeasurement; chi2 (n,), weight (n,) of each tag;
    cost: robust sum; converged: False where the steps ran out or the normal matrix failed;
    laying_share: of the map's laying sigmas that was used (1, or less on evidence).
    """

    p_WC: Array
    R_WC: Array
    cov: Array
    chi2: Array
    weight: Array
    cost: float
    converged: bool
    laying_share: float


class _Work(NamedTuple):
    """Scratch of one solution: per-tag factors (n, 8, 8), chi2 (n,), weight (n,), rows, L, H, g."""

    factors: Array
    chi2: Array
    weight: Array
    rows: Array
    L: Array
    H: Array
    g: Array


@njit
def _evaluate(R: Array, p: Array, tags: TagBatch, limit: float, anew: bool, work: _Work) -> float:
    """Robust cost at a pose, infinite where a tag is behind; writes H, g, chi2 and weight.

    anew: factorise each tag's residual covariance at this pose first.
    """
    cost, rows, H, g = 0.0, work.rows, work.H, work.g
    H[:] = 0.0
    g[:] = 0.0
    for i in range(len(work.chi2)):
        if not tag_rows(R, p, tags, i, rows, work.L):
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
            for a in range(6):
                f = w * rows[k, 1 + a]
                g[a] += f * rows[k, 0]
                for b in range(a + 1):
                    H[a, b] += f * rows[k, 1 + b]
    for a in range(6):
        for b in range(a):
            H[b, a] = H[a, b]
    return cost


@njit
def _step(R: Array, p: Array, work: _Work, damping: float, R_new: Array, p_new: Array) -> float:
    """Damped Gauss-Newton step; returns its squared length in sigmas, negative on failure."""
    M, b = work.H.copy(), np.empty((6, 1))
    for a in range(6):
        M[a, a] = work.H[a, a] * (1.0 + damping) + 1e-12
        b[a, 0] = work.g[a]
    if not cholesky(M):
        return -1.0
    forward(M, b)
    backward(M, b)
    length = 0.0
    for a in range(6):
        length += b[a, 0] * work.g[a]
        if not np.isfinite(b[a, 0]):
            return -1.0
    rotated(R, b[3:, 0], R_new)
    for a in range(3):
        p_new[a] = p[a] + b[a, 0]
    return length


@njit
def _on_factors(other: _Work, work: _Work) -> _Work:
    """`other` with the factors of `work`: the same residual covariances, room for a second pose."""
    return _Work(work.factors, other.chi2, other.weight, other.rows, other.L, other.H, other.g)


@njit
def _descend(
    R: Array,
    p: Array,
    tags: TagBatch,
    limit: float,
    steps: int,
    cost: float,
    work: _Work,
    other: _Work,
) -> tuple[float, float, bool]:
    """Levenberg-Marquardt on R, p in place from where `work` was evaluated, at this cost.

    Returns the cost, how far it went (squared sigmas) and whether it settled.
    """
    R_new, p_new = np.empty((3, 3)), np.empty(3)
    damping, moved = 1e-9, 0.0
    if not np.isfinite(cost):
        return cost, moved, False
    for _ in range(steps):
        length = _step(R, p, work, damping, R_new, p_new)
        if 0.0 <= length < _SETTLED:
            R[:], p[:] = R_new, p_new
            return cost, moved, True
        cost_new = np.inf
        if length >= 0.0:
            cost_new = _evaluate(R_new, p_new, tags, limit, False, _on_factors(other, work))
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
def _systematic(R: Array, p: Array, tags: TagBatch, P: Array, work: _Work) -> Array:
    """Shift of the pose by one sigma of each systematic error; (6, 3)."""
    B, sums = np.empty((8, SYSTEMATIC)), np.zeros((6, SYSTEMATIC))
    rows = work.rows
    for i in range(len(work.chi2)):
        tag_rows(R, p, tags, i, rows, work.L)
        systematic_rows(tags.offset_px[i], tags.floor, B)
        forward(work.factors[i], rows)
        forward(work.factors[i], B)
        for k in range(8):
            for a in range(6):
                for s in range(SYSTEMATIC):
                    sums[a, s] += work.weight[i] * rows[k, 1 + a] * B[k, s]
    return P @ sums


@njit
def _minimise(
    R: Array, p: Array, tags: TagBatch, limit: float, steps: int, work: _Work, other: _Work
) -> tuple[float, bool]:
    """Descend on R, p in place from any start; returns the robust cost and whether it settled."""
    cost, settled = np.inf, False
    for _ in range(2):  # the residuals' covariance is that at the start; anew where it moved far
        far = 0.0
        for stage in range(_STAGES):  # from a poor start the loss tightens step by step
            cost = _evaluate(R, p, tags, limit, stage == 0, work)
            if not np.isfinite(cost):
                return np.inf, False
            wide = max(limit, _WIDE * np.median(work.chi2))
            if wide > limit:
                cost = _evaluate(R, p, tags, wide, False, work)
            cost, moved, settled = _descend(R, p, tags, wide, steps, cost, work, other)
            far += moved
            if wide == limit:
                break
        if far < _FAR:
            break
    return cost, settled


@njit
def _misfit_of_sigmas(cost: float, gain: float, work: _Work) -> float:
    """Minus twice the restricted log-likelihood of the sigmas, up to a constant.

    cost - gain: chi-square at the minimum; log det S and log det H charge for larger sigmas.
    """
    total = cost - gain
    for i in range(len(work.chi2)):
        for k in range(8):
            total += 2.0 * np.log(work.factors[i, k, k])
    M = work.H.copy()
    if not cholesky(M):
        return np.inf
    for a in range(6):
        total += 2.0 * np.log(M[a, a])
    return total


@njit
def _with_laying(tags: TagBatch, share: float) -> TagBatch:
    return TagBatch(
        tags.R_WT, tags.p_WT, tags.corners_T, tags.laying * share, tags.corners_n, tags.J_px_n,
        tags.sigma_px, tags.offset_px, tags.floor,
    )  # fmt: skip


@njit
def _laying_share(
    R: Array, p: Array, tags: TagBatch, limit: float, cost: float, work: _Work, other: _Work
) -> float:
    """Share of the stated laying sigmas that the residuals of this frame speak for.

    1 unless a smaller share is decisively more likely (restricted maximum likelihood): a map is
    often laid better than it says, and then far tags deserve less say against near ones.
    """
    dof = 8.0 * len(work.chi2) - 6.0
    if cost > dof - 0.5 * np.sqrt(2.0 * dof):  # residuals no smaller than stated: nothing to ask
        return 1.0
    R_new, p_new = np.empty((3, 3)), np.empty(3)
    best, share = _misfit_of_sigmas(cost, 0.0, work), 1.0
    for trial in (1.0 / 3.0, 0.1):
        scaled = _with_laying(tags, trial)
        cost_trial = _evaluate(R, p, scaled, limit, True, other)
        if not np.isfinite(cost_trial):
            break
        gain = _step(R, p, other, 1e-9, R_new, p_new)
        misfit = _misfit_of_sigmas(cost_trial, max(gain, 0.0), other)
        if not misfit < best - _DECISIVE:
            break
        best, share = misfit, trial
    return share


@njit
def _solve(
    R0: Array, p0: Array, tags: TagBatch, limit: float, steps: int, adapt: bool
) -> tuple[Array, Array, Array, Array, Array, float, bool, float]:
    n = len(tags.sigma_px)
    R, p, cov, share = R0.copy(), p0.copy(), np.full((6, 6), np.nan), 1.0
    rows, L = np.empty((8, 7)), np.empty((8, 6))
    work = _Work(
        np.empty((n, 8, 8)), np.zeros(n), np.zeros(n), rows, L, np.empty((6, 6)), np.empty(6)
    )
    other = _Work(
        np.empty((n, 8, 8)), np.zeros(n), np.zeros(n), rows, L, np.empty((6, 6)), np.empty(6)
    )
    cost, settled = _minimise(R, p, tags, limit, steps, work, other)
    if adapt and settled and n >= _FEWEST_FOR_SHARE:
        share = _laying_share(R, p, tags, limit, cost, work, other)
        if share < 1.0:
            tags = _with_laying(tags, share)
            cost, settled = _minimise(R, p, tags, limit, steps, work, other)
    if not (np.isfinite(cost) and inverse_spd(work.H, cov)):
        return R, p, np.full((6, 6), np.nan), work.chi2, work.weight, np.inf, False, share
    D = _systematic(R, p, tags, cov, work)
    cov = cov * _misfit(work.chi2, work.weight) + D @ D.T
    return R, p, cov, work.chi2, work.weight, cost, settled, share


@njit
def _misfit(chi2: Array, weight: Array) -> float:
    """Variance factor: 1 where the residuals are as expected (99 %), chi2 / dof above that."""
    total, count = 0.0, 0.0
    for i in range(len(chi2)):
        total += weight[i] * chi2[i]
        count += weight[i]
    dof = max(8.0 * count - 6.0, 1.0)
    spread = 2.0 / (9.0 * dof)  # Wilson and Hilferty's approximation of the quantile
    quantile = dof * (1.0 - spread + 2.326 * np.sqrt(spread)) ** 3
    return total / dof if total > quantile else 1.0


def solve_joint(R_WC: Array, p_WC: Array, tags: TagBatch, config: JointConfig) -> JointPose:
    """Joint pose of the camera from all corners of n tags, from a starting pose (3, 3), (3,).

    Raises nothing: a failed solution has `converged` False, cost inf and a covariance of NaN.
    """
    R, p, cov, chi2, weight, cost, converged, share = _solve(
        R_WC, p_WC, tags, config.robust_chi2, config.max_steps, config.laying_evidence
    )
    return JointPose(p, R, cov, chi2, weight, cost, converged, share)
