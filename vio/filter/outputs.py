"""What leaves the filter: states and camera priors as records, from its flat vectors."""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.kernels.so3 import matrix_into
from tagvo.records import PosePrior
from vio.filter import state as at
from vio.filter.history import History
from vio.filter.measurements.camera import camera_jacobian, camera_pose
from vio.filter.propagation import propagate
from vio.records import Moment, NavState

_ORDER = np.r_[at.P : at.P + 3, at.TH : at.TH + 3, at.V : at.V + 3]
_PICK = np.ix_(_ORDER, _ORDER)
_AHEAD_NS = 50_000_000  # how far a state is predicted beyond the newest sample


def nav_state(t_ns: int, x: Array, P: Array, known_ns: int | None = None) -> NavState:
    """The record of a nominal state x (NOMINAL,) and its covariance P (n, n)."""
    R_WI = np.empty((3, 3))
    matrix_into(R_WI, *x[at.X_Q : at.X_Q + 4].tolist())  # 1 us; geometry takes 38
    p_WI, v_WI = x[at.X_P : at.X_P + 3].copy(), x[at.X_V : at.X_V + 3].copy()
    return NavState(t_ns, p_WI, R_WI, v_WI, P[_PICK], known_ns)


def moment(history: History, t_ns: int | None) -> Moment | None:
    """The filter at a stamp of the camera's clock, None: at its newest sample.

    None where its memory does not reach back so far, or the IMU has not come near the stamp.

    From the first snapshot at or after the stamp, back: only that one holds a frame of this stamp.
    """
    s, td_ns, model = history.snapshots, history.time_offset_ns, history.model
    due = history.now_ns if t_ns is None else t_ns + td_ns
    if not s.t[0] <= due <= history.now_ns + _AHEAD_NS:
        return None
    k = min(history.at_or_before(due - 1) + 1, history.last)
    x, P = s.x[k].copy(), s.P[k].copy()
    dt = (due - int(s.t[k])) * 1e-9
    if dt != 0.0:
        q = model.q.quiet() if dt < 0.0 else model.q  # going back adds no noise
        propagate(x, P, s.imu[k], dt, q, model.layout)
    up_W = geo.matrix_from_quat(x[at.X_QWL : at.X_QWL + 4])[:, 2]
    w_I = s.imu[k, 0:3] - x[at.X_BG : at.X_BG + 3]
    sigma = float(np.sqrt(np.diag(P)[at.LEVEL : at.LEVEL + 2].max()))
    return Moment(due - td_ns, nav_state(due, x, P), w_I, -up_W, sigma)


def camera_prior(history: History, t_ns: int) -> PosePrior | None:
    """The predicted camera pose at a stamp of the camera's clock; None before the history."""
    s, due, model = history.snapshots, t_ns + history.time_offset_ns, history.model
    k = history.at_or_before(due)
    if k < 0:
        return None
    x, P = s.x[k].copy(), s.P[k].copy()
    imu = s.imu[min(k + 1, history.last)]
    if due > s.t[k]:
        propagate(x, P, imu, (due - s.t[k]) * 1e-9, model.q, model.layout)
    R_WC, p_WC, H = np.empty((3, 3)), np.empty(3), np.empty((6, len(P)))
    camera_pose(x, R_WC, p_WC)
    camera_jacobian(x, imu[0:3], H, model.layout)
    return PosePrior(t_ns, p_WC, R_WC, H @ P @ H.T)
