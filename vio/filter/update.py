"""The correction step: gates, the whitened downdate, injection of the error, its reset.

A measurement module gives residual r (m,), M = H P (m, n) and S = L L^T; then with Y = L^-1 M
    dx = Y^T L^-1 r    P := P - Y^T Y
which is the Kalman update without an inverse; P stays exactly symmetric. The error is injected,
and P follows by the reset Jacobian G = 1 - hat(dtheta) / 2 of each rotation.
Source: Sola, 1711.02508, sections 6.1 to 6.3; Markley, 2003 (attitude error representations).
"""

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import add_t_times, cholesky, forward, square, subtract_square
from tagvo.kernels.so3 import exp_quat, turn_quat
from vio.filter import state as at

# chi-square 99.9 % of 6, 3 and 8 degrees of freedom
GATE_6, GATE_3, GATE_8 = 22.457744, 16.266236, 26.124482
_WILD = 1e6  # an error so large, in any unit, is none that a filter can take


@njit
def downdate(x: Array, P: Array, L: Array, M: Array, r: Array, layout: at.Layout) -> bool:
    """Correct x and P, in place, by residual r (m,) with M = H P (m, n) and S = L L^T.

    M and r are overwritten. False, and nothing changed, where the correction is not finite.
    """
    forward(L, r.reshape((len(r), 1)))
    forward(L, M)
    dx = np.zeros(P.shape[0])
    add_t_times(M, r, dx)
    for j in range(len(dx)):
        if not abs(dx[j]) < _WILD:
            return False
    subtract_square(P, M)
    for i in range(len(P)):
        if not P[i, i] > 0.0:
            P[i, i] = 1e-18
    inject(x, P, dx, layout)
    return True


@bare
def inject(x: Array, P: Array, dx: Array, layout: at.Layout) -> None:
    """Add the error dx (n,) to the nominal state and reset it; P follows by the reset Jacobian.

    A rotation of two errors turns about x and y alone, and its reset is of second order.
    """
    for row in range(len(layout.rows)):
        e, size = layout.rows[row, 0], layout.rows[row, 1]
        at_x, turns = layout.rows[row, 2], layout.rows[row, 3] == 1
        if not turns:
            for i in range(size):
                x[at_x + i] += dx[e + i]
        else:
            z = dx[e + 2] if size > 2 else 0.0
            turn_quat(x, at_x, exp_quat(dx[e], dx[e + 1], z))
            if size > 2:
                _reset(P, e, dx)


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
    end = first + m
    L, y = S[first:end, first:end].copy(), r[first:end].copy()
    if not cholesky(L):
        return np.inf
    forward(L, y.reshape((m, 1)))
    d = square(y)
    return d if d >= 0.0 else np.inf


@bare
def add_pose_bias(x: Array, L: Array, scale: Array, H: Array, r: Array, layout: at.Layout) -> None:
    """H[:, pose_bias] := diag(scale) L, and r -= that times the bias; H (6, n), r, scale (6,)."""
    for i in range(len(scale)):
        for j in range(i + 1):
            H[i, layout.pose_bias + j] = scale[i] * L[i, j]
            r[i] -= scale[i] * L[i, j] * x[at.X_BIAS + j]
