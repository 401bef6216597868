"""Tight correction by tag corners: eight reprojection residuals a tag, gated tag by tag.

Each tag's residuals see the error xi of the camera pose (`vio.filter.update`) through the
projection; their covariance is the corners' noise plus the tag's laying errors, marginalised. What
the accepted tags know of xi is gathered in information form; one six-row correction applies it.
"""

import numpy as np

from tagvo.config import FloorConfig
from tagvo.geometry import Array
from tagvo.kernels.jit import njit
from tagvo.records import Observations
from tagvo.tags.tag_map import TagMap
from vio.filter import state as at
from vio.filter.measurements.predicted import camera_jacobian, camera_pose
from vio.filter.update import (
    GATE_8,
    cholesky,
    downdate,
    see_bias,
    solve_lower,
    times_ht,
    times_p,
)

# one tag: x_n (4, 2) | noise of each corner xx, xy, yy (4, 3) | p_WX (4, 3) | T's axes in W times
# the laying sigmas: of the place (3, 3),
# of the turn (3, 3) | p_WT (3) | id
# | shift of the corners (8, 3) by one sigma of focal length and principal point
_X, _N, _W, _DP, _DT, _O, _ID, _B = 0, 8, 20, 32, 41, 50, 53, 54
_MIN_DEPTH = 1e-2  # [m] a corner nearer than this, or behind, cannot have been seen


def pack(
    seen: Observations, tag_map: TagMap, centre_px: Array, floor: FloorConfig, max_tags: int
) -> Array:
    """Rows for `correct_corners` of at most max_tags tags, the largest in the image first.

    centre_px (2,): principal point; floor: the calibration's errors, common to all tags.
    -> (k, TAG_NUMBERS); tags whose corners or noise are not finite are left out.
    """
    cov = np.square(seen.sigma_px)[..., None, None] * np.eye(2)
    J_inv = np.linalg.pinv(np.where(np.isfinite(seen.J_px_n), seen.J_px_n, 0.0))
    cov_n = J_inv @ cov @ np.swapaxes(J_inv, -1, -2)
    R_WT, sigma = tag_map.R_WT[seen.row], tag_map.laying_sigma[seen.row]
    out = np.zeros((len(seen), at.TAG_NUMBERS))
    out[:, _X:_N] = seen.corners_n.reshape(-1, 8)
    out[:, _N:_W] = cov_n.reshape(-1, 4, 4)[:, :, [0, 1, 3]].reshape(-1, 12)
    out[:, _W:_DP] = tag_map.corners_W[seen.row].reshape(-1, 12)
    out[:, _DP:_DT] = (R_WT * sigma[:, None, :3]).reshape(-1, 9)
    out[:, _DT:_O] = (R_WT * sigma[:, None, 3:]).reshape(-1, 9)
    out[:, _O:_ID] = tag_map.p_WT[seen.row]
    out[:, _ID] = seen.tag_id
    shift = np.zeros((*seen.corners_px.shape, 3))
    shift[..., 0] = (seen.corners_px - centre_px) * floor.focal_rel
    shift[..., 0, 1] = shift[..., 1, 2] = floor.principal_px
    out[:, _B:] = (J_inv @ shift).reshape(-1, 24)
    out = out[np.isfinite(out).all(axis=1)]
    a, b = out[:, 4:6] - out[:, 0:2], out[:, 6:8] - out[:, 2:4]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return out[np.argsort(-area, kind="stable")[:max_tags]]


@njit
def _look(tag: Array, c: int, R_WC: Array, p_WC: Array, D: Array, r: Array) -> bool:
    """D (2, 3) := d projection / d p_WX of corner c, r (8,) its residual; False: not in view."""
    p = np.zeros(3)
    for i in range(3):
        for k in range(3):
            p[i] += R_WC[k, i] * (tag[_W + 3 * c + k] - p_WC[k])
    if not p[2] > _MIN_DEPTH:
        return False
    u, v = p[0] / p[2], p[1] / p[2]
    r[2 * c], r[2 * c + 1] = tag[_X + 2 * c] - u, tag[_X + 2 * c + 1] - v
    for k in range(3):
        D[0, k] = (R_WC[k, 0] - u * R_WC[k, 2]) / p[2]
        D[1, k] = (R_WC[k, 1] - v * R_WC[k, 2]) / p[2]
    return True


