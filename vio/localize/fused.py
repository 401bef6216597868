"""The filter, and a constant-velocity Kalman filter on the VO, as arms of a comparison."""

from collections import Counter
from typing import Any

import numpy as np

from tagvo.camera.model import Camera
from tagvo.geometry import Array
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame, Observations, PoseMeasurement, PosePrior
from vio.filter.eskf import ErrorStateFilter
from vio.filter.health import State
from vio.localize.baselines import Output, VoArm
from vio.records import ImuSample, NavState

_SEEING_NS = 200_000_000  # two frames at 10 Hz: what comes more slowly is not steadily seen


class VioArm:
    """`vio`: the filter; an output at every IMU sample once started, valid at its stamp.

    states: IMU samples spent in each state of health; seeing: of those once it had started, the
    ones up to 0.2 s after a frame with a pose; doubts: in LOST and RELOCATING, by reason.
    """

    name = "vio"

    def __init__(
        self, estimator: ErrorStateFilter, vo: TagVO | None = None, corners: bool = False
    ) -> None:
        """vo: is asked again, with the filter's prior, about a frame whose pose is ambiguous.

        corners: correct by each tag's corners, not by the pose of the frame.
        """
        self.estimator = estimator
        self.states: Counter[str] = Counter()
        self.seeing: Counter[str] = Counter()
        self.doubts: Counter[str] = Counter()
        self._pose_ns: int | None = None  # when the last pose was known
        self._started = False
        self._corners = corners
        self._second_look = None
        if vo is not None and vo.config.ambiguity == "consistent":  # the paper's way stays its own
            asked = vo.config.model_copy(update={"ambiguity": "prior"})
            self._second_look = TagVO(vo.camera, vo.tag_map, asked)

    def imu(self, sample: ImuSample) -> Output | None:
        """The state at this sample."""
        nav = self.estimator.imu(sample)
        health = self.estimator.health()
        self.states[health.state.value] += 1
        self._started = self._started or nav is not None
        if self._started and self._pose_ns is not None:
            self.seeing[health.state.value] += sample.arrival_ns - self._pose_ns < _SEEING_NS
        if health.state in (State.LOST, State.RELOCATING):
            self.doubts.update(health.reasons)
        return None if nav is None else _output(nav, sample.arrival_ns)

    def ground(self, on_ground: bool) -> None:
        """On the ground the filter takes a velocity of zero."""
        self.estimator.ground(on_ground)

    def prior(self, t_ns: int) -> PosePrior | None:
        """Where the camera should be at a stamp of its clock."""
        return self.estimator.prior(t_ns)

    def pose(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> Output | None:
        """Fuse a frame, by its pose or by the tags' corners; the state as known then."""
        measured = self._resolved(frame.t_ns, measured, seen)
        if self._corners and seen is not None and len(seen):
            self.estimator.corners(frame.t_ns, seen, measured)
        elif measured is not None:
            self.estimator.pose(measured)
        nav = self.estimator.nav()
        known_ns = frame.t_ns if frame.arrival_ns is None else frame.arrival_ns
        if measured is not None:
            self._pose_ns = known_ns
        return None if nav is None else _output(nav, known_ns)

    def _resolved(
        self, t_ns: int, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> PoseMeasurement | None:
        """The pose, its planar ambiguity settled by where the filter expects the camera."""
        if self._second_look is None or measured is None or "ambiguous" not in measured.flags:
            return measured
        prior = self.estimator.prior(t_ns)
        if prior is None or seen is None:
            return measured
        tags = Detections.of(seen.tag_id, seen.corners_px, sigma_px=seen.sigma_px)
        return self._second_look(Frame(t_ns, detections=tags), prior) or measured


def _output(nav: NavState, known_ns: int) -> Output:
    cov = None if nav.cov is None else nav.cov[:6, :6]
    return Output(nav.t_ns, known_ns, nav.p_WI, nav.R_WI, nav.v_WI, cov)


class VoKfArm(VoArm):
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

    def pose(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> Output | None:
        """The filtered pose at this frame."""
        raw = super().pose(frame, measured, seen)
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
        return Output(raw.t_ns, raw.known_ns, x[:3].copy(), raw.R_WI, x[3:].copy(), cov)

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
