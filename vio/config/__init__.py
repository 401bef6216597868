"""The whole configuration: one frozen model from a file and `--set`, errors that say where."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, field_validator

from tagvo.config import TagvoConfig, validated
from tagvo.errors import ConfigError
from tagvo.textfile import read_yaml
from vio.config.daemon import DaemonConfig
from vio.config.filter import VioConfig
from vio.config.mavlink import MavlinkConfig
from vio.config.overrides import assign, origin

_IDENTITY = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
Row = tuple[float, float, float, float]


class VehicleConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """T_BI: the IMU in the vehicle's body (FLU), a rigid 4x4; identity where I is the body."""

    T_BI: tuple[Row, Row, Row, Row] = Field(
        default=_IDENTITY,
        description="pose of the IMU in the body (x ahead, y left, z up); identity: the IMU is it",
    )

    @field_validator("T_BI")
    @classmethod
    def _rigid(cls, value: tuple[Row, Row, Row, Row]) -> tuple[Row, Row, Row, Row]:
        import numpy as np

        T = np.array(value)
        R = T[:3, :3]
        small = np.abs(R).max() < 2.0  # no entry of a rotation is beyond 1; 1e300 squared overflows
        if not (small and np.allclose(R.T @ R, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0.0):
            raise ValueError("the upper left 3x3 must be a rotation")
        if not np.allclose(T[3], _IDENTITY[3]):
            raise ValueError("the last row must be 0 0 0 1")
        return value


class Config(BaseModel, frozen=True, extra="forbid"):
    """Everything that a configuration file may hold; a missing key has its default."""

    tagvo: TagvoConfig = Field(
        default=TagvoConfig(),
        description="pixels to pose; the joint pose starts from what the paper's stages give",
    )
    vehicle: VehicleConfig = Field(
        default=VehicleConfig(),
        description="for outputs to a vehicle; run and compare give the pose of the IMU itself",
    )
    mavlink: MavlinkConfig = Field(
        default=MavlinkConfig(), description="the link to the flight controller"
    )
    daemon: DaemonConfig = Field(
        default=DaemonConfig(),
        description="what `tagvio daemon` flies with; paths are relative to this file's folder",
    )
    vio: VioConfig = Field(default=VioConfig(), description="the filter")


def load_config(path: Path | None, assignments: Sequence[str] = ()) -> Config:
    """Configuration of a file (None: the defaults) with `a.b=c` assignments on top.

    Raises ConfigError for a file that cannot be read, an unknown key, or a value out of range.
    """
    data: dict[str, Any] = {} if path is None else read_yaml(path, ConfigError)
    for text in assignments:
        assign(data, text)
    return validated(Config, data, origin(path, assignments))
