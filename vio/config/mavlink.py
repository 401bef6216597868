"""What can be set about the link to the flight controller: one frozen model, checked at load."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class OriginConfig(_Model):
    """Where the origin of the map lies on earth, for SET_GPS_GLOBAL_ORIGIN."""

    lat_deg: float = Field(default=47.397742, ge=-90.0, le=90.0)
    lon_deg: float = Field(default=8.545594, ge=-180.0, le=180.0)
    alt_m: float = Field(default=488.0, ge=-1000.0, le=10000.0)

    @model_validator(mode="after")
    def _somewhere(self) -> "OriginConfig":
        if round(self.lat_deg * 1e7) == 0 and round(self.lon_deg * 1e7) == 0:
            raise ValueError("0, 0 is dropped by autopilots: give another place, or origin: null")
        return self


class ImuLinkConfig(_Model):
    """Which IMU message is asked for, and how often it is needed; none: no IMU over MAVLink."""

    message: Literal[
        "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "none"
    ] = "HIGHRES_IMU"
    rate_hz: float = Field(default=200.0, ge=20.0, le=1000.0)


class BeliefConfig(_Model):
    """How far the autopilot's own position and yaw may be from the poses sent, and for how long."""

    position_m: float = Field(default=0.5, ge=0.05, le=100.0)
    yaw_deg: float = Field(default=15.0, ge=1.0, le=180.0)
    after_s: float = Field(default=2.0, ge=0.2, le=60.0)


class SigningConfig(_Model):
    """MAVLink 2 signing: the file with the key (64 hex digits, or a passphrase)."""

    key_file: str
    accept_unsigned: bool = False
    link_id: int = Field(default=0, ge=0, le=255)


class MavlinkConfig(_Model):
    """The bridge; see configs/arena.yaml for what each key means."""

    url: str = "udpin:127.0.0.1:14540"
    autopilot: Literal["auto", "ardupilot", "px4"] = "auto"
    system_id: int | None = Field(default=None, ge=1, le=255)
    component_id: int = Field(default=197, ge=1, le=255)
    message: Literal["VISION_POSITION_ESTIMATE", "ODOMETRY"] = "VISION_POSITION_ESTIMATE"
    speed: bool = False
    valid_at: Literal["capture", "now"] = "capture"
    rate_hz: float = Field(default=30.0, ge=20.0, le=40.0)
    max_age_s: float = Field(default=0.2, gt=0.0, le=0.2)
    coast_s: float = Field(default=0.5, ge=0.0, le=0.5)
    map_heading_deg: float | Literal["fc"] = 0.0
    origin: OriginConfig | None = OriginConfig()
    belief: BeliefConfig | None = BeliefConfig()
    timesync_hz: float = Field(default=10.0, ge=1.0, le=50.0)
    state_file: str = "~/.local/state/tagvio/mavlink.json"
    imu: ImuLinkConfig = ImuLinkConfig()
    signing: SigningConfig | None = None
