"""Checks all that a flight needs before anything starts: files, link, camera, recording folder."""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np
import yaml

from tagvo.camera.calibration import camera_to_yaml, load_camera
from tagvo.camera.model import Camera
from tagvo.errors import ConfigError
from tagvo.geometry import Array
from tagvo.tags.tag_map import TagMap, load_map
from tagvo.textfile import read_text
from vio.config import Config
from vio.errors import VioError
from vio.records import ImuNoise
from vio.sinks.log_writer import LogWriter, make_private_folder, opened_private
from vio.sources.flight_log.files import read_imu_noise


@dataclass(frozen=True, slots=True, eq=False)
class Parts:
    """What flies, read and checked; texts: of the files that a recording holds, by name there."""

    config: Config
    tag_map: TagMap
    camera: Camera
    noise: ImuNoise | None
    texts: dict[str, str]


def read_parts(config: Config, path: Path) -> Parts:
    """Read what a configuration names; path: the configuration's file, for relative names.

    Raises ConfigError or tagvo's and vio's errors, each in one line.
    """
    d, where = config.daemon, path.parent
    if config.mavlink.imu.message == "none":
        raise ConfigError(f"{path} mavlink.imu.message: none; the daemon flies on that IMU")
    map_path = _needed(path, "map", d.map, "the tag map, as tagmap.yaml")
    camera_path = _needed(path, "calibration", d.calibration, "the camera's calibration")
    tag_map, camera = load_map(map_path), load_camera(camera_path)
    texts = {
        "tagmap.yaml": read_text(map_path, ConfigError),
        "camchain-imucam.yaml": camera_to_yaml(camera),  # the one that flies, of several too
        "config.yaml": yaml.safe_dump(config.model_dump(mode="json"), sort_keys=False),
    }
    noise = None
    if d.imu_noise is not None:
        noise_path = where / Path(d.imu_noise).expanduser()
        noise = read_imu_noise(noise_path)
        texts["imu.yaml"] = read_text(noise_path, ConfigError)
    return Parts(config, tag_map, camera, noise, texts)


def _needed(path: Path, key: str, value: str | None, what: str) -> Path:
    if value is None:
        raise ConfigError(f"{path} daemon.{key}: missing; {what} is needed")
    return path.parent / Path(value).expanduser()


def imu_in_body(config: Config) -> tuple[Array, Array]:
    """R_BI (3, 3) and p_BI (3,) [m] of the vehicle."""
    T_BI = np.array(config.vehicle.T_BI)
    return T_BI[:3, :3], T_BI[:3, 3]


def check_recording(config: Config, where: Path) -> None:
    """VioError where the folder for recordings cannot be written."""
    root = _recordings(config, where)
    if root is None:
        return
    try:
        make_private_folder(root)
        with TemporaryFile(dir=root):
            pass
    except OSError as err:
        raise VioError(
            f"daemon.record.folder {root}: {err.strerror or err}; a folder that can be written,"
            " or null, is needed"
        ) from None


def new_recording(parts: Parts, where: Path) -> LogWriter | None:
    """A log of its own for this flight, its fixed files on the disk; None: none is wanted."""
    root = _recordings(parts.config, where)
    if root is None:
        return None
    name = time.strftime("%Y%m%d-%H%M%S")
    path = next(p for p in _names(root, name) if not p.exists())
    writer = LogWriter(path)
    for file, text in parts.texts.items():
        _write_through(path / file, text)
    for one in (path, root):
        _sync_folder(one)
    return writer


def _recordings(config: Config, where: Path) -> Path | None:
    folder = config.daemon.record.folder
    return None if folder is None else where / Path(folder).expanduser()


def _names(root: Path, name: str) -> "list[Path]":
    return [root / name, *(root / f"{name}-{k}" for k in range(2, 1000))]


def _write_through(path: Path, text: str) -> None:
    with opened_private(path, "w") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(path: Path) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
