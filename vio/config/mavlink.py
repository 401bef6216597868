"""What can be set about the link to the flight controller: one frozen model, checked at load."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class OriginConfig(_Model):
    """Where the origin of the map lies on earth, for SET_GPS_GLOBAL_ORIGIN."""

    lat_deg: float = Field(default=47.397742, ge=-90.0, le=90.0, description="latitude [deg]")
    lon_deg: float = Field(default=8.545594, ge=-180.0, le=180.0, description="longitude [deg]")
    alt_m: float = Field(
        default=488.0,
        ge=-1000.0,
        le=10000.0,
        description="above mean sea level [m]; PX4 is sent 0: it would move its local height by it",
    )

    @model_validator(mode="after")
    def _somewhere(self) -> "OriginConfig":
        if round(self.lat_deg * 1e7) == 0 and round(self.lon_deg * 1e7) == 0:
            raise ValueError("0, 0 is dropped by autopilots: give another place, or origin: null")
        return self


class ImuLinkConfig(_Model):
    """Which IMU message is asked for, and how often it is needed; none: no IMU over MAVLink."""

    message: Literal[
        "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "none"
    ] = Field(
        default="HIGHRES_IMU",
        description="or RAW_IMU, SCALED_IMU, SCALED_IMU2, SCALED_IMU3; none: not asked for",
    )
    rate_hz: float = Field(
        default=200.0, ge=20.0, le=1000.0, description="rate that is needed, 20 to 1000 [Hz]"
    )


class BeliefConfig(_Model):
    """How far the autopilot's own position and yaw may be from the poses sent, and for how long."""

    position_m: float = Field(default=0.5, ge=0.05, le=100.0, description="largest distance [m]")
    yaw_deg: float = Field(
        default=15.0, ge=1.0, le=180.0, description="largest difference of yaw [deg]"
    )
    after_s: float = Field(
        default=2.0,
        ge=0.2,
        le=60.0,
        description="for so long, before STATUSTEXT, HEARTBEAT and status file say it [s]",
    )


class SigningConfig(_Model):
    """MAVLink 2 signing: the file with the key (64 hex digits, or a passphrase)."""

    key_file: str = Field(description="file with the key: 64 hex digits or a passphrase")
    accept_unsigned: bool = Field(
        default=False, description="whether unsigned messages of the autopilot are taken"
    )
    link_id: int = Field(
        default=0, ge=0, le=255, description="our link id in the signature, 0 to 255"
    )


class MavlinkConfig(_Model):
    """The bridge to the flight controller."""

    url: str = Field(
        default="udpin:127.0.0.1:14540",
        description="udpin:HOST:PORT listens, udpout: calls; tcp:HOST:PORT; serial:DEV:BAUD",
    )
    autopilot: Literal["auto", "ardupilot", "px4"] = Field(
        default="auto", description="what it is: auto (by its heartbeat), ardupilot, px4"
    )
    system_id: int | None = Field(
        default=None,
        ge=1,
        le=255,
        description="the vehicle's, 1 to 255; null: that of the first autopilot that is heard",
    )
    component_id: int = Field(
        default=197, ge=1, le=255, description="ours: visual inertial odometry"
    )
    message: Literal["VISION_POSITION_ESTIMATE", "ODOMETRY"] = Field(
        default="VISION_POSITION_ESTIMATE",
        description="or ODOMETRY, with velocity and quality",
    )
    speed: bool = Field(
        default=False, description="send VISION_SPEED_ESTIMATE besides; ArduPilot alone takes it"
    )
    valid_at: Literal["capture", "now"] = Field(
        default="capture",
        description="when a pose holds, and its stamp: capture (of the image), or now (predicted)",
    )
    rate_hz: float = Field(
        default=30.0, ge=20.0, le=40.0, description="rate of poses, 20 to 40 [Hz]"
    )
    max_age_s: float = Field(
        default=0.2, gt=0.0, le=0.2, description="an older pose is not sent; at most 0.2 [s]"
    )
    coast_s: float = Field(
        default=0.5,
        ge=0.0,
        le=0.5,
        description="how long poses are sent without tags; at most 0.5 [s]",
    )
    map_heading_deg: float | Literal["fc"] = Field(
        default=0.0,
        description="compass heading of the map's +x (+y where +x stands); fc: its attitude's",
    )
    origin: OriginConfig | None = Field(
        default=OriginConfig(),
        description="where the map lies on earth; without GPS any place does; null: not sent",
    )
    belief: BeliefConfig | None = Field(
        default=BeliefConfig(),
        description="how far the autopilot may be from the poses sent; null (GPS): not compared",
    )
    timesync_hz: float = Field(
        default=10.0,
        ge=1.0,
        le=50.0,
        description="how often the autopilot's clock is asked for, 1 to 50 [Hz]",
    )
    state_file: str = Field(
        default="~/.local/state/tagvio/mavlink.json",
        description="keeps the reset counter over a restart",
    )
    imu: ImuLinkConfig = Field(default=ImuLinkConfig(), description="the autopilot's IMU")
    signing: SigningConfig | None = Field(
        default=None,
        description="or key_file (64 hex digits or a passphrase), accept_unsigned, link_id",
    )
