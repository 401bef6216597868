"""Reads camera calibrations as others write them: Kalibr, OpenVINS, EuRoC, ROS; writes Kalibr's."""

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tagvo import geometry as geo
from tagvo.camera.foreign import calibration_data
from tagvo.camera.model import Camera
from tagvo.errors import CameraError, choose_one_of, shown, some_of
from tagvo.geometry import Array
from tagvo.textfile import finite_number, finite_numbers, write_atomic

_ORTHONORMAL = 1e-3  # how far the rotation of a file may be from one before it is refused
_SUPPORTED = "pinhole with radtan, equidistant or none"
_MODELS = {
    "radtan": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "equidistant",
    "equi": "equidistant",
    "fisheye": "equidistant",
    "none": "none",
}
_SKEW_PX = 1.0  # below: within what a corner is found to, far from the image's middle at most
_LEAST_FOCAL_PX = 1.0  # all of 90 degrees would fall on two pixels
_SMALL_PX = 16  # a tag of ten cells has a pixel and a half a cell
_LARGEST_PX = 1e6  # a focal length beyond is no lens
_LARGEST_SIDE = 65_536  # [px] of an image
_LARGEST_SHIFT_S = 10.0  # beyond, clocks differ, not exposures
_LARGEST_LEVER_M = 100.0  # of a rig
_BLOCK_KEYS = {"intrinsics", "camera_matrix", "distortion_model"}
_NEEDED = (
    "a Kalibr camchain, a EuRoC sensor.yaml, a ROS CameraInfo, an oST text file or a calibration"
    " of PhotonVision, OpenCV, camodocal or librealsense (T265) is needed"
)
_COUNTS = {"radtan": (4, 5, 8, 12, 14), "equidistant": (4,), "none": (0, 4, 5, 8)}
_COEFF_KEYS = ("distortion_coeffs", "distortion_coefficients")
_POSE_KEYS = ("T_cam_imu", "T_imu_cam", "T_BS")  # the last two are camera -> body: inverted


def load_camera(path: Path | str, name: str | None = None, topic: str | None = None) -> Camera:
    """Camera of a calibration file; CameraError names the file and the field that is wrong.

    Takes a Kalibr camchain (also OpenVINS's), one camera of it without the name above, a EuRoC
    sensor.yaml, a ROS CameraInfo, an oST text file, and what PhotonVision, OpenCV, camodocal and
    librealsense (T265) write. name: of one camera of several, also as `FILE:name` in path; topic:
    of the images, None: not known; it picks the camera whose `rostopic` it is. Of several cameras
    none is taken unasked. Without a pose R_CI, p_CI are the identity; without a time shift it is 0.
    """
    file, of_path = named_camera(Path(path))
    name = name or of_path
    return camera_of(calibration_data(file, name), file, name, topic)


def named_camera(path: Path) -> tuple[Path, str | None]:
    """The file and the camera of `FILE:name`; None where the path names no camera."""
    stem, colon, name = path.name.rpartition(":")
    if not colon or not stem or not name or os.path.lexists(path):
        return path, None
    return path.with_name(stem), name


def camera_of(
    data: dict[str, Any], path: Path, name: str | None = None, topic: str | None = None
) -> Camera:
    """The same from what a file (or a message) said, as a mapping; path: how errors call it."""
    block, where = _camera_block(data, name, topic, path)
    kind = block.get("camera_model", "pinhole")
    if kind != "pinhole":
        raise CameraError(
            f"{where} camera_model: unknown {shown(kind)}; supported: {_SUPPORTED}; calibrate"
            " again with one of these"
        )
    model, coeffs = _distortion(block, where)
    R_CI, p_CI = _pose(block, where)
    shift = finite_number(
        block.get("timeshift_cam_imu", 0.0), f"{where} timeshift_cam_imu", CameraError
    )
    if abs(shift) > _LARGEST_SHIFT_S:
        raise CameraError(f"{where} timeshift_cam_imu: {shift:g} s; at most 10 s is a time shift")
    if np.abs(p_CI).max() > _LARGEST_LEVER_M:
        raise CameraError(f"{where} T_cam_imu: {p_CI.tolist()} m; IMU and camera are on one rig")
    intrinsics, notes = _intrinsics(block, where)
    size = _resolution(block, where)
    camera = Camera(model, intrinsics, coeffs, size, R_CI, p_CI, shift, str(path), notes)
    return replace(camera, notes=(*notes, *_doubts(camera, where)))


