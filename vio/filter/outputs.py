"""What leaves the filter: states and camera priors as records, from its flat vectors."""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.records import PosePrior
from vio.filter import state as at
from vio.filter.history import Window
from vio.filter.measurements.predicted import camera_jacobian, camera_pose
from vio.filter.propagation import propagate
from vio.records import Moment, NavState

_ORDER = np.r_[at.P : at.P + 3, at.TH : at.TH + 3, at.V : at.V + 3]
_PICK = np.ix_(_ORDER, _ORDER)
_AHEAD_NS = 50_000_000  # how far a state is predicted beyond the newest sample
_NOISES = [i for i in range(at.NOISE) if i not in (at.N_GRAVITY, at.N_BIAS_RATE)]


def nav_state(t_ns: int, x: Array, P: Array) -> NavState:
    """The record of a nominal state x (NOMINAL,) and its covariance P (n, n)."""
    R_WI = geo.matrix_from_quat(x[at.X_Q : at.X_Q + 4])
    return NavState(
        t_ns, x[at.X_P : at.X_P + 3].copy(), R_WI, x[at.X_V : at.X_V + 3].copy(), P[_PICK]
    )


def moment(window: Window, t_ns: int | None) -> Moment | None:
    """The filter at a stamp of the camera's clock, None: at its newest sample.

    None where its memory does not reach back so far, or the IMU has not come near the stamp.

    From the first snapshot at or after the stamp, back: only that one holds a frame of this stamp.
    """
    td_ns = round(window.X[window.last, at.X_TD] * 1e9)
    due = window.now_ns if t_ns is None else t_ns + td_ns
    if not window.t[0] <= due <= window.now_ns + _AHEAD_NS:
        return None
    k = min(window.at_or_before(due - 1) + 1, window.last)
    x, P = window.X[k].copy(), window.P[k].copy()
    dt = (due - int(window.t[k])) * 1e-9
    if dt != 0.0:
        q = window.q.copy()
        if dt < 0.0:  # going back adds no noise
            q[_NOISES] = 0.0
        propagate(x, P, window.imu[k], dt, q)
    up_W = geo.matrix_from_quat(x[at.X_QWG : at.X_QWG + 4])[:, 2]
    w_I = window.imu[k, 0:3] - x[at.X_BG : at.X_BG + 3]
    sigma = float(np.sqrt(np.diag(P)[at.GR : at.GR + 2].max()))
    return Moment(due - td_ns, nav_state(due, x, P), w_I, -up_W, sigma)


def camera_prior(window: Window, t_ns: int) -> PosePrior | None:
    """The predicted camera pose at a stamp of the camera's clock; None before the window."""
    due = t_ns + round(window.X[window.last, at.X_TD] * 1e9)
    k = window.at_or_before(due)
    if k < 0:
        return None
    x, P = window.X[k].copy(), window.P[k].copy()
    imu = window.imu[min(k + 1, window.last)]
    if due > window.t[k]:
        propagate(x, P, imu, (due - window.t[k]) * 1e-9, window.q)
    R_WC, p_WC, H = np.empty((3, 3)), np.empty(3), np.empty((6, len(P)))
    camera_pose(x, R_WC, p_WC)
    camera_jacobian(x, imu[0:3], H)
    return PosePrior(t_ns, p_WC, R_WC, H @ P @ H.T)