@njit
def _lay(tag: Array, c: int, D: Array, G: Array) -> None:
    """G (8, 6) rows of corner c := d projection / d laying error in units of its sigma."""
    arm = np.empty(3)
    for k in range(3):
        arm[k] = tag[_W + 3 * c + k] - tag[_O + k]
    for j in range(3):
        a0, a1, a2 = tag[_DT + j], tag[_DT + 3 + j], tag[_DT + 6 + j]
        turn0, turn1, turn2 = (
            a1 * arm[2] - a2 * arm[1],
            a2 * arm[0] - a0 * arm[2],
            a0 * arm[1] - a1 * arm[0],
        )
        for i in range(2):
            row = 2 * c + i
            G[row, j] = (
                D[i, 0] * tag[_DP + j] + D[i, 1] * tag[_DP + 3 + j] + D[i, 2] * tag[_DP + 6 + j]
            )
            G[row, 3 + j] = D[i, 0] * turn0 + D[i, 1] * turn1 + D[i, 2] * turn2


@njit
def tag_residual(
    tag: Array, R_WC: Array, p_WC: Array, r: Array, J: Array, N: Array, inflation: float
) -> bool:
    """r (8,), J (8, 6) = d projection / d xi, N (8, 8) noise of one tag; False: not in view."""
    D, G = np.empty((2, 3)), np.empty((8, 6))
    for c in range(4):
        if not _look(tag, c, R_WC, p_WC, D, r):
            return False
        _lay(tag, c, D, G)
        for i in range(2):
            row = 2 * c + i
            for k in range(3):
                J[row, k] = -D[i, k]
            for j in range(
                3
            ):  # a right turn of C about its axis j moves p_WX by a_j x (p_WC - p_WX)
                a0, a1, a2 = R_WC[0, j], R_WC[1, j], R_WC[2, j]
                d0 = p_WC[0] - tag[_W + 3 * c]
                d1 = p_WC[1] - tag[_W + 3 * c + 1]
                d2 = p_WC[2] - tag[_W + 3 * c + 2]
                J[row, 3 + j] = (
                    D[i, 0] * (a1 * d2 - a2 * d1)
                    + D[i, 1] * (a2 * d0 - a0 * d2)
                    + D[i, 2] * (a0 * d1 - a1 * d0)
                )
    for i in range(8):
        for j in range(8):
            s = 0.0
            for k in range(6):
                s += G[i, k] * G[j, k]
            N[i, j] = inflation * s
    for c in range(4):
        xx, xy, yy = tag[_N + 3 * c], tag[_N + 3 * c + 1], tag[_N + 3 * c + 2]
        N[2 * c, 2 * c] += inflation * xx
        N[2 * c + 1, 2 * c + 1] += inflation * yy
        N[2 * c, 2 * c + 1] += inflation * xy
        N[2 * c + 1, 2 * c] += inflation * xy
    return True


@njit
def _tag_distance(J: Array, N: Array, r: Array, P_xi: Array, B: Array, inflation: float) -> float:
    """Squared Mahalanobis length of one tag's residual under J P_xi J^T + N + B B^T."""
    S, A, y = N.copy(), np.zeros((8, 6)), np.empty((8, 1))
    for i in range(8):
        y[i, 0] = r[i]
        for k in range(6):
            for j in range(6):
                A[i, j] += J[i, k] * P_xi[k, j]
    for i in range(8):
        for j in range(i + 1):
            for k in range(6):
                S[i, j] += A[i, k] * J[j, k]
            for k in range(3):
                S[i, j] += inflation * B[i, k] * B[j, k]
    if not cholesky(S, 8):
        return np.inf
    solve_lower(S, 8, y)
    d = 0.0
    for i in range(8):
        d += y[i, 0] * y[i, 0]
    return d if d >= 0.0 else np.inf


