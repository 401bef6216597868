"""What the state predicts of the camera: its pose, and how that errs with the state.

Every camera measurement is one of the camera pose's error xi = [dp_WC in W, right rotation in C];
H (6, n) leads from the error state to it.
Derivation: docs/filter/measurements.md; finite differences: tests/vio/filter/test_filter_update.py.
"""

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import njit
from tagvo.kernels.linalg import add_times, copy, identity
from tagvo.kernels.so3 import matrix_into, times_hat, turn_quat
from vio.filter import state as at


@njit
def camera_pose(x: Array, R_WC: Array, p_WC: Array) -> None:
    """R_WC (3, 3), p_WC (3,) := the camera pose that the state predicts.

    R_WC = R_WI R_IC        p_WC = p_WI + R_WI p_IC
    """
    q = np.empty(4)
    R_WI = np.empty((3, 3))
    matrix_into(R_WI, x[at.X_Q], x[at.X_Q + 1], x[at.X_Q + 2], x[at.X_Q + 3])
    q[:] = x[at.X_Q : at.X_Q + 4]
    turn_quat(q, 0, (x[at.X_QIC], x[at.X_QIC + 1], x[at.X_QIC + 2], x[at.X_QIC + 3]))
    matrix_into(R_WC, q[0], q[1], q[2], q[3])
    p_WC[:] = 0.0
    add_times(R_WI, x[at.X_PIC : at.X_PIC + 3], p_WC)
    p_WC += x[at.X_P : at.X_P + 3]


@njit
def camera_jacobian(x: Array, w: Array, H: Array, layout: at.Layout) -> None:
    """H (6, n) := d xi / d error state; w (3,) gyro at that moment, bias included [rad/s].

    dp_WC   = dp_WI - R_WI hat(p_IC) dtheta + R_WI dp_IC + v_WC dt_d
    dphi_WC = R_CI dtheta + dphi_IC + R_CI w_I dt_d
    v_WC    = v_WI - R_WI hat(p_IC) w_I,   w_I = w - b_g
    """
    R_WI, R_CI, w_I = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    matrix_into(R_WI, x[at.X_Q], x[at.X_Q + 1], x[at.X_Q + 2], x[at.X_Q + 3])
    matrix_into(R_CI, x[at.X_QIC], -x[at.X_QIC + 1], -x[at.X_QIC + 2], -x[at.X_QIC + 3])
    w_I[:] = w - x[at.X_BG : at.X_BG + 3]
    H[:] = 0.0
    place, turn = H[0:3], H[3:6]
    identity(place[:, at.P : at.P + 3])
    times_hat(place[:, at.TH : at.TH + 3], R_WI, x[at.X_PIC : at.X_PIC + 3], -1.0)
    place[:, at.TD] = x[at.X_V : at.X_V + 3]
    add_times(place[:, at.TH : at.TH + 3], w_I, place[:, at.TD])
    copy(R_CI, turn[:, at.TH : at.TH + 3])
    identity(turn[:, at.EX : at.EX + 3])
    add_times(R_CI, w_I, turn[:, at.TD])
    if layout.p_IC != at.OFF:
        copy(R_WI, place[:, layout.p_IC : layout.p_IC + 3])
