"""What a simulation is made of, in one validated file: flight, vehicle, map, sensors, nuisances."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import Field, PositiveFloat

from tagvo.config import validated
from tagvo.errors import ConfigError
from tagvo.render.scene import LensConfig, SceneConfig
from tagvo.textfile import read_yaml
from vio.config.overrides import assign, origin
from vio.config.shipped import config_names, config_path
from vio.errors import VioError
from vio.sim.model import Model
from vio.sim.sensors.camera_stream import CalibrationError, CameraStream
from vio.sim.sensors.imu_model import ImuModel
from vio.sim.sensors.perfect_detector import SightingConfig
from vio.sim.world.airframe import Vehicle
from vio.sim.world.flights import FlightConfig

_EXAMPLE = "vehicle=hr or stream.rate_hz=20"


class MapChoice(Model):
    """The map of the flight."""

    file: str = Field(default="maps/arena.yaml", description="tag map: a file, or one of configs")
    every: int = Field(default=1, ge=1, description="n: only each n-th tag by id lies there at all")


class AlongConfig(Model):
    """Which part of a recorded flight gets frames, in seconds from its first truth."""

    start_s: float = Field(default=0.0, ge=0.0, description="from when on [s]")
    end_s: PositiveFloat | None = Field(
        default=None, description="until when; null: to the end [s]"
    )


class Scenario(Model):
    """A whole simulation; by default nothing is wrong but the noise of a common IMU."""

    title: str = Field(default="", description="what the flight is, in words")
    seed: int = Field(
        default=0,
        ge=0,
        lt=2**63,
        description="what all that is drawn is drawn from; the same seed, the same log",
    )
    flight: FlightConfig = Field(description="which flight, and where")
    vehicle: Vehicle = Field(
        description="the vehicle: a name in configs/vehicles, a file, or its keys"
    )
    map: MapChoice = Field(default=MapChoice(), description="the map that the flight is over")
    camera: str = Field(
        default="cameras/arena.yaml",
        description="file of lens and sensor; the pose of the camera is the vehicle's",
    )
    gravity_off_deg: float = Field(
        default=0.0,
        ge=0.0,
        le=30.0,
        description="angle of true gravity against the map's -z, in a drawn direction [deg]",
    )
    truth_hz: PositiveFloat = Field(
        default=200.0, description="rows of truth a second, in the IMU's clock [Hz]"
    )
    imu: ImuModel = Field(
        default=ImuModel(), description="the IMU: what it does to true rates and forces"
    )
    stream: CameraStream = Field(
        default=CameraStream(), description="frames: from the shutter to the consumer"
    )
    calibration: CalibrationError = Field(
        default=CalibrationError(),
        description="how far the log's calibration is from the rig as it is",
    )
    scene: SceneConfig = Field(default=SceneConfig(), description="the floor and what lies on it")
    lens: LensConfig = Field(default=LensConfig(), description="lens, shutter and sensor")
    corners: SightingConfig = Field(
        default=SightingConfig(), description="what --detections writes in place of images"
    )
    along: AlongConfig = Field(
        default=AlongConfig(),
        description="which part of a flight --along gives frames, in seconds from its first truth",
    )


def load_scenario(name: str, assignments: Sequence[str] = ()) -> Scenario:
    """The scenario of a file, or of a name in configs/scenarios, with `a.b=c` assignments on top.

    Raises ConfigError for what cannot be read, an unknown key, or a value out of range.
    """
    path = scenario_path(name)
    data = _read(path, ())
    for text in assignments:
        assign(data, text, _EXAMPLE)
        if _name_of_vehicle(data.get("vehicle")) is not None:
            data["vehicle"] = _vehicle(data["vehicle"], Path.cwd(), f"--set {text}")
    return validated(Scenario, data, origin(path, assignments))


def scenario_path(name: str) -> Path:
    """The file that a name means: a path as it is, else what came with tagvio."""
    if Path(name).is_file() or "/" in name or name.endswith((".yaml", ".yml")):
        return Path(name)
    names = config_names("scenarios")
    if name not in names:
        raise ConfigError(f"{name}: no such file or scenario; choose one of {', '.join(names)}")
    return config_path(f"scenarios/{name}.yaml")


def scenario_yaml(scenario: Scenario, head: str) -> str:
    """Text of a scenario with every value said, from which the same log can be made again."""
    data = scenario.model_dump(mode="json")
    return "".join(f"# {line}\n" for line in head.splitlines()) + yaml.safe_dump(
        data, sort_keys=False, default_flow_style=None, width=100
    )


def _read(path: Path, below: tuple[Path, ...]) -> dict[str, Any]:
    """The mapping of a file on top of the one that it extends; files are named in full."""
    if path.resolve() in below:
        raise ConfigError(f"{path}: extends itself ({' <- '.join(p.name for p in below)})")
    data = read_yaml(path, ConfigError)
    base_name = data.pop("extends", None)
    named = _name_of_vehicle(data.get("vehicle")) is not None
    if named:
        data["vehicle"] = _vehicle(data["vehicle"], path.parent, str(path))
    if isinstance(data.get("map"), dict) and isinstance(data["map"].get("file"), str):
        data["map"] = {**data["map"], "file": _found(data["map"]["file"], path.parent)}
    if isinstance(data.get("camera"), str):
        data["camera"] = _found(data["camera"], path.parent)
    if base_name is None:
        return data
    beside = path.parent / f"{base_name}.yaml"
    base = beside if beside.is_file() else scenario_path(str(base_name))
    out = _merged(_read(base, (*below, path.resolve())), data)
    return {**out, "vehicle": data["vehicle"]} if named else out


def _name_of_vehicle(value: object) -> str | None:
    """The file or name that `vehicle: qr` or `vehicle: {file: qr, ...}` gives."""
    name = value.get("file") if isinstance(value, dict) else value
    return name if isinstance(name, str) else None


def _vehicle(value: Any, folder: Path, where: str) -> dict[str, Any]:
    """The mapping of a vehicle's file, or of a name in configs/vehicles, with changes on top."""
    name = _name_of_vehicle(value)
    assert name is not None
    changes = {k: v for k, v in value.items() if k != "file"} if isinstance(value, dict) else {}
    names = config_names("vehicles")
    if (folder / name).is_file():
        path = folder / name
    elif name in names:
        path = config_path(f"vehicles/{name}.yaml")
    else:
        raise ConfigError(f"{where} vehicle: no file or vehicle {name!r}; {', '.join(names)} come")
    return _merged(read_yaml(path, ConfigError), changes)


def _found(name: str, folder: Path) -> str:
    """A file beside the scenario by its full name; else as it is, for configs/ or the caller."""
    beside = folder / name
    return str(beside.resolve()) if beside.is_file() else name


def asset(name: str, where: str) -> Path:
    """The file that a scenario names: a path, or one that came with tagvio."""
    if Path(name).is_file():
        return Path(name)
    try:
        return config_path(name)
    except VioError:
        raise ConfigError(
            f"{where}: {name!r} is no file, neither here nor in tagvio's configs"
        ) from None


def _merged(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    out = dict(base)
    for key, value in over.items():
        inner = out.get(key)
        both = isinstance(inner, dict) and isinstance(value, dict)
        out[key] = _merged(inner, value) if both else value  # type: ignore[arg-type]
    return out
