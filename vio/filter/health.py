"""The filter's word on itself: a state, and the reasons for it."""

from dataclasses import dataclass
from enum import StrEnum

from vio.config.filter import HealthConfig


class State(StrEnum):
    """INIT: not started; COASTING: on the IMU alone; LOST: do not fly on it; RELOCATING: vision
    disagrees with the filter, and may be right."""

    INIT = "INIT"
    TRACKING = "TRACKING"
    COASTING = "COASTING"
    LOST = "LOST"
    RELOCATING = "RELOCATING"


@dataclass(frozen=True, slots=True)
class Signs:
    """What health is judged by.

    age_s: of the last accepted pose; rejects in a row since; nis: median per dof of the last
    second; sigma_m, sigma_deg: of position and attitude now; imu_late_s: how far the newest pose
    is ahead of the IMU; calibration_far: a calibration state is beyond what its prior can mean.
    """

    age_s: float
    rejects: int
    nis: float
    sigma_m: float
    sigma_deg: float
    imu_degraded: bool
    imu_late_s: float = 0.0
    calibration_far: bool = False


@dataclass(frozen=True, slots=True)
class Health:
    """State, why, the signs it was judged by, and how often the estimate has jumped."""

    state: State
    reasons: tuple[str, ...]
    signs: Signs | None
    resets: int


_REJECTS = 3  # in a row: vision and filter disagree
_NIS = 4.0  # per dof: the filter is surprised


def judge(
    signs: Signs | None,
    resets: int,
    waiting: tuple[str, ...],
    config: HealthConfig,
    distrust: tuple[str, ...] = (),
) -> Health:
    """Health from its signs; None: not started, `waiting` says for what.

    distrust: why the filter is not to be believed whatever it says of itself (a wrong set-up).
    What makes it LOST counts before all else: a filter that relocates is lost meanwhile, too.
    """
    if signs is None:
        state = State.LOST if distrust else State.INIT
        return Health(state, (*distrust, *waiting), None, resets)
    reasons = list(distrust)
    if signs.sigma_m > config.lost_sigma_m:
        reasons.append("position_sigma")
    if signs.sigma_deg > config.lost_sigma_deg:
        reasons.append("attitude_sigma")
    if signs.age_s > config.lost_after_s:
        reasons.append("no_pose_for_long")
    if signs.imu_late_s > config.imu_late_s:
        reasons.append("imu_stalled")
    if signs.calibration_far:
        reasons.append("calibration_far")
    lost = bool(reasons)
    stale = signs.age_s > config.coasting_after_s
    if stale:
        reasons.append("no_pose")
    disputed = signs.rejects >= _REJECTS
    if disputed:
        reasons.append("poses_rejected")
    if signs.nis > _NIS:
        reasons.append("innovation")
    if signs.imu_degraded:
        reasons.append("imu_gap")
    if lost:
        state = State.LOST
    elif disputed and stale:
        state = State.RELOCATING
    else:
        state = State.COASTING if stale else State.TRACKING
    return Health(state, tuple(reasons), signs, resets)
