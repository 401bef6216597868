"""The challenger: one pose from all corners, which knows how well each tag was laid.

Generalised least squares: each tag's eight residuals are weighed by the inverse of their own
covariance (corner noise and laying errors); a robust loss bounds what a moved tag can do. The
6 x 6 is that of the estimate, with the calibration's errors on top.
"""

from dataclasses import dataclass

import numpy as np

from tagvo.config import JointConfig
from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import add_square, cholesky, copy, forward, inverse_spd, multiply
from tagvo.kernels.tag_residual import SYSTEMATIC, TagBatch, tag_rows
from tagvo.pose.levenberg_marquardt import Work, evaluate, minimise, step, work_for

_DECISIVE = 9.0  # in minus twice the log-likelihood
_FEWEST_FOR_SHARE = 5


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


@njit
def _systematic(R: Array, p: Array, tags: TagBatch, P: Array, work: Work) -> Array:
    """Shift of the pose by one sigma of each systematic error; (6, 3)."""
    sums, B, rows = np.zeros((6, SYSTEMATIC)), np.empty((8, SYSTEMATIC)), work.rows
    for i in range(len(work.chi2)):
        tag_rows(R, p, tags, i, rows, work.L, work.small)
        copy(tags.shift_px[i], B)
        forward(work.factors[i], rows)
        forward(work.factors[i], B)
        for k in range(8):
            for a in range(6):
                for s in range(SYSTEMATIC):
                    sums[a, s] += work.weight[i] * rows[k, 1 + a] * B[k, s]
    D = np.empty((6, SYSTEMATIC))
    multiply(P, sums, D)
    return D


@njit
def _misfit_of_sigmas(cost: float, gain: float, work: Work) -> float:
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
        tags.sigma_px, tags.shift_px,
    )  # fmt: skip


@njit
def _laying_share(
    R: Array, p: Array, tags: TagBatch, limit: float, cost: float, work: Work, other: Work
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
        cost_trial = evaluate(R, p, scaled, limit, True, other)
        if not np.isfinite(cost_trial):
            break
        gain = step(R, p, other, 1e-9, R_new, p_new)
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
    work, other = work_for(n), work_for(n)
    cost, settled = minimise(R, p, tags, limit, steps, work, other)
    if adapt and settled and n >= _FEWEST_FOR_SHARE:
        share = _laying_share(R, p, tags, limit, cost, work, other)
        if share < 1.0:
            tags = _with_laying(tags, share)
            cost, settled = minimise(R, p, tags, limit, steps, work, other)
    if not (np.isfinite(cost) and inverse_spd(work.H, cov)):
        return R, p, np.full((6, 6), np.nan), work.chi2, work.weight, np.inf, False, share
    D = _systematic(R, p, tags, cov, work)
    cov = cov * _misfit(work.chi2, work.weight)
    add_square(D, cov)
    return R, p, cov, work.chi2, work.weight, cost, settled, share


@bare
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
