"""A camera pose as a measurement: about the point of the map that the camera saw best.

The position of a camera over few tags is uncertain along an arc about them: where it is and how it
is turned err together, and a linear update about the camera's position would leave the arc. The
place of the tags in the camera is known well whatever the rotation; so the measurement is that
place (its pivot, found from the covariance alone) and the rotation. A flipped planar solution then
spoils the rotation alone.
Derivation: docs/filter/measurements.md; against Joseph's form and filterpy: test_filter_update.py.
"""

import math
from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import (
    add_t_times,
    add_times,
    backward,
    cholesky,
    copy,
    forward,
    multiply,
    times_ht,
    times_p,
)
from tagvo.kernels.so3 import quaternion, times_hat, turn_quat
from tagvo.records import PoseMeasurement
from vio.filter import state as at
from vio.filter.adaptive_noise import Trust
from vio.filter.measurements import kinds
from vio.filter.measurements.camera import camera_jacobian, camera_pose
from vio.filter.update import GATE_3, GATE_6, add_pose_bias, distance, downdate

NUMBERS = 3 + 4 + 36 + 3


class PoseRow(NamedTuple):
    """A pose's payload as views: the pivot in C (3,) and in W (3,) [m], q_WC (4,), cov (6, 6).

    cov is that of [pivot in C, right rotation in C].
    """

    pivot_C: Array
    q_WC: Array
    cov: Array
    pivot_W: Array


@njit
def unpack(z: Array) -> PoseRow:
    """Views of a payload z (NUMBERS,)."""
    return PoseRow(z[0:3], z[3:7], z[7:43].reshape((6, 6)), z[43:46])


def pivot_of(R_WC: Array, cov: Array) -> Array:
    """The point in C (3,) whose place in C errs independently of the rotation, as far as any does.

    cov (6, 6) of [p_WC in W, right rotation in C]; zero where the two are independent already.
    """
    pivot_C = np.empty(3)
    _pivot(R_WC, cov, pivot_C)
    return pivot_C


@njit
def _pivot(R_WC: Array, cov: Array, pivot_C: Array) -> None:
    """Least squares for hat(y) C_tt = R_WC^T C_pt, y (3,) into pivot_C.

    Linear in y: hat(y) C_tt = sum_a y_a A_a with A_a = hat(e_a) C_tt; normal matrix
    N_ac = <A_a, A_c>, right side <A_a, R_WC^T C_pt>, products over all nine entries.
    """
    axes, b = np.zeros((3, 9)), np.empty((3, 3))
    N, y = np.empty((3, 3)), np.zeros((3, 1))
    multiply(R_WC.T, cov[:3, 3:], b)
    for j in range(len(N)):  # the columns of C_tt, crossed with each e_a
        u, v, w = cov[3, 3 + j], cov[4, 3 + j], cov[5, 3 + j]
        axes[0, 3 + j], axes[0, 6 + j] = -w, v
        axes[1, j], axes[1, 6 + j] = w, -u
        axes[2, j], axes[2, 3 + j] = -v, u
    multiply(axes, axes.T, N)
    add_times(axes, b.reshape(9), y[:, 0])
    ridge = 1e-12 * (N[0, 0] + N[1, 1] + N[2, 2])
    for a in range(len(N)):
        N[a, a] += ridge
    if cholesky(N):
        forward(N, y)
        backward(N, y)
    else:
        y[:] = 0.0
    pivot_C[:] = y[:, 0]


@njit
def _fill(R_WC: Array, p_WC: Array, cov: Array, z: Array) -> None:
    """The payload of a pose, into z (NUMBERS,): cov about the pivot y is T cov T^T.

    pivot in C: y = R_WC^T (p_W - p_WC)    T = [-R_WC^T  hat(y)]
                                               [ 0        1     ]
    """
    row, T, half = unpack(z), np.zeros((6, 6)), np.empty((6, 6))
    _pivot(R_WC, cov, row.pivot_C)
    quaternion(R_WC, row.q_WC)
    if row.q_WC[0] < 0.0:
        row.q_WC[:] = -row.q_WC
    row.pivot_W[:] = p_WC
    add_times(R_WC, row.pivot_C, row.pivot_W)
    T[:3, :3] = -R_WC.T
    T[3, 3] = T[4, 4] = T[5, 5] = 1.0
    times_hat(T[:3, 3:], T[3:, 3:], row.pivot_C, 1.0)
    multiply(T, cov, half)
    multiply(half, T.T, row.cov)


def pack(measured: PoseMeasurement) -> Array:
    """The measurement as a row of the history."""
    row = np.empty(kinds.HEAD + NUMBERS)
    row[: kinds.HEAD] = kinds.POSE, 1.0, measured.camera
    R, p, cov = (np.ascontiguousarray(a) for a in (measured.R_WC, measured.p_WC, measured.cov))
    _fill(R, p, cov, row[kinds.HEAD :])
    return row


