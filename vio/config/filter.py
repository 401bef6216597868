"""What can be set about the filter: one frozen model, every figure with its unit."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

ShareFloat = Annotated[float, Field(ge=0.0, lt=1.0)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PriorConfig(_Model):
    """Standard deviations at the start, per axis."""

    position_m: float = Field(default=0.5, ge=1e-4, le=1e3, description="position [m]")
    velocity_m_s: float = Field(
        default=1.0, ge=1e-4, le=100.0, description="velocity, in motion [m/s]"
    )
    attitude_deg: float = Field(default=12.0, ge=1e-3, le=180.0, description="attitude [deg]")
    gyro_bias_rad_s: float = Field(
        default=0.05, ge=1e-6, le=10.0, description="gyro bias, in motion [rad/s]"
    )
    accel_bias_m_s2: float = Field(
        default=0.2, ge=1e-6, le=100.0, description="accelerometer bias [m/s^2]"
    )
    extrinsic_rotation_deg: float = Field(
        default=1.5,
        ge=0.0,
        le=180.0,
        description="how wrong the calibration file's rotation may be [deg]",
    )
    time_offset_s: float = Field(
        default=0.03, ge=0.0, le=10.0, description="how wrong its time offset may be [s]"
    )
    gravity_deg: float = Field(
        default=8.0,
        ge=1e-3,
        le=180.0,
        description="gravity's direction, where the map does not say it [deg]",
    )
    lever_arm_m: float = Field(
        default=0.01,
        ge=1e-6,
        le=10.0,
        description="the camera's place in the IMU, with lever_arm [m]",
    )


class StartConfig(_Model):
    """When there is enough to start: in motion, and at rest."""

    poses: int = Field(default=5, ge=1, le=1000, description="how many poses are needed at least")
    span_s: float = Field(
        default=0.4, ge=0.01, le=60.0, description="how long a time they cover [s]"
    )
    still_s: float = Field(
        default=1.0, ge=0.05, le=60.0, description="at rest: how much IMU is averaged [s]"
    )
    still_gyro_rad_s: float = Field(
        default=0.02,
        ge=1e-5,
        le=10.0,
        description="largest standard deviation of the gyro that counts as rest [rad/s]",
    )
    still_accel_m_s2: float = Field(
        default=0.2, ge=1e-4, le=100.0, description="largest one of the specific force [m/s^2]"
    )


class RigConfig(_Model):
    """How well a calibration holds once the flight has confirmed it, and when it can tell."""

    rotation_deg: float = Field(
        default=0.05,
        ge=1e-5,
        le=90.0,
        description="how well its extrinsic rotation then holds [deg]",
    )
    rotation_known_deg: float = Field(
        default=0.8,
        ge=1e-5,
        le=180.0,
        description="it is judged once the filter's own estimate is this good [deg]",
    )
    time_offset_s: float = Field(
        default=0.0005, ge=1e-7, le=10.0, description="how well its time offset then holds [s]"
    )
    time_offset_known_s: float = Field(
        default=0.003,
        ge=1e-7,
        le=10.0,
        description="it is judged once the filter's own estimate is this good [s]",
    )


class RecoveryConfig(_Model):
    """When to believe rejected poses that agree with one another.

    Poses that tagvo calls ambiguous do not count where the rotation alone is rejected: a planar
    flip that lasts is no reason to turn over.
    """

    rejects: int = Field(default=5, ge=1, le=1000, description="how many in a row at least")
    after_s: float = Field(
        default=0.5, ge=0.0, le=600.0, description="and this long without an accepted one [s]"
    )
    turned: int = Field(
        default=10,
        ge=1,
        le=1000,
        description="how many of which the rotation alone is rejected, ambiguous poses apart",
    )
    turned_after_s: float = Field(
        default=1.0, ge=0.0, le=600.0, description="and over this long [s]"
    )
    spread_m: float = Field(
        default=0.15,
        ge=1e-4,
        le=100.0,
        description="how well their positions agree, beyond the IMU's motion [m]",
    )
    spread_deg: float = Field(
        default=6.0, ge=1e-3, le=180.0, description="how well their rotations agree [deg]"
    )
    restart_after_s: float = Field(
        default=5.0,
        ge=0.5,
        le=600.0,
        description="LOST for so long while poses arrive: the filter begins anew [s]",
    )


class HealthConfig(_Model):
    """Where TRACKING ends and LOST begins."""

    coasting_after_s: float = Field(
        default=0.3,
        ge=0.01,
        le=60.0,
        description="COASTING after so long without an accepted pose [s]",
    )
    lost_after_s: float = Field(
        default=5.0,
        ge=0.01,
        le=600.0,
        description="LOST after so long without an accepted pose [s]",
    )
    imu_late_s: float = Field(
        default=0.3,
        ge=0.001,
        le=60.0,
        description="LOST where poses are so far ahead of the newest IMU sample: it stalled [s]",
    )
    lost_sigma_m: float = Field(
        default=0.5, ge=1e-4, le=1e3, description="LOST beyond this predicted sigma of position [m]"
    )
    lost_sigma_deg: float = Field(
        default=10.0,
        ge=1e-3,
        le=180.0,
        description="LOST beyond this predicted sigma of attitude [deg]",
    )


class VioConfig(_Model):
    """The filter; `update` picks how tags correct it.

    The vibration adds to the density that the IMU's file states.
    """

    update: Literal["pose", "corners"] = Field(
        default="pose",
        description="how tags correct it: pose (tagvo's), or corners (each tag's own, gated apart)",
    )
    r_inflation: float = Field(
        default=4.0,
        ge=0.01,
        le=1e4,
        description="what errors correlated in time usually need on the covariance of a frame",
    )
    r_adapt: bool = Field(
        default=True,
        description="move it from 1 to twice r_inflation by how correlated the innovations are",
    )
    gate: float = Field(
        default=1.0, ge=0.01, le=1e3, description="scales the 99.9 % limits of chi-square"
    )
    lever_arm: bool = Field(
        default=False,
        description="estimate the camera's place in the IMU too: hardly observable in flight",
    )
    pose_bias: bool = Field(
        default=True,
        description="estimate a slowly varying error of the poses, in units of their own sigma",
    )
    pose_bias_share: ShareFloat | None = Field(
        default=None,
        description="its share of the poses' variance; null: learnt from the innovations",
    )
    pose_bias_time_s: float = Field(
        default=5.0, ge=0.01, le=1e5, description="the pose bias' correlation time [s]"
    )
    gravity_m_s2: float = Field(
        default=9.81,
        ge=1.0,
        le=30.0,
        description="gravity's magnitude; its direction in the map is estimated [m/s^2]",
    )
    buffer_s: float = Field(
        default=1.0, ge=0.1, le=30.0, description="how late a pose may come [s]"
    )
    max_tags: int = Field(
        default=48, ge=1, le=1000, description="most tags of one frame, in the corner update"
    )
    extrinsic_walk_rad: float = Field(
        default=1e-5,
        ge=0.0,
        le=1.0,
        description="random walk of the extrinsic rotation [rad/sqrt(s)]",
    )
    time_offset_walk_s: float = Field(
        default=1e-3,
        ge=0.0,
        le=10.0,
        description="random walk of the time offset [s/sqrt(s)]: clocks drift",
    )
    vibration: float = Field(
        default=0.25,
        ge=0.0,
        le=100.0,
        description="share of the accelerometer's scatter by sample that does not average out",
    )
    still_sigma_m_s: float = Field(
        default=0.02,
        ge=1e-5,
        le=10.0,
        description="on the ground: standard deviation of a velocity of zero [m/s]",
    )
    still_every_s: float = Field(
        default=0.2,
        ge=0.001,
        le=60.0,
        description="on the ground: how often a velocity of zero is used [s]",
    )
    gyro_max_rad_s: float = Field(
        default=34.9,
        ge=1.0,
        le=1e3,
        description="where a gyro axis saturates; what is above is a fault [rad/s]",
    )
    accel_max_m_s2: float = Field(
        default=156.9,
        ge=20.0,
        le=1e4,
        description="where an accelerometer axis saturates; what is above is a fault [m/s^2]",
    )
    prior: PriorConfig = Field(
        default=PriorConfig(), description="standard deviations at the start, per axis"
    )
    start: StartConfig = Field(default=StartConfig(), description="when there is enough to start")
    rig: RigConfig = Field(
        default=RigConfig(), description="the calibration file, once the flight has confirmed it"
    )
    recovery: RecoveryConfig = Field(
        default=RecoveryConfig(), description="when rejected poses are believed after all"
    )
    health: HealthConfig = Field(
        default=HealthConfig(), description="where TRACKING ends and LOST begins"
    )
