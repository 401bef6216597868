"""What the state predicts of the camera, compiled: its pose, and how that errs with the state.

The camera pose's error is xi = [dp_WC in W, right rotation in C]; H (6, n) leads from the error
state to it. Every camera measurement is one of xi.
"""

import math

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from vio.filter import state as at
from vio.filter.propagation import matrix_into, turn_quat


@njit
def camera_pose(x: Array, R_WC: Array, p_WC: Array) -> None:
    """R_WC (3, 3), p_WC (3,) := the camera pose that the state predicts."""
    q = np.empty(4)
    R_WI = np.empty((3, 3))
    matrix_into(R_WI, x[at.X_Q], x[at.X_Q + 1], x[at.X_Q + 2], x[at.X_Q + 3])
    q[:] = x[at.X_Q : at.X_Q + 4]
    turn_quat(q, 0, (x[at.X_QIC], x[at.X_QIC + 1], x[at.X_QIC + 2], x[at.X_QIC + 3]))
    matrix_into(R_WC, q[0], q[1], q[2], q[3])
    for i in range(3):
        lever = 0.0
        for k in range(3):
            lever += R_WI[i, k] * x[at.X_PIC + k]
        p_WC[i] = x[at.X_P + i] + lever


@bare
def _times_hat(out: Array, row: int, col: int, R: Array, v: Array, s: float) -> None:
    """out[row:row+3, col:col+3] := s R hat(v)."""
    for i in range(3):
        out[row + i, col] = s * (R[i, 1] * v[2] - R[i, 2] * v[1])
        out[row + i, col + 1] = s * (R[i, 2] * v[0] - R[i, 0] * v[2])
        out[row + i, col + 2] = s * (R[i, 0] * v[1] - R[i, 1] * v[0])


@njit
def camera_jacobian(x: Array, w: Array, H: Array) -> None:
    """H (6, n) := d xi / d error state; w (3,) gyro at that moment, bias included [rad/s]."""
    n = H.shape[1]
    R_WI, R_CI = np.empty((3, 3)), np.empty((3, 3))
    matrix_into(R_WI, x[at.X_Q], x[at.X_Q + 1], x[at.X_Q + 2], x[at.X_Q + 3])
    matrix_into(R_CI, x[at.X_QIC], -x[at.X_QIC + 1], -x[at.X_QIC + 2], -x[at.X_QIC + 3])
    H[:] = 0.0
    _times_hat(H, 0, at.TH, R_WI, x[at.X_PIC : at.X_PIC + 3], -1.0)
    for i in range(3):
        H[i, at.P + i] = 1.0
        H[3 + i, at.EX + i] = 1.0
        H[i, at.TD] = x[at.X_V + i]
        for k in range(3):
            rate = w[k] - x[at.X_BG + k]
            H[i, at.TD] += H[i, at.TH + k] * rate
            H[3 + i, at.TH + k] = R_CI[i, k]
            H[3 + i, at.TD] += R_CI[i, k] * rate
            if n >= at.WITH_LEVER:
                H[i, at.LEVER + k] = R_WI[i, k]


@njit
def pose_residual(x: Array, z: Array, r: Array, y: Array, R_WC: Array) -> None:
    """r (6,) := measured minus predicted pivot in C [m] and rotation [rad]; z: see `pivot`.

    y (3,) receives the predicted pivot in C, R_WC (3, 3) the predicted rotation.
    """
    q, p_WC = np.empty(4), np.empty(3)
    camera_pose(x, R_WC, p_WC)
    q[:] = x[at.X_Q : at.X_Q + 4]
    turn_quat(q, 0, (x[at.X_QIC], x[at.X_QIC + 1], x[at.X_QIC + 2], x[at.X_QIC + 3]))
    q[1], q[2], q[3] = -q[1], -q[2], -q[3]
    turn_quat(q, 0, (z[3], z[4], z[5], z[6]))
    s = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    sign = -1.0 if q[0] < 0.0 else 1.0
    k = 2.0 * sign if s < 1e-9 else 2.0 * math.atan2(s, abs(q[0])) / s * sign
    for i in range(3):
        y[i] = 0.0
        for j in range(3):
            y[i] += R_WC[j, i] * (z[43 + j] - p_WC[j])
        r[i] = z[i] - y[i]
        r[3 + i] = k * q[1 + i]


@bare
def pivot_rows(H: Array, R_WC: Array, y: Array, active: int) -> None:
    """H (6, n) := d [pivot in C, rotation] / d error state, from d xi / d error state, in place."""
    for j in range(active):
        a, b, c = H[0, j], H[1, j], H[2, j]
        u, v, w = H[3, j], H[4, j], H[5, j]
        H[0, j] = y[1] * w - y[2] * v - (R_WC[0, 0] * a + R_WC[1, 0] * b + R_WC[2, 0] * c)
        H[1, j] = y[2] * u - y[0] * w - (R_WC[0, 1] * a + R_WC[1, 1] * b + R_WC[2, 1] * c)
        H[2, j] = y[0] * v - y[1] * u - (R_WC[0, 2] * a + R_WC[1, 2] * b + R_WC[2, 2] * c)
