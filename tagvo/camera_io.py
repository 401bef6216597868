"""Reads camera calibrations as others write them: Kalibr, OpenVINS, EuRoC, ROS; writes Kalibr's."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tagvo import geometry as geo
from tagvo.camera import Camera
from tagvo.errors import CameraError, choose_one_of
from tagvo.geometry import Array
from tagvo.textfile import finite_number, finite_numbers, read_yaml, write_atomic

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
_COUNTS = {"radtan": (4, 5, 8, 12, 14), "equidistant": (4,), "none": (0, 4, 5, 8)}
_COEFF_KEYS = ("distortion_coeffs", "distortion_coefficients")
_POSE_KEYS = ("T_cam_imu", "T_imu_cam", "T_BS")  # the last two are camera -> body: inverted


def load_camera(path: Path | str, name: str = "cam0") -> Camera:
    """Camera of a calibration file; CameraError names the file and the field that is wrong.

    Takes a Kalibr camchain (the camera called `name`; also OpenVINS's), one camera of it without
    the name above, a EuRoC sensor.yaml and a ROS CameraInfo. Without a pose R_CI, p_CI are
    the identity; without a time shift it is 0.
    """
    path = Path(path)
    return camera_of(read_yaml(path, CameraError), path, name)


def camera_of(data: dict[str, Any], path: Path, name: str = "cam0") -> Camera:
    """The same from what a file (or a message) said, as a mapping; path: how errors call it."""
    block, where = _camera_block(data, name, path)
    kind = block.get("camera_model", "pinhole")
    if kind != "pinhole":
        raise CameraError(f"{where} camera_model: unknown {kind!r}; supported: {_SUPPORTED}")
    model, coeffs = _distortion(block, where)
    R_CI, p_CI = _pose(block, where)
    shift = finite_number(
        block.get("timeshift_cam_imu", 0.0), f"{where} timeshift_cam_imu", CameraError
    )
    return Camera(
        model,
        _intrinsics(block, where),
        coeffs,
        _resolution(block, where),
        R_CI,
        p_CI,
        shift,
        str(path),
    )


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


def _camera_block(data: dict[str, Any], name: str, path: Path) -> tuple[dict[str, Any], str]:
    """The mapping that holds the camera, and how to call it in errors."""
    if isinstance(data.get(name), dict):
        return data[name], f"{path} {name}"
    if "intrinsics" in data or "camera_matrix" in data or "distortion_model" in data:
        return data, str(path)
    cameras = [str(key) for key, value in data.items() if isinstance(value, dict)]
    there = f"it has {', '.join(cameras)}" if cameras else "it has no camera"
    raise CameraError(
        f"{path}: no `{name}`; {there}; a Kalibr camchain, a EuRoC sensor.yaml"
        " or a ROS CameraInfo is needed"
    )


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


def _intrinsics(block: dict[str, Any], where: str) -> Array:
    if "camera_matrix" in block:
        here = f"{where} camera_matrix"
        k = finite_numbers(_flat(block["camera_matrix"]), 9, here, CameraError)
        if not np.allclose([k[1], k[3], k[6], k[7], k[8] - 1.0], 0.0, atol=1e-9):
            raise CameraError(f"{here}: {k}; fu 0 pu / 0 fv pv / 0 0 1 is needed (no skew)")
        values = [k[0], k[4], k[2], k[5]]
    else:
        here = f"{where} intrinsics"
        needed = "fu, fv, pu, pv in pixels are needed"
        values = finite_numbers(_field(block, "intrinsics", where, needed), 4, here, CameraError)
    if min(values) <= 0.0:
        raise CameraError(f"{here}: {values}; fu, fv, pu, pv must be positive")
    return np.array(values)


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
        raise CameraError(f"{here}: {value!r}; two whole numbers of pixels are needed")
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