def _doubts(camera: Camera, where: str) -> list[str]:
    """What a calibration may say and hardly a camera has, a line each."""
    (width, height), (fu, fv, pu, pv) = camera.resolution, camera.intrinsics.tolist()
    folds_px = camera.max_radius * min(fu, fv)
    said = []
    if min(width, height) < _SMALL_PX:
        said.append(f"{where} resolution: {width}x{height} pixels hold no tag")
    elif not (0.0 <= pu <= width and 0.0 <= pv <= height):
        said.append(f"{where}: the principal point {pu:g}, {pv:g} lies outside of {width}x{height}"
                    " pixels: is it of another resolution?")  # fmt: skip
    elif folds_px < 0.25 * min(width, height):
        text = f"folds the image {folds_px:.0f} pixels from its middle: are these a lens's?"
        said.append(f"{where} distortion: {text}")
    return said


def camera_to_yaml(camera: Camera, name: str = "cam0") -> str:
    """Text of a Kalibr camchain-imucam.yaml with this one camera; exact in every digit."""
    T_cam_imu = np.eye(4)
    T_cam_imu[:3, :3], T_cam_imu[:3, 3] = camera.R_CI, camera.p_CI
    block = {
        "camera_model": "pinhole",
        "intrinsics": [float(x) for x in camera.intrinsics],
        "distortion_model": camera.model,
        "distortion_coeffs": [float(x) for x in camera.coeffs],
        "T_cam_imu": T_cam_imu.tolist(),
        "timeshift_cam_imu": float(camera.timeshift_s),
        "resolution": [int(n) for n in camera.resolution],
        "rostopic": f"/{name}/image_raw",
    }
    return yaml.safe_dump({name: block}, sort_keys=False, default_flow_style=None, width=200)


def save_camera(camera: Camera, path: Path, name: str = "cam0") -> None:
    """Write a Kalibr camchain-imucam.yaml, whole or not at all."""
    write_atomic(path, camera_to_yaml(camera, name))


def _camera_block(
    data: dict[str, Any], name: str | None, topic: str | None, path: Path
) -> tuple[dict[str, Any], str]:
    """The mapping that holds the camera, and how to call it in errors."""
    if name is not None and isinstance(data.get(name), dict):
        return data[name], f"{path} {name}"
    if _BLOCK_KEYS & set(data):
        return data, str(path)
    blocks = {
        str(key): value
        for key, value in data.items()
        if isinstance(value, dict) and (_BLOCK_KEYS & set(value) or str(key).startswith("cam"))
    }
    if name is None and topic is not None and len(blocks) > 1:
        wanted = _bare_topic(topic)
        said = [k for k, v in blocks.items() if _bare_topic(str(v.get("rostopic"))) == wanted]
        if len(said) == 1:
            return blocks[said[0]], f"{path} {said[0]}"
    if name is None and len(blocks) == 1:
        only = next(iter(blocks))
        return blocks[only], f"{path} {only}"
    cameras = [str(key) for key, value in data.items() if isinstance(value, dict)]
    if name is None and blocks:
        topics = some_of(f"{k} ({v.get('rostopic', 'no rostopic')})" for k, v in blocks.items())
        of = "" if topic is None else f", and none alone is of {topic}"
        raise CameraError(
            f"{path}: {len(blocks)} cameras{of}: {topics}; say which, as"
            f" {path.name}:{next(iter(blocks))}"
        )
    there = f"it has {some_of(cameras)}" if cameras else "it has no camera"
    raise CameraError(f"{path}: no `{name or 'cam0'}`; {there}; {_NEEDED}")


def _bare_topic(topic: str) -> str:
    """The topic of the images themselves, whichever transport carries them."""
    return "/" + re.sub(r"/(compressed|theora|compressedDepth)$", "", topic).strip("/")


def _field(block: dict[str, Any], key: str, where: str, needed: str) -> Any:
    if block.get(key) is None:
        raise CameraError(f"{where}: `{key}` is missing; {needed}")
    return block[key]


def _flat(value: object) -> object:
    """The numbers of a {rows, cols, data} mapping or of a list of rows, as one list."""
    if isinstance(value, dict):
        value = value.get("data")
    if isinstance(value, list) and value and all(isinstance(row, list) for row in value):
        return [x for row in value for x in row]
    return value


