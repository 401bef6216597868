"""A camera pose as the filter takes it: about the point of the map that the camera saw best.

The position of a camera over few tags is uncertain along an arc about them: where it is and how it
is turned err together, and a linear update about the camera's position would leave the arc. The
place of the tags in the camera is known well whatever the rotation; so the measurement is that
place (its pivot, found from the covariance alone) and the rotation. A flipped planar solution then
spoils the rotation alone.
"""

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import backward, cholesky, forward, multiply, njit, quaternion
from tagvo.records import PoseMeasurement
from vio.filter import state as at


def pivot_of(R_WC: Array, cov: Array) -> Array:
    """The point in C (3,) whose place in C errs independently of the rotation, as far as any does.

    cov (6, 6) of [p_WC in W, right rotation in C]; zero where the two are independent already.
    """
    pivot_C = np.empty(3)
    _pivot(R_WC, cov, pivot_C)
    return pivot_C


@njit
def _pivot(R_WC: Array, cov: Array, pivot_C: Array) -> None:
    """Least squares for [y] x C_tt = R_WC^T C_pt, y (3,) into pivot_C."""
    turned, b = np.empty((3, 3, 3)), np.empty((3, 3))
    N, y = np.empty((3, 3)), np.zeros((3, 1))
    for i in range(3):
        for j in range(3):
            b[i, j] = 0.0
            for k in range(3):
                b[i, j] += R_WC[k, i] * cov[k, 3 + j]
    for j in range(3):  # column j of hat(e_a) C_tt is the cross product of e_a and column j of C_tt
        x, y_, z = cov[3, 3 + j], cov[4, 3 + j], cov[5, 3 + j]
        turned[0, 0, j], turned[0, 1, j], turned[0, 2, j] = 0.0, -z, y_
        turned[1, 0, j], turned[1, 1, j], turned[1, 2, j] = z, 0.0, -x
        turned[2, 0, j], turned[2, 1, j], turned[2, 2, j] = -y_, x, 0.0
    for a in range(3):
        for c in range(3):
            N[a, c] = 0.0
            for i in range(3):
                for j in range(3):
                    N[a, c] += turned[a, i, j] * turned[c, i, j]
        for i in range(3):
            for j in range(3):
                y[a, 0] += turned[a, i, j] * b[i, j]
    ridge = 1e-12 * (N[0, 0] + N[1, 1] + N[2, 2])
    for a in range(3):
        N[a, a] += ridge
    if cholesky(N):
        forward(N, y)
        backward(N, y)
    else:
        y[:] = 0.0
    for a in range(3):
        pivot_C[a] = y[a, 0]


@njit
def _row(R_WC: Array, p_WC: Array, cov: Array, row: Array) -> None:
    """Pivot, attitude, covariance about the pivot and the pivot in W, into row (POSE_NUMBERS,)."""
    pivot_C, q_WC, T = np.empty(3), np.empty(4), np.zeros((6, 6))
    _pivot(R_WC, cov, pivot_C)
    quaternion(R_WC, q_WC)
    sign = -1.0 if q_WC[0] < 0.0 else 1.0
    for a in range(3):
        row[a], row[_WORLD + a] = pivot_C[a], p_WC[a]
        T[3 + a, 3 + a] = 1.0
        for k in range(3):
            row[_WORLD + a] += R_WC[a, k] * pivot_C[k]
            T[a, k] = -R_WC[k, a]
    for a in range(4):
        row[3 + a] = sign * q_WC[a]
    T[0, 4], T[0, 5], T[1, 5] = -pivot_C[2], pivot_C[1], -pivot_C[0]
    T[1, 3], T[2, 3], T[2, 4] = pivot_C[2], -pivot_C[1], pivot_C[0]
    half, about = np.empty((6, 6)), np.empty((6, 6))
    multiply(T, cov, half)
    multiply(half, T.T, about)
    for a in range(6):
        for k in range(6):
            row[_COV + 6 * a + k] = about[a, k]


_COV, _WORLD = 7, 43  # where in the row


def pose_row(measured: PoseMeasurement) -> Array:
    """The measurement as a row of `layout`: kind, count, pivot in C, q_WC, cov, pivot in W."""
    row = np.empty(2 + at.POSE_NUMBERS)
    row[0], row[1] = at.M_POSE, 1.0
    R, p, cov = (np.ascontiguousarray(a) for a in (measured.R_WC, measured.p_WC, measured.cov))
    _row(R, p, cov, row[2:])
    return row
