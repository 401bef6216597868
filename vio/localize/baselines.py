"""VO-only estimators: the same protocol as the filter, so that one source feeds several arms."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array
from tagvo.pose.smoothing import Fir
from tagvo.records import Frame, Observations, PoseMeasurement
from vio.records import ImuSample


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """What an estimator says: the pose of I in W at a moment, and when that was known.

    t_ns: moment of the pose, IMU clock; known_ns: arrival; p_WI (3,) [m]; R_WI (3, 3); v_WI (3,)
    [m/s] or None; cov (6, 6) of [p in W, right rotation in I] or None.
    """

    t_ns: int
    known_ns: int
    p_WI: Array
    R_WI: Array
    v_WI: Array | None = None
    cov: Array | None = None


class Estimator(Protocol):
    """Takes samples and measured poses in order of arrival; each may bring an output."""

    @property
    def name(self) -> str: ...

    def imu(self, sample: ImuSample) -> Output | None:
        """Take an IMU sample."""

    def pose(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> Output | None:
        """Take what tagvo made of a frame: its pose (None: there is none) and the tags seen."""

    def ground(self, on_ground: bool) -> None:
        """Take whether the vehicle stands still on the ground."""


def body_output(frame: Frame, measured: PoseMeasurement, camera: Camera) -> Output:
    """The measured camera pose as one of I, its stamp moved to the IMU's clock by the timeshift."""
    R_WC, R_CI, p_CI = measured.R_WC, camera.R_CI, camera.p_CI
    G = np.zeros((6, 6))  # [dp_WI, dphi_I] = G [dp_WC, dphi_C]
    G[:3, :3], G[:3, 3:], G[3:, 3:] = np.eye(3), -R_WC @ geo.hat(p_CI), R_CI.T
    return Output(
        measured.t_ns + round(camera.timeshift_s * 1e9),
        measured.t_ns if frame.arrival_ns is None else frame.arrival_ns,
        measured.p_WC + R_WC @ p_CI,
        R_WC @ R_CI,
        cov=G @ measured.cov @ G.T,
    )


class VoArm:
    """`vo`: the pose of each frame, as it is."""

    name = "vo"

    def __init__(self, camera: Camera) -> None:
        self._camera = camera

    def imu(self, sample: ImuSample) -> Output | None:
        """VO knows no IMU."""
        return None

    def pose(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> Output | None:
        """The pose of I at the capture of this frame."""
        return None if measured is None else body_output(frame, measured, self._camera)

    def ground(self, on_ground: bool) -> None:
        """VO knows no ground."""


class VoFirArm(VoArm):
    """`vo_fir`: the same, through the paper's FIR over the last five poses."""

    name = "vo_fir"

    def __init__(self, camera: Camera, taps: str, gap_s: float) -> None:
        super().__init__(camera)
        self._fir = Fir(taps, gap_s)

    def pose(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> Output | None:
        """The smoothed pose at this frame; its covariance is not known: the errors repeat."""
        raw = super().pose(frame, measured, seen)
        if raw is None:
            return None
        p_WI, R_WI = self._fir(raw.t_ns, raw.p_WI, raw.R_WI)
        return Output(raw.t_ns, raw.known_ns, p_WI, R_WI)
