"""Corrections of the error-state filter, compiled: a Cholesky-whitened downdate, reset included.

A pose measurement observes the camera pose's error directly (`measurements.pivot` and
`measurements.predicted`); tag corners do through their projection (`measurements.corners`). P stays
exactly symmetric throughout.
"""

import math

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from vio.filter import state as at
from vio.filter.measurements.predicted import camera_jacobian, pivot_rows, pose_residual
from vio.filter.propagation import exp_quat, turn_quat

GATE_6, GATE_3, GATE_8 = 22.457744, 16.266236, 26.124482  # chi-square 99.9 % of 6, 3 and 8 dof


@bare
def cholesky(A: Array, m: int) -> bool:
    """Lower factor of the leading m x m block of A, in place; False where it is not positive."""
    for i in range(m):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= A[i, k] * A[j, k]
            if i == j:
                if not (s > 0.0 and s < 1e300):
                    return False
                A[i, i] = math.sqrt(s)
            else:
                A[i, j] = s / A[j, j]
    return True


@bare
def solve_lower(L: Array, m: int, B: Array) -> None:
    """B (m, k) := L^-1 B in place, L lower triangular."""
    for i in range(m):
        for k in range(i):
            f = L[i, k]
            for j in range(B.shape[1]):
                B[i, j] -= f * B[k, j]
        f = 1.0 / L[i, i]
        for j in range(B.shape[1]):
            B[i, j] *= f


@bare
def times_p(H: Array, P: Array, M: Array) -> None:
    """M (m, n) := H P, skipping what is zero in H."""
    m, n = H.shape
    for i in range(m):
        for j in range(n):
            M[i, j] = 0.0
        for c in range(n):
            h = H[i, c]
            if h != 0.0:
                for j in range(n):
                    M[i, j] += h * P[c, j]


@bare
def times_ht(M: Array, H: Array, S: Array) -> None:
    """S (m, m) := M H^T, skipping what is zero in H; exactly symmetric."""
    m, n = H.shape
    for i in range(m):
        for k in range(i, m):
            S[i, k] = 0.0
    for k in range(m):
        for c in range(n):
            h = H[k, c]
            if h != 0.0:
                for i in range(k + 1):
                    S[i, k] += M[i, c] * h
    for i in range(m):
        for k in range(i):
            S[i, k] = S[k, i]


@bare
def _subtract_square(P: Array, M: Array) -> None:
    """P (n, n) -= M^T M; all rows of M at once where there are six: three times as fast."""
    m, n = M.shape
    for i in range(n):
        if m == 6:
            a, b, c, d, e, f = M[0, i], M[1, i], M[2, i], M[3, i], M[4, i], M[5, i]
            for j in range(n):
                P[i, j] -= (
                    (a * M[0, j] + b * M[1, j])
                    + (c * M[2, j] + d * M[3, j])
                    + (e * M[4, j] + f * M[5, j])
                )
        else:
            for k in range(m):
                a = M[k, i]
                for j in range(n):
                    P[i, j] -= a * M[k, j]


@njit
def downdate(x: Array, P: Array, L: Array, M: Array, r: Array) -> bool:
    """Correct x and P, in place, by residual r (m,) with M = H P (m, n) and S = L L^T; both spoilt.

    False, and nothing changed, where the correction is not finite.
    """
    m, n = M.shape
    y = r.reshape((m, 1))
    solve_lower(L, m, y)
    solve_lower(L, m, M)
    dx = np.zeros(30)
    for k in range(m):
        for j in range(n):
            dx[j] += M[k, j] * y[k, 0]
    for j in range(n):
        if not abs(dx[j]) < 1e6:
            return False
    _subtract_square(P, M)
    for i in range(n):
        if not P[i, i] > 0.0:
            P[i, i] = 1e-18
    inject(x, P, dx)
    return True


