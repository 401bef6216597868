"""What can be set about the filter: one frozen model, every figure with its unit."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveFloat, PositiveInt

ShareFloat = Annotated[float, Field(ge=0.0, lt=1.0)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PriorConfig(_Model):
    """Standard deviations at the start, per axis."""

    position_m: PositiveFloat = 0.5
    velocity_m_s: PositiveFloat = 1.0
    attitude_deg: PositiveFloat = 12.0
    gyro_bias_rad_s: PositiveFloat = 0.05
    accel_bias_m_s2: PositiveFloat = 0.2
    extrinsic_rotation_deg: NonNegativeFloat = 1.5
    time_offset_s: NonNegativeFloat = 0.03
    gravity_deg: PositiveFloat = 8.0
    lever_arm_m: PositiveFloat = 0.01


class StartConfig(_Model):
    """When there is enough to start: in motion, and at rest."""

    poses: PositiveInt = 5
    span_s: PositiveFloat = 0.4
    still_s: PositiveFloat = 1.0
    still_gyro_rad_s: PositiveFloat = 0.02
    still_accel_m_s2: PositiveFloat = 0.2


class RigConfig(_Model):
    """How well a calibration holds once the flight has confirmed it, and when it can tell."""

    rotation_deg: PositiveFloat = 0.05
    rotation_known_deg: PositiveFloat = 0.8
    time_offset_s: PositiveFloat = 0.0005
    time_offset_known_s: PositiveFloat = 0.003


class RecoveryConfig(_Model):
    """When to believe rejected poses that agree with one another.

    turned, turned_after_s: the same for poses whose rotation alone is rejected. Those that tagvo
    calls ambiguous do not count: a planar flip that lasts is no reason to turn over.
    restart_after_s: of LOST with poses arriving, after which the filter begins anew.
    """

    rejects: PositiveInt = 5
    after_s: PositiveFloat = 0.5
    turned: PositiveInt = 10
    turned_after_s: PositiveFloat = 1.0
    spread_m: PositiveFloat = 0.15
    spread_deg: PositiveFloat = 6.0
    restart_after_s: PositiveFloat = 5.0


class HealthConfig(_Model):
    """Where TRACKING ends and LOST begins."""

    coasting_after_s: PositiveFloat = 0.3
    lost_after_s: PositiveFloat = 5.0
    imu_late_s: PositiveFloat = 0.3
    lost_sigma_m: PositiveFloat = 0.5
    lost_sigma_deg: PositiveFloat = 10.0


class VioConfig(_Model):
    """The filter; `update` picks how tags correct it.

    `r_inflation` multiplies the poses' covariance, for errors that are correlated in time; with
    `r_adapt` it is what such errors usually need, and the factor moves between 1 and twice as much
    by how correlated the innovations turn out to be. `pose_bias`: a slowly varying error of the
    poses is a state; its share of their variance is learnt where `pose_bias_share` is None.
    `vibration`: which share of the accelerometer's scatter from sample to sample stays in what it
    integrates to, on top of the density that the IMU's file states.
    """

    update: Literal["pose", "corners"] = "pose"
    r_inflation: PositiveFloat = 4.0
    r_adapt: bool = True
    gate: PositiveFloat = 1.0
    lever_arm: bool = False
    pose_bias: bool = True
    pose_bias_share: ShareFloat | None = None
    pose_bias_time_s: PositiveFloat = 5.0
    gravity_m_s2: PositiveFloat = 9.81
    buffer_s: PositiveFloat = 1.0
    max_tags: PositiveInt = 48
    extrinsic_walk_rad: NonNegativeFloat = 1e-5
    time_offset_walk_s: NonNegativeFloat = 1e-3
    vibration: NonNegativeFloat = 0.25
    still_sigma_m_s: PositiveFloat = 0.02
    still_every_s: PositiveFloat = 0.2
    gyro_max_rad_s: PositiveFloat = 34.9
    accel_max_m_s2: PositiveFloat = 156.9
    prior: PriorConfig = PriorConfig()
    start: StartConfig = StartConfig()
    rig: RigConfig = RigConfig()
    recovery: RecoveryConfig = RecoveryConfig()
    health: HealthConfig = HealthConfig()
