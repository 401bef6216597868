"""What the filter is compared with: visual odometry alone, smoothed, and in a Kalman filter."""

from typing import Any, Protocol

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array
from tagvo.pose.smoothing import Fir
from tagvo.records import Frame, PoseMeasurement
from vio.records import NavState


class Estimator(Protocol):
    """What a comparison sets beside the filter: it sees each frame's pose, and no IMU."""

    @property
    def name(self) -> str: ...

    def pose(self, frame: Frame, measured: PoseMeasurement | None) -> NavState | None:
        """Take what tagvo made of a frame (None: no pose); the state of I at its capture."""


def imu_state(frame: Frame, measured: PoseMeasurement, camera: Camera) -> NavState:
    """The measured camera pose as a state of I, its stamp moved to the IMU's clock.

    p_WI = p_WC + R_WC p_CI    R_WI = R_WC R_CI    [dp_WI, dphi_I] = G [dp_WC, dphi_C]
    """
    R_WC, R_CI, p_CI = measured.R_WC, camera.R_CI, camera.p_CI
    G = np.zeros((6, 6))
    G[:3, :3], G[:3, 3:], G[3:, 3:] = np.eye(3), -R_WC @ geo.hat(p_CI), R_CI.T
    return NavState(
        measured.t_ns + round(camera.timeshift_s * 1e9),
        measured.p_WC + R_WC @ p_CI,
        R_WC @ R_CI,
        cov=G @ measured.cov @ G.T,
        known_ns=measured.t_ns if frame.arrival_ns is None else frame.arrival_ns,
    )


class VoOnly:
    """`vo`: the pose of each frame, as it is."""

    name = "vo"

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def pose(self, frame: Frame, measured: PoseMeasurement | None) -> NavState | None:
        """The pose of I at the capture of this frame."""
        return None if measured is None else imu_state(frame, measured, self._camera)


class VoFir(VoOnly):
    """`vo_fir`: the same, through the paper's FIR over the last five poses."""

    name = "vo_fir"

    def __init__(self, camera: Camera, taps: str, gap_s: float) -> None:
        super().__init__(camera)
        self._fir = Fir(taps, gap_s)

    def pose(self, frame: Frame, measured: PoseMeasurement | None) -> NavState | None:
        """The smoothed pose at this frame; its covariance is not known: the errors repeat."""
        raw = super().pose(frame, measured)
        if raw is None:
            return None
        p_WI, R_WI = self._fir(raw.t_ns, raw.p_WI, raw.R_WI)
        return NavState(raw.t_ns, p_WI, R_WI, known_ns=raw.known_ns)


class VoKf(VoOnly):
    """`vo_kf`: filterpy's Kalman filter with constant velocity on the positions of the VO.

    The rotation is the VO's own; after `gap_s` without a pose the filter starts again.
    """

    name = "vo_kf"

    def __init__(self, camera: Camera, accel_m_s2: float = 1.0, gap_s: float = 1.0) -> None:
        """accel_m_s2: standard deviation of the acceleration that the model does not know."""
        super().__init__(camera)
        self._accel, self._gap_s = accel_m_s2, gap_s
        self._kf: Any = None
        self._t_ns = 0

    def pose(self, frame: Frame, measured: PoseMeasurement | None) -> NavState | None:
        """The filtered pose at this frame."""
        raw = super().pose(frame, measured)
        if raw is None or raw.cov is None or not np.isfinite(raw.cov).all():
            return None
        dt = (raw.t_ns - self._t_ns) * 1e-9
        if self._kf is None or dt > self._gap_s:
            self._start(raw.p_WI, raw.cov[:3, :3])
        elif dt <= 0.0:
            return None
        else:
            self._step(dt, raw.p_WI, raw.cov[:3, :3])
        self._t_ns = raw.t_ns
        x, P = self._kf.x[:, 0], self._kf.P
        cov = _block(P[:3, :3], raw.cov[3:, 3:])
        return NavState(raw.t_ns, x[:3].copy(), raw.R_WI, x[3:].copy(), cov, raw.known_ns)

    def _start(self, p_WI: Array, cov: Array) -> None:
        from filterpy.kalman import KalmanFilter

        self._kf = KalmanFilter(dim_x=6, dim_z=3)
        self._kf.x[:3, 0] = p_WI
        self._kf.H = np.hstack([np.eye(3), np.zeros((3, 3))])
        self._kf.P = _block(cov, np.eye(3))

    def _step(self, dt: float, p_WI: Array, cov: Array) -> None:
        from filterpy.common import Q_discrete_white_noise

        F = np.eye(6)
        F[:3, 3:] = dt * np.eye(3)
        q = Q_discrete_white_noise(dim=2, dt=dt, var=self._accel**2)
        self._kf.predict(F=F, Q=np.kron(q, np.eye(3)))
        self._kf.update(p_WI, R=cov)


def _block(A: Array, B: Array) -> Array:
    """Block diagonal (6, 6) of two (3, 3)."""
    out = np.zeros((6, 6))
    out[:3, :3], out[3:, 3:] = A, B
    return out
