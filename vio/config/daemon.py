"""What can be set about the daemon: what it flies with, its camera, its recording, its status."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CameraConfig(_Model):
    """The camera; see configs/daemon.yaml for what each key means."""

    device: str = "/dev/video0"
    rate_hz: float = Field(default=30.0, ge=1.0, le=240.0)
    exposure_ms: float | None = Field(default=None, gt=0.0, le=1000.0)
    readout_ms: float | None = Field(default=None, ge=0.0, le=1000.0)
    stamp: Literal["auto", "start", "middle", "end"] = "auto"
    pixel_format: str | None = Field(default=None, min_length=4, max_length=4)
    repeat: bool = False


class RecordConfig(_Model):
    """The flight recording; folder null: none is made."""

    folder: str | None = None
    images_every: int = Field(default=0, ge=0)
    sync_s: float = Field(default=1.0, gt=0.0, le=60.0)
    min_free_mb: float = Field(default=200.0, ge=0.0)


ORIGINS = ("https://app.foxglove.dev", "desktop", "localhost")


class LiveConfig(_Model):
    """The live view; port null: no server, mcap null: no file.

    origins: of the web pages that may connect; `desktop`: programs that are no page, `localhost`:
    pages of this machine, `*`: all.
    """

    port: int | None = Field(default=None, ge=0, le=65535)
    host: str = "127.0.0.1"
    mcap: str | None = None
    origins: tuple[Annotated[str, Field(min_length=1, max_length=200)], ...] = ORIGINS


class DaemonConfig(_Model):
    """What `tagvio daemon` flies with; paths are relative to the configuration's folder."""

    map: str | None = None
    calibration: str | None = None
    imu_noise: str | None = None
    camera: CameraConfig = CameraConfig()
    detection_threads: int = Field(default=1, ge=1, le=8)
    record: RecordConfig = RecordConfig()
    live: LiveConfig = LiveConfig()
    status_file: str | None = None
    vehicle_wait_s: float = Field(default=60.0, gt=0.0, le=3600.0)
