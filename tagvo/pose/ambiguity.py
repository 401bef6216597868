"""Which of its two planar solutions a tag takes: the better, the consistent, or the prior's.

A square seen nearly head-on, or small, has two poses of almost the same reprojection error. Tags
that lie on one map agree on the camera's pose only in their true solutions.
"""

from collections.abc import Callable

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray
from tagvo.kernels.jit import njit
from tagvo.kernels.linalg import assign, multiply, subtract_times
from tagvo.kernels.so3 import pose_distance2
from tagvo.records import PosePrior

_SPREAD = np.radians(4.0)  # disagreement at which a tag's vote has half its weight [rad]
DECISIVE = 9.0  # difference of chi-square between the two solutions that settles it
_LEAST_LIKELY = 1e-3


@njit
def camera_candidates(
    R_CT: Array, p_CT: Array, R_WT: Array, p_WT: Array
) -> tuple[Array, Array, Array]:
    """Camera poses R_WC (n, 2, 3, 3), p_WC (n, 2, 3), depth (n, 2) from both solutions of tags.

    R_CT (n, 2, 3, 3), p_CT (n, 2, 3) [m]; R_WT (n, 3, 3), p_WT (n, 3): the map's.
    """
    n = len(R_CT)
    R, p, depth = np.empty((n, 2, 3, 3)), np.empty((n, 2, 3)), np.empty((n, 2))
    for i in range(n):
        for s in range(2):
            depth[i, s] = p_CT[i, s, 2]
            multiply(R_WT[i], R_CT[i, s].T, R[i, s])
            assign(p_WT[i], p[i, s])
            subtract_times(R[i, s], p_CT[i, s], p[i, s])
    return R, p, depth


@njit
def _vote(R: Array, p: Array, depth: Array, gap: Array, area_px: Array) -> IntArray:
    """The branch of each tag nearest the candidate pose that most tags support."""
    n = len(R)
    likelihood, weight = np.ones((n, 2)), np.sqrt(area_px)
    for t in range(n):
        chance = min(max(np.exp(-0.5 * min(gap[t], 100.0)), _LEAST_LIKELY), 1.0)
        likelihood[t, 1] = 0.0 if np.isinf(gap[t]) else chance
    scale = 1.0 / (_SPREAD * _SPREAD)
    best, best_t, best_s = -1.0, 0, 0
    for t in range(n):
        for s in range(2):
            score = weight[t] * likelihood[t, s]
            for u in range(n):
                if u == t:
                    continue
                d = max(depth[t, s], 1e-3)
                support = 0.0
                for k in range(2):
                    d2 = pose_distance2(R[t, s], p[t, s], R[u, k], p[u, k], d)
                    support = max(support, likelihood[u, k] / (1.0 + d2 * scale))
                score += weight[u] * support
            if score > best:
                best, best_t, best_s = score, t, s
    branch = np.zeros(n, dtype=np.int64)
    d = max(depth[best_t, best_s], 1e-3)
    for u in range(n):
        most = -1.0
        for k in range(2):
            d2 = pose_distance2(R[best_t, best_s], p[best_t, best_s], R[u, k], p[u, k], d)
            vote = likelihood[u, k] / (1.0 + d2 * scale)
            if vote > most:
                most, branch[u] = vote, k
    return branch


@njit
def chi2_gap(rms_px: Array, sigma_px: Array) -> Array:
    """How much worse the second solution fits, in chi-square; (n, 2), (n, 4) -> (n,)."""
    gap = np.empty(len(rms_px))
    for i in range(len(gap)):
        variance = 0.25 * np.sum(np.square(sigma_px[i]))
        gap[i] = 4.0 * (rms_px[i, 1] ** 2 - rms_px[i, 0] ** 2) / variance
        if not np.isfinite(gap[i]):
            gap[i] = np.inf
    return gap


def first(
    R_WC: Array, p_WC: Array, depth: Array, gap: Array, area_px: Array, prior: PosePrior | None
) -> IntArray:
    """The solution of the smaller reprojection error, as most software takes it; -> (n,) of 0."""
    return np.zeros(len(gap), dtype=np.int64)


def consistent(
    R_WC: Array, p_WC: Array, depth: Array, gap: Array, area_px: Array, prior: PosePrior | None
) -> IntArray:
    """The solution that agrees best with the other tags; one tag alone takes its first.

    R_WC (n, 2, 3, 3), p_WC (n, 2, 3) [m], depth (n, 2) [m], gap (n,), area_px (n,) -> (n,) 0 or 1.
    """
    if len(gap) < 2:
        return first(R_WC, p_WC, depth, gap, area_px, prior)
    return _vote(R_WC, p_WC, depth, gap, area_px)


def nearest_prior(
    R_WC: Array, p_WC: Array, depth: Array, gap: Array, area_px: Array, prior: PosePrior | None
) -> IntArray:
    """The solution more likely under the predicted camera pose; without one, `consistent`."""
    if prior is None:
        return consistent(R_WC, p_WC, depth, gap, area_px, None)
    cost = np.array(prior_cost(R_WC, p_WC, depth, prior))
    cost[:, 1] += gap
    return np.asarray(cost[:, 1] < cost[:, 0], dtype=np.int64)


def prior_cost(R_WC: Array, p_WC: Array, depth: Array, prior: PosePrior) -> Array:
    """Squared Mahalanobis distance of camera poses to the prior; (..., 3, 3), (..., 3) -> (...).

    A per-tag allowance (4 degrees, 7 % of the depth) is added to the prior's covariance.
    """
    error = np.concatenate([p_WC - prior.p_WC, geo.log(prior.R_WC.T @ R_WC)], axis=-1)
    allowance = np.zeros((*depth.shape, 6))
    allowance[..., :3] = np.square(_SPREAD * depth)[..., None]
    allowance[..., 3:] = _SPREAD**2
    S = prior.cov + allowance[..., None] * np.eye(6)
    solved = np.linalg.solve(S, error[..., None])[..., 0]
    return np.asarray(np.einsum("...i,...i->...", error, solved))


Chooser = Callable[[Array, Array, Array, Array, Array, PosePrior | None], IntArray]
AMBIGUITY: dict[str, Chooser] = {
    "first": first,
    "consistent": consistent,
    "prior": nearest_prior,
}