@bare
def inject(x: Array, P: Array, dx: Array) -> None:
    """Add the error dx (30,) to the nominal state and reset it; P follows by the reset Jacobian."""
    for i in range(3):
        x[at.X_P + i] += dx[at.P + i]
        x[at.X_V + i] += dx[at.V + i]
        x[at.X_BG + i] += dx[at.BG + i]
        x[at.X_BA + i] += dx[at.BA + i]
        x[at.X_PIC + i] += dx[at.LEVER + i]
    for i in range(6):
        x[at.X_BIAS + i] += dx[at.BIAS + i]
    x[at.X_TD] += dx[at.TD]
    turn_quat(x, at.X_Q, exp_quat(dx[at.TH], dx[at.TH + 1], dx[at.TH + 2]))
    turn_quat(x, at.X_QIC, exp_quat(dx[at.EX], dx[at.EX + 1], dx[at.EX + 2]))
    turn_quat(x, at.X_QWG, exp_quat(dx[at.GR], dx[at.GR + 1], 0.0))
    _reset(P, at.TH, dx)
    _reset(P, at.EX, dx)


@bare
def _reset(P: Array, s: int, dx: Array) -> None:
    """P := G P G^T with G = I - hat(dx[s:s+3]) / 2 on that block, identity elsewhere."""
    a, b, c = 0.5 * dx[s], 0.5 * dx[s + 1], 0.5 * dx[s + 2]
    n = P.shape[0]
    for j in range(n):
        u, v, w = P[s, j], P[s + 1, j], P[s + 2, j]
        P[s, j] = u + c * v - b * w
        P[s + 1, j] = v - c * u + a * w
        P[s + 2, j] = w + b * u - a * v
    for j in range(n):
        u, v, w = P[j, s], P[j, s + 1], P[j, s + 2]
        P[j, s] = u + c * v - b * w
        P[j, s + 1] = v - c * u + a * w
        P[j, s + 2] = w + b * u - a * v
    for i in range(s, s + 3):
        for j in range(n):
            P[j, i] = P[i, j]


@njit
def distance(S: Array, r: Array, first: int, m: int) -> float:
    """Squared Mahalanobis length of r[first:first+m] under that block of S; inf where singular."""
    L, y = np.empty((m, m)), np.empty((m, 1))
    for i in range(m):
        y[i, 0] = r[first + i]
        for j in range(m):
            L[i, j] = S[first + i, first + j]
    if not cholesky(L, m):
        return np.inf
    solve_lower(L, m, y)
    d = 0.0
    for i in range(m):
        d += y[i, 0] * y[i, 0]
    return d if d >= 0.0 else np.inf


@bare
def see_bias(x: Array, L: Array, scale: Array, H: Array, r: Array) -> None:
    """Let the pose bias into H (6, n) and r (6,): diag(scale (6,)) L (6, 6, lower) times it."""
    for i in range(6):
        for j in range(i + 1):
            H[i, at.BIAS + j] = scale[i] * L[i, j]
            r[i] -= scale[i] * L[i, j] * x[at.X_BIAS + j]


