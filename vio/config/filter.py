"""What can be set about the filter: one frozen model, every figure with its unit."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

ShareFloat = Annotated[float, Field(ge=0.0, lt=1.0)]


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class PriorConfig(_Model):
    """Standard deviations at the start, per axis."""

    position_m: float = Field(default=0.5, ge=1e-4, le=1e3)
    velocity_m_s: float = Field(default=1.0, ge=1e-4, le=100.0)
    attitude_deg: float = Field(default=12.0, ge=1e-3, le=180.0)
    gyro_bias_rad_s: float = Field(default=0.05, ge=1e-6, le=10.0)
    accel_bias_m_s2: float = Field(default=0.2, ge=1e-6, le=100.0)
    extrinsic_rotation_deg: float = Field(default=1.5, ge=0.0, le=180.0)
    time_offset_s: float = Field(default=0.03, ge=0.0, le=10.0)
    gravity_deg: float = Field(default=8.0, ge=1e-3, le=180.0)
    lever_arm_m: float = Field(default=0.01, ge=1e-6, le=10.0)


class StartConfig(_Model):
    """When there is enough to start: in motion, and at rest."""

    poses: int = Field(default=5, ge=1, le=1000)
    span_s: float = Field(default=0.4, ge=0.01, le=60.0)
    still_s: float = Field(default=1.0, ge=0.05, le=60.0)
    still_gyro_rad_s: float = Field(default=0.02, ge=1e-5, le=10.0)
    still_accel_m_s2: float = Field(default=0.2, ge=1e-4, le=100.0)


class RigConfig(_Model):
    """How well a calibration holds once the flight has confirmed it, and when it can tell."""

    rotation_deg: float = Field(default=0.05, ge=1e-5, le=90.0)
    rotation_known_deg: float = Field(default=0.8, ge=1e-5, le=180.0)
    time_offset_s: float = Field(default=0.0005, ge=1e-7, le=10.0)
    time_offset_known_s: float = Field(default=0.003, ge=1e-7, le=10.0)


class RecoveryConfig(_Model):
    """When to believe rejected poses that agree with one another.

    turned, turned_after_s: the same for poses whose rotation alone is rejected. Those that tagvo
    calls ambiguous do not count: a planar flip that lasts is no reason to turn over.
    restart_after_s: of LOST with poses arriving, after which the filter begins anew.
    """

    rejects: int = Field(default=5, ge=1, le=1000)
    after_s: float = Field(default=0.5, ge=0.0, le=600.0)
    turned: int = Field(default=10, ge=1, le=1000)
    turned_after_s: float = Field(default=1.0, ge=0.0, le=600.0)
    spread_m: float = Field(default=0.15, ge=1e-4, le=100.0)
    spread_deg: float = Field(default=6.0, ge=1e-3, le=180.0)
    restart_after_s: float = Field(default=5.0, ge=0.5, le=600.0)


class HealthConfig(_Model):
    """Where TRACKING ends and LOST begins."""

    coasting_after_s: float = Field(default=0.3, ge=0.01, le=60.0)
    lost_after_s: float = Field(default=5.0, ge=0.01, le=600.0)
    imu_late_s: float = Field(default=0.3, ge=0.001, le=60.0)
    lost_sigma_m: float = Field(default=0.5, ge=1e-4, le=1e3)
    lost_sigma_deg: float = Field(default=10.0, ge=1e-3, le=180.0)


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
    r_inflation: float = Field(default=4.0, ge=0.01, le=1e4)
    r_adapt: bool = True
    gate: float = Field(default=1.0, ge=0.01, le=1e3)
    lever_arm: bool = False
    pose_bias: bool = True
    pose_bias_share: ShareFloat | None = None
    pose_bias_time_s: float = Field(default=5.0, ge=0.01, le=1e5)
    gravity_m_s2: float = Field(default=9.81, ge=1.0, le=30.0)
    buffer_s: float = Field(default=1.0, ge=0.1, le=30.0)
    max_tags: int = Field(default=48, ge=1, le=1000)
    extrinsic_walk_rad: float = Field(default=1e-5, ge=0.0, le=1.0)
    time_offset_walk_s: float = Field(default=1e-3, ge=0.0, le=10.0)
    vibration: float = Field(default=0.25, ge=0.0, le=100.0)
    still_sigma_m_s: float = Field(default=0.02, ge=1e-5, le=10.0)
    still_every_s: float = Field(default=0.2, ge=0.001, le=60.0)
    gyro_max_rad_s: float = Field(default=34.9, ge=1.0, le=1e3)
    accel_max_m_s2: float = Field(default=156.9, ge=20.0, le=1e4)
    prior: PriorConfig = PriorConfig()
    start: StartConfig = StartConfig()
    rig: RigConfig = RigConfig()
    recovery: RecoveryConfig = RecoveryConfig()
    health: HealthConfig = HealthConfig()