@njit
def residual(x: Array, row: PoseRow, r: Array, y: Array, R_WC: Array) -> None:
    """r (6,) := measured minus predicted pivot in C [m], and rotation [rad].

    y = R_WC^T (pivot_W - p_WC),   r = [pivot_C - y, Log(R_WC^T R_WC,measured)]
    y (3,) receives the predicted pivot in C, R_WC (3, 3) the predicted rotation.
    """
    q, p_WC = np.empty(4), np.empty(3)
    camera_pose(x, R_WC, p_WC)
    q[:] = x[at.X_Q : at.X_Q + 4]
    turn_quat(q, 0, (x[at.X_QIC], x[at.X_QIC + 1], x[at.X_QIC + 2], x[at.X_QIC + 3]))
    q[1:] = -q[1:]
    turn_quat(q, 0, (row.q_WC[0], row.q_WC[1], row.q_WC[2], row.q_WC[3]))
    s = math.sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    sign = -1.0 if q[0] < 0.0 else 1.0
    k = 2.0 * sign if s < 1e-9 else 2.0 * math.atan2(s, abs(q[0])) / s * sign
    y[:] = 0.0
    add_t_times(R_WC, row.pivot_W - p_WC, y)
    r[:3] = row.pivot_C - y
    r[3:] = k * q[1:]


@bare
def pivot_rows(H: Array, R_WC: Array, y: Array) -> None:
    """H (6, n) := d [pivot in C, rotation] / d error state, from d xi / d error state, in place.

    dy = -R_WC^T dp_WC + hat(y) dphi_WC, column by column
    """
    for j in range(H.shape[1]):
        a, b, c = H[0, j], H[1, j], H[2, j]
        u, v, w = H[3, j], H[4, j], H[5, j]
        H[0, j] = y[1] * w - y[2] * v - (R_WC[0, 0] * a + R_WC[1, 0] * b + R_WC[2, 0] * c)
        H[1, j] = y[2] * u - y[0] * w - (R_WC[0, 1] * a + R_WC[1, 1] * b + R_WC[2, 1] * c)
        H[2, j] = y[0] * v - y[1] * u - (R_WC[0, 2] * a + R_WC[1, 2] * b + R_WC[2, 2] * c)


@njit
def linearize(x: Array, w: Array, row: PoseRow, r: Array, H: Array, layout: at.Layout) -> None:
    """Residual r (6,) and its derivative H (6, n) by the error state; w (3,) gyro then [rad/s]."""
    y, R_WC = np.empty(3), np.empty((3, 3))
    residual(x, row, r, y, R_WC)
    camera_jacobian(x, w, H, layout)
    pivot_rows(H, R_WC, y)


@njit
def update(
    x: Array, P: Array, w: Array, z: Array, trust: Trust, y_white: Array, layout: at.Layout
) -> tuple[int, float]:
    """Correct by a camera pose's payload z; what became of it, and its NIS.

    S = H P H^T + k D cov D,  D^2 = 1 - share of the pose bias, which H sees with the rest; where S
    gates all six rows out, position or rotation alone may pass. w (3,) gyro then; y_white (6,)
    receives the innovation, bias and all, whitened by cov.
    """
    n, row = P.shape[0], unpack(z)
    H, M, S, r = np.empty((6, n)), np.empty((6, n)), np.empty((6, 6)), np.empty(6)
    linearize(x, w, row, r, H, layout)
    L, white, slow = np.empty((6, 6)), np.empty((6, 1)), np.empty(6)
    copy(row.cov, L)
    white[:, 0] = r
    if not cholesky(L):
        return kinds.SINGULAR, np.inf
    forward(L, white)
    y_white[:] = white[:, 0]
    slow[:3], slow[3:] = trust.slow_position, trust.slow_rotation
    if trust.slow_position > 0.0:
        add_pose_bias(x, L, np.sqrt(slow), H, r, layout)
    times_p(H, P, M)
    times_ht(M, H, S)
    for i in range(len(S)):
        for j in range(len(S)):
            white_share = math.sqrt((1.0 - slow[i]) * (1.0 - slow[j]))
            S[i, j] += trust.inflation * white_share * row.cov[i, j]
    nis = distance(S, r, 0, 6)
    if nis == np.inf or nis != nis:
        return kinds.SINGULAR, nis
    first, m, verdict = 0, 6, kinds.ACCEPTED
    if nis > GATE_6 * trust.gate:
        if distance(S, r, 0, 3) <= GATE_3 * trust.gate:
            m, verdict = 3, kinds.POSITION_ONLY
        elif distance(S, r, 3, 3) <= GATE_3 * trust.gate:
            first, m, verdict = 3, 3, kinds.ROTATION_ONLY
        else:
            return kinds.REJECTED, nis
    L = S[first : first + m, first : first + m].copy()
    good = cholesky(L)
    good = good and downdate(x, P, L, M[first : first + m], r[first : first + m], layout)
    return (verdict if good else kinds.SINGULAR), nis