@njit
def correct_pose(
    x: Array,
    P: Array,
    w: Array,
    z: Array,
    trust: tuple[float, float, float],
    gate: float,
    y_white: Array,
) -> tuple[int, float]:
    """Correct by a camera pose z (46,) of `measurements.pivot`; what became of it, and its NIS.

    w (3,) gyro then; trust: what multiplies cov, and the shares of it that are the pose bias's, of
    position and of rotation; gate scales the 99.9 % limits (inf: no gate); y_white (6,) receives
    the innovation, bias and all, whitened by cov.
    """
    n, inflation, slow = P.shape[0], trust[0], np.empty(6)
    slow[:3], slow[3:] = trust[1], trust[2]
    H, M, S, r = np.empty((6, n)), np.empty((6, n)), np.empty((6, 6)), np.empty(6)
    y, R_WC = np.empty(3), np.empty((3, 3))
    pose_residual(x, z, r, y, R_WC)
    camera_jacobian(x, w, H)
    pivot_rows(H, R_WC, y, n)
    L, white = np.empty((6, 6)), np.empty((6, 1))
    for i in range(6):
        white[i, 0] = r[i]
        for j in range(6):
            L[i, j] = z[7 + 6 * i + j]
    if not cholesky(L, 6):
        return at.SINGULAR, np.inf
    solve_lower(L, 6, white)
    y_white[:] = white[:, 0]
    if trust[1] > 0.0:
        see_bias(x, L, np.sqrt(slow), H, r)
    times_p(H, P, M)
    times_ht(M, H, S)
    for i in range(6):
        for j in range(6):
            white_share = math.sqrt((1.0 - slow[i]) * (1.0 - slow[j]))
            S[i, j] += inflation * white_share * z[7 + 6 * i + j]
    nis = distance(S, r, 0, 6)
    if nis == np.inf or nis != nis:
        return at.SINGULAR, nis
    first, m, verdict = 0, 6, at.ACCEPTED
    if nis > GATE_6 * gate:
        if distance(S, r, 0, 3) <= GATE_3 * gate:
            m, verdict = 3, at.POSITION_ONLY
        elif distance(S, r, 3, 3) <= GATE_3 * gate:
            first, m, verdict = 3, 3, at.ROTATION_ONLY
        else:
            return at.REJECTED, nis
    L = S[first : first + m, first : first + m].copy()
    good = cholesky(L, m)
    good = good and downdate(x, P, L, M[first : first + m], r[first : first + m])
    return (verdict if good else at.SINGULAR), nis


@njit
def correct_still(x: Array, P: Array, variance: float, gate: float) -> tuple[int, float]:
    """Correct by a velocity of zero, `variance` [m^2/s^2] an axis (on the ground only)."""
    M, S, r = P[at.V : at.V + 3].copy(), np.empty((3, 3)), np.empty(3)
    for i in range(3):
        r[i] = -x[at.X_V + i]
        for j in range(3):
            S[i, j] = P[at.V + i, at.V + j]
        S[i, i] += variance
    nis = distance(S, r, 0, 3)
    if not nis <= GATE_3 * gate:
        return at.REJECTED, nis
    good = cholesky(S, 3) and downdate(x, P, S, M, r)
    return (at.ACCEPTED if good else at.SINGULAR), nis


@njit
def correct_rig(x: Array, P: Array, z: Array) -> tuple[int, float]:
    """Correct by the extrinsic rotation as calibrated, z (5,): q_IC and an axis's variance."""
    M, S, r = P[at.EX : at.EX + 3].copy(), np.empty((3, 3)), np.empty(3)
    q = np.empty(4)
    q[0], q[1], q[2], q[3] = x[at.X_QIC], -x[at.X_QIC + 1], -x[at.X_QIC + 2], -x[at.X_QIC + 3]
    turn_quat(q, 0, (z[0], z[1], z[2], z[3]))
    for i in range(3):
        r[i] = 2.0 * q[1 + i] if q[0] > 0.0 else -2.0 * q[1 + i]
        for j in range(3):
            S[i, j] = P[at.EX + i, at.EX + j]
        S[i, i] += z[4]
    nis = distance(S, r, 0, 3)
    good = cholesky(S, 3) and downdate(x, P, S, M, r)
    return (at.ACCEPTED if good else at.SINGULAR), nis


@njit
def correct_clock(x: Array, P: Array, offset_s: float, variance: float) -> tuple[int, float]:
    """Correct by the time offset as calibrated [s], of this variance [s^2]."""
    M, L, r = P[at.TD : at.TD + 1].copy(), np.empty((1, 1)), np.empty(1)
    L[0, 0] = math.sqrt(P[at.TD, at.TD] + variance)
    r[0] = offset_s - x[at.X_TD]
    nis = (r[0] / L[0, 0]) ** 2
    return (at.ACCEPTED if downdate(x, P, L, M, r) else at.SINGULAR), nis
