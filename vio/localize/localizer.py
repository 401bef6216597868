"""The localizer: frames, IMU samples and ground reports in, the state of the IMU in the map out.

The one place where tag visual odometry and the filter are put together. The daemon, recorded
flights, autopilots in the loop, studies and tests all call it; it reads no clock.
"""

from collections import Counter
from collections.abc import Callable

from tagvo.camera.model import Camera
from tagvo.pipeline import TagVO, Trace
from tagvo.records import Detections, Frame, Observations, PoseMeasurement, PosePrior
from tagvo.tags.tag_map import TagMap
from vio.config import Config
from vio.filter.eskf import ErrorStateFilter
from vio.filter.health import State
from vio.filter.noise_model import USUAL_NOISE
from vio.localize.baselines import imu_state
from vio.records import Ground, ImuNoise, ImuSample, NavState

Event = ImuSample | Frame | Ground
_SEEING_NS = 200_000_000  # two frames at 10 Hz: what comes more slowly is not steadily seen


def _no_lap(stage: str) -> None:
    return None


class Localizer:
    """Where the IMU is in the map, event by event, in any order of arrival.

    trace: every intermediate of the newest frame; states: IMU samples spent in each state of
    health; seeing: of those once it had started, the ones up to 0.2 s after a frame with a pose;
    doubts: of those in LOST and RELOCATING, how often for which reason.
    """

    def __init__(
        self,
        camera: Camera,
        tag_map: TagMap,
        config: Config | None = None,
        imu_noise: ImuNoise | None = None,
        *,
        imu: bool = True,
        detects: bool = True,
        lap: Callable[[str], None] = _no_lap,
    ) -> None:
        """imu_noise: None is that of a Pixhawk over MAVLink; imu: False is visual odometry alone.

        detects: False where all frames come with their tags found; lap: called with the name of
        each stage as it ends.
        """
        config = config or Config()
        self.vo = TagVO(camera, tag_map, config.tagvo, lap=lap)
        self.filter: ErrorStateFilter | None = None
        if imu:
            noise, floor = imu_noise or USUAL_NOISE, config.tagvo.floor
            self.filter = ErrorStateFilter(config.vio, camera, noise, tag_map, floor)
        self.trace: Trace | None = None
        self.states: Counter[str] = Counter()
        self.seeing: Counter[str] = Counter()
        self.doubts: Counter[str] = Counter()
        self._pose_ns: int | None = None  # when the last pose was known
        self._started = False
        self._corners, self._lap = config.vio.update == "corners", lap
        tracks = config.tagvo.track.mode == "on" and detects
        self._asks_prior = tracks or config.tagvo.ambiguity == "prior"
        self._second_look = None
        if config.tagvo.ambiguity == "consistent":  # the paper's way stays its own
            asked = config.tagvo.model_copy(update={"ambiguity": "prior"})
            self._second_look = TagVO(camera, tag_map, asked)

    def process(self, event: Event) -> NavState | None:
        """Take what came; the state as known then, None where there is none or it is not asked.

        After an IMU sample that is the state at its stamp, after a frame the newest one with the
        frame fused (without an IMU: that of the frame), after a ground report none.
        """
        if isinstance(event, ImuSample):
            return self.imu(event)
        if isinstance(event, Ground):
            self.ground(event)
            return None
        self.trace = self.vo.trace(event, self.prior(event.t_ns) if self._asks_prior else None)
        return self.fuse(event, self.trace.pose, self.trace.observations)

    def imu(self, sample: ImuSample) -> NavState | None:
        """Take an IMU sample; the state at its stamp."""
        if self.filter is None:
            return None
        nav = self.filter.imu(sample)
        health = self.filter.health()
        self.states[health.state.value] += 1
        self._started = self._started or nav is not None
        if self._started and self._pose_ns is not None:
            self.seeing[health.state.value] += sample.arrival_ns - self._pose_ns < _SEEING_NS
        if health.state in (State.LOST, State.RELOCATING):
            self.doubts.update(health.reasons)
        return nav

    def ground(self, report: Ground) -> None:
        """Take whether the vehicle stands still on the ground: then the filter knows its speed."""
        if self.filter is not None:
            self.filter.ground(report.on_ground)

    def fuse(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> NavState | None:
        """Take what tagvo made of a frame, its pose (None: there is none) and the tags seen."""
        if self.filter is None:
            return None if measured is None else imu_state(frame, measured, self.vo.camera)
        measured = self._resolved(frame.t_ns, measured, seen)
        if self._corners and seen is not None and len(seen):
            self.filter.corners(frame.t_ns, seen, measured)
        elif measured is not None:
            self.filter.pose(measured)
        known_ns = frame.t_ns if frame.arrival_ns is None else frame.arrival_ns
        if measured is not None:
            self._pose_ns = known_ns
        nav = self.filter.nav(known_ns)
        self._lap("filter")
        return nav

    def prior(self, t_ns: int) -> PosePrior | None:
        """Where the camera should be at a stamp of its clock; None without a started filter."""
        return None if self.filter is None else self.filter.prior(t_ns)

    def _resolved(
        self, t_ns: int, measured: PoseMeasurement | None, seen: Observations | None
    ) -> PoseMeasurement | None:
        """The pose, its planar ambiguity settled by where the filter expects the camera."""
        if self._second_look is None or measured is None or "ambiguous" not in measured.flags:
            return measured
        prior = self.prior(t_ns)
        if prior is None or seen is None:
            return measured
        tags = Detections.of(seen.tag_id, seen.corners_px, sigma_px=seen.sigma_px)
        frame = Frame(t_ns, detections=tags, camera=seen.camera)
        return self._second_look(frame, prior) or measured