@njit
def gather(
    x: Array, P_xi: Array, tags: Array, inflation: float, gate: float, A: Array, b: Array, X: Array
) -> tuple[int, float]:
    """A (6, 6), b (6,), X (6, 3) := what the accepted tags know of xi and of the calibration's
    errors, in information form; their number, and a mean NIS as of 6 dof."""
    R_WC, p_WC = np.empty((3, 3)), np.empty(3)
    r, N, Jr = np.empty(8), np.empty((8, 8)), np.empty((8, 10))
    J = np.empty((8, 6))
    camera_pose(x, R_WC, p_WC)
    A[:] = 0.0
    b[:] = 0.0
    X[:] = 0.0
    used, total, seen = 0, 0.0, 0
    for t in range(tags.shape[0]):
        if not tag_residual(tags[t], R_WC, p_WC, r, J, N, inflation):
            continue
        B = tags[t, _B:].reshape((8, 3))
        d = _tag_distance(J, N, r, P_xi, B, inflation)
        if d < np.inf:
            total += d
            seen += 1
        if d > GATE_8 * gate or not cholesky(N, 8):
            continue
        Jr[:, :6] = J
        Jr[:, 6] = r
        Jr[:, 7:] = B
        solve_lower(N, 8, Jr)
        used += 1
        for k in range(8):
            for i in range(6):
                b[i] += Jr[k, i] * Jr[k, 6]
                for j in range(6):
                    A[i, j] += Jr[k, i] * Jr[k, j]
                for j in range(3):
                    X[i, j] += Jr[k, i] * Jr[k, 7 + j]
    return used, (total / seen * 0.75 if seen > 0 else np.inf)


@njit
def _whiten(y: Array, X: Array, inflation: float, y_white: Array) -> None:
    """y_white (6,) := y (6, 1) of covariance I + inflation X X^T, whitened, without inflation."""
    L, out = np.eye(6), y.copy()
    for i in range(6):
        out[i, 0] *= np.sqrt(inflation)
        for j in range(6):
            for k in range(3):
                L[i, j] += inflation * X[i, k] * X[j, k]
    if cholesky(L, 6):
        solve_lower(L, 6, out)
        y_white[:] = out[:, 0]


@njit
def correct_corners(
    x: Array,
    P: Array,
    w: Array,
    tags: Array,
    trust: tuple[float, float, float],
    gate: float,
    y_white: Array,
) -> tuple[int, float]:
    """Correct by the corners of tags (k, TAG_NUMBERS); what became of it, and a NIS as of 6 dof.

    w (3,) gyro then; trust: what multiplies the noise, and the shares of it that are the pose
    bias's (that of positions serves for all: corners do not tell them apart); gate scales the
    99.9 % limits; y_white (6,) receives what the accepted tags say of xi, bias and all, whitened
    by their own noise.
    """
    n, inflation, share = P.shape[0], trust[0], trust[1]
    H, M, P_xi = np.empty((6, n)), np.empty((6, n)), np.empty((6, 6))
    A, b, X = np.empty((6, 6)), np.empty(6), np.empty((6, 3))
    camera_jacobian(x, w, H)
    times_p(H, P, M)
    times_ht(M, H, P_xi)
    used, nis = gather(x, P_xi, tags, inflation, gate, A, b, X)
    if used == 0:
        return at.REJECTED, nis
    for i in range(6):
        A[i, i] *= 1.0 + 1e-12
    if not cholesky(A, 6):
        return at.SINGULAR, nis
    y = b.copy().reshape((6, 1))
    solve_lower(A, 6, y)  # y = C^T xi + white noise, where A = C C^T
    solve_lower(A, 6, X)
    _whiten(y, X, inflation, y_white)
    U, S, r = np.zeros((6, n)), np.empty((6, 6)), y[:, 0].copy()
    for i in range(6):
        for k in range(i, 6):
            c = A[k, i]
            for j in range(n):
                U[i, j] += c * H[k, j]
    if share > 0.0:
        see_bias(x, np.eye(6), np.full(6, np.sqrt(share / inflation)), U, r)
    times_p(U, P, M)
    times_ht(M, U, S)
    for i in range(6):
        S[i, i] += 1.0 - share
        for j in range(6):
            for k in range(3):
                S[i, j] += inflation * X[i, k] * X[j, k]
    good = cholesky(S, 6) and downdate(x, P, S, M, r)
    return (at.ACCEPTED if good else at.SINGULAR), nis
