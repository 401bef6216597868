"""What can be set about the daemon: what it flies with, its camera, its recording, its status."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CameraConfig(_Model):
    """The camera, or files in place of one."""

    device: str = Field(
        default="/dev/video0",
        description="V4L2; or picamera2 (picamera2:1), a folder of images, a video file",
    )
    rate_hz: float = Field(
        default=30.0,
        ge=1.0,
        le=240.0,
        description="asked of the camera; of files the rate itself, 1 to 240 [Hz]",
    )
    exposure_ms: float | None = Field(
        default=None, gt=0.0, le=1000.0, description="fixed exposure; null: automatic [ms]"
    )
    readout_ms: float | None = Field(
        default=None,
        ge=0.0,
        le=1000.0,
        description="of a rolling shutter; null: 0.8 of the period (V4L2), 0 (picamera2) [ms]",
    )
    stamp: Literal["auto", "start", "middle", "end"] = Field(
        default="auto",
        description="what the driver stamps: start of the exposure, end of the frame, middle",
    )
    pixel_format: str | None = Field(
        default=None,
        min_length=4,
        max_length=4,
        description="four letters that V4L2 knows, as MJPG or GREY; null: the driver's choice",
    )
    repeat: bool = Field(
        default=False, description="files: begin again at their end; else the flight ends there"
    )


class RecordConfig(_Model):
    """The flight recording; folder null: none is made."""

    folder: str | None = Field(
        default=None,
        description="each flight makes a folder of its own in it; null: none is recorded",
    )
    images_every: int = Field(
        default=0, ge=0, description="record every n-th image besides all corners; 0: corners alone"
    )
    sync_s: float = Field(
        default=1.0, gt=0.0, le=60.0, description="how much a power cut may cost [s]"
    )
    min_free_mb: float = Field(
        default=200.0,
        ge=0.0,
        description="recording ends where less is free on the disk; the flight goes on [MB]",
    )


ORIGINS = ("https://app.foxglove.dev", "desktop", "localhost")


class LiveConfig(_Model):
    """The live view; port null: no server, mcap null: no file.

    Of origins, localhost means pages of this machine, and * all.
    """

    port: int | None = Field(
        default=None,
        ge=0,
        le=65535,
        description="of its WebSocket server, 8765 is usual, 0: any free one; null: none",
    )
    host: str = Field(
        default="127.0.0.1", description="this computer alone; 0.0.0.0: whoever can reach it"
    )
    mcap: str | None = Field(
        default=None,
        description="a folder: each flight leaves an MCAP file of the same; null: none",
    )
    origins: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = Field(
        default=ORIGINS,
        description="who may look; desktop: programs",
    )


class DaemonConfig(_Model):
    """What `tagvio daemon` flies with; paths are relative to the configuration's folder."""

    map: str | None = Field(
        default=None, description="the tag map, as tagmap.yaml; the daemon needs one"
    )
    calibration: str | None = Field(
        default=None, description="of the camera, as camchain-imucam.yaml; the daemon needs one"
    )
    imu_noise: str | None = Field(
        default=None, description="as imu.yaml (Kalibr); null: that of a Pixhawk over MAVLink"
    )
    camera: CameraConfig = Field(default=CameraConfig(), description="where images come from")
    detection_threads: int = Field(
        default=1, ge=1, le=8, description="images searched at a time; the newest wins"
    )
    record: RecordConfig = Field(
        default=RecordConfig(), description="the flight as a log that `tagvio run` takes"
    )
    live: LiveConfig = Field(
        default=LiveConfig(),
        description="what a viewer like Foxglove shows: image, tags, map, body, plots, messages",
    )
    status_file: str | None = Field(
        default=None, description="JSON, written anew each second; null: none"
    )
    vehicle_wait_s: float = Field(
        default=60.0,
        gt=0.0,
        le=3600.0,
        description="how long to wait for the flight controller's first heartbeat [s]",
    )