def _intrinsics(block: dict[str, Any], where: str) -> tuple[Array, tuple[str, ...]]:
    """fu, fv, pu, pv [px] and what was taken for granted."""
    notes: tuple[str, ...] = ()
    if "camera_matrix" in block:
        here = f"{where} camera_matrix"
        k = finite_numbers(_flat(block["camera_matrix"]), 9, here, CameraError)
        skewed = abs(k[1]) < _SKEW_PX
        if not skewed or not np.allclose([k[3], k[6], k[7], k[8] - 1.0], 0.0, atol=1e-9):
            raise CameraError(
                f"{here}: {k}; fu 0 pu / 0 fv pv / 0 0 1 is needed (no skew of {_SKEW_PX:g} px or"
                " more; below, it is taken as 0)"
            )
        if abs(k[1]) > 1e-9:
            notes = (f"{here}: a skew of {k[1]:g} px is taken as 0; it would move a pixel by"
                     f" {abs(k[1]):.2g} y/z px",)  # fmt: skip
        values = [k[0], k[4], k[2], k[5]]
    else:
        here = f"{where} intrinsics"
        needed = "fu, fv, pu, pv in pixels are needed"
        values = finite_numbers(_field(block, "intrinsics", where, needed), 4, here, CameraError)
    if min(values) <= 0.0:
        raise CameraError(f"{here}: {values}; fu, fv, pu, pv must be positive")
    if min(values[:2]) < _LEAST_FOCAL_PX:
        raise CameraError(
            f"{here}: {values}; fu and fv are at least {_LEAST_FOCAL_PX:g} pixel"
            " (are these normalised or in metres?)"
        )
    if max(values) > _LARGEST_PX:
        raise CameraError(f"{here}: {values}; at most {_LARGEST_PX:g} pixels are a camera's")
    return np.array(values), notes


def _distortion(block: dict[str, Any], where: str) -> tuple[str, Array]:
    given = _field(block, "distortion_model", where, "radtan, equidistant or none")
    model = _MODELS.get(str(given).lower().replace("radial_", "radial-"))
    if model is None:
        raise CameraError(choose_one_of(f"{where} distortion_model", given, _MODELS))
    key = next((k for k in _COEFF_KEYS if block.get(k) is not None), None)
    if key is None and model != "none":
        raise CameraError(f"{where}: `distortion_coeffs` is missing; {given} needs coefficients")
    value = _flat(block[key]) if key is not None else []
    count = len(value) if isinstance(value, list) else -1
    here = f"{where} {key}"
    if count not in _COUNTS[model]:
        allowed = ", ".join(map(str, _COUNTS[model]))
        came = f"{count} numbers" if count >= 0 else repr(value)
        raise CameraError(f"{here}: {came}; {given} takes {allowed} coefficients")
    coeffs = np.array(finite_numbers(value, count, here, CameraError))
    keep = {"none": 0, "radtan": min(count, 8)}.get(model, count)
    if coeffs[keep:].any():
        kind = "without distortion" if model == "none" else "beyond the eighth"
        raise CameraError(f"{here}: {coeffs[keep:].tolist()} {kind}; must be 0: {_SUPPORTED}")
    return model, coeffs[:keep]


def _resolution(block: dict[str, Any], where: str) -> tuple[int, int]:
    if "image_width" in block or "image_height" in block:
        value: object = [block.get("image_width"), block.get("image_height")]
        here = f"{where} image_width, image_height"
    else:
        value = _field(block, "resolution", where, "[width, height] in pixels is needed")
        here = f"{where} resolution"
    width, height = finite_numbers(value, 2, here, CameraError)
    if min(width, height) < 1 or width % 1 or height % 1:
        raise CameraError(f"{here}: {shown(value)}; two whole numbers of pixels are needed")
    if max(width, height) > _LARGEST_SIDE:
        raise CameraError(
            f"{here}: {width:g} x {height:g}; a side has at most {_LARGEST_SIDE} pixels"
        )
    return int(width), int(height)


def _pose(block: dict[str, Any], where: str) -> tuple[Array, Array]:
    """Pose of the IMU in the camera, whichever sense the file has; re-orthonormalised."""
    key = next((k for k in _POSE_KEYS if block.get(k) is not None), None)
    if key is None:
        return np.eye(3), np.zeros(3)
    here = f"{where} {key}"
    T = np.array(finite_numbers(_flat(block[key]), 16, here, CameraError)).reshape(4, 4)
    if np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise CameraError(f"{here}: last row {T[3].tolist()}; [0, 0, 0, 1] is needed")
    R, p = T[:3, :3], T[:3, 3].copy()
    if np.abs(R).max() > 2.0 or np.abs(R.T @ R - np.eye(3)).max() > _ORTHONORMAL:
        raise CameraError(
            f"{here}: the upper left 3x3 is no rotation (columns must be orthonormal)"
        )
    if np.linalg.det(R) < 0.0:
        raise CameraError(f"{here}: the rotation mirrors (determinant -1; +1 is needed)")
    R = geo.project_to_so3(R)
    return (R, p) if key == "T_cam_imu" else geo.invert(R, p)
