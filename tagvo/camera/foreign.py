"""Calibrations of other tools, retold as the ROS CameraInfo that the camera reader knows.

Sources: PhotonVision's camera calibration JSON, OpenCV's FileStorage (calibration sample),
camodocal (VINS-Fusion), camera_calibration's oST text, librealsense's T265 intrinsics.
"""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tagvo.errors import CameraError, shown
from tagvo.textfile import parse_json, parse_yaml, read_text

_T265 = {"none": "none", "brown_conrady": "radtan", "inverse_brown_conrady": None,
         "kannala_brandt4": "equidistant"}  # fmt: skip
_NAMES = {"camera_matrix": ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K"),
          "coefficients": ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs",
                           "dist_coeffs", "D"),
          "width": ("image_width", "image_Width"), "height": ("image_height", "image_Height"),
          "fisheye": ("fisheye_model", "fisheye", "Fisheye_Model")}  # fmt: skip


def calibration_data(path: Path, name: str | None = None) -> dict[str, Any]:
    """What a calibration file says, as the mapping of a camchain, a EuRoC or a ROS file.

    name: the camera wanted of a file that holds several; CameraError where it is none of them.
    """
    text = read_text(path, CameraError)
    if re.match(r"\s*(#[^\n]*\n\s*)*\[image\]", text):
        return _ost(text, path)
    json_like = text.lstrip()[:1] == "{" and path.suffix.lower() == ".json"
    value = (parse_json if json_like else parse_yaml)(text, str(path), CameraError)
    if not isinstance(value, dict):
        kind = "empty" if value is None else f"a {type(value).__name__}"
        raise CameraError(f"{path}: the file is {kind}; a mapping `key: value` is needed")
    for knows, retell in _TOOLS:
        if knows(value):
            return retell(value, path)
    return value


def _given(data: dict[str, Any], what: str) -> Any:
    return next((data[key] for key in _NAMES[what] if data.get(key) is not None), None)


def _as_ros(size: tuple[Any, Any], k: Any, model: str, coeffs: Any) -> dict[str, Any]:
    return {
        "image_width": size[0], "image_height": size[1], "camera_matrix": k,
        "distortion_model": model, "distortion_coefficients": coeffs,
    }  # fmt: skip


def _ost(text: str, path: Path) -> dict[str, Any]:
    """camera_calibration's text file: a heading, then the numbers below it."""
    found: dict[str, list[str]] = {}
    heading = ""
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if words and re.match(r"[-+.\d]", words[0]):
            found.setdefault(heading, []).extend(words)
        elif words and not words[0].startswith("["):
            heading = " ".join(words)
    try:
        rows = {key: [float(word) for word in words] for key, words in found.items()}
    except ValueError as err:
        raise CameraError(f"{path}: an oST file with a number that is none ({err})") from None
    for key in ("width", "height", "camera matrix", "distortion"):
        if key not in rows:
            raise CameraError(f"{path}: an oST file without `{key}`; it holds {', '.join(rows)}")
    d = rows["distortion"]
    size = rows["width"][0], rows["height"][0]
    return _as_ros(size, rows["camera matrix"], "equidistant" if len(d) == 4 else "radtan", d)


def _photonvision(data: dict[str, Any], path: Path) -> dict[str, Any]:
    size = data["resolution"]
    return _as_ros(
        (size.get("width"), size.get("height")), data["cameraIntrinsics"], "radtan",
        _photon_coeffs(data),
    )  # fmt: skip


def _photon_coeffs(data: dict[str, Any]) -> Any:
    return next((data[k] for k in ("distCoeffs", "cameraExtrinsics") if data.get(k)), None)


def _opencv(data: dict[str, Any], path: Path) -> dict[str, Any]:
    model = "equidistant" if _given(data, "fisheye") in (1, True) else "radtan"
    return _as_ros(
        (_given(data, "width"), _given(data, "height")), _given(data, "camera_matrix"), model,
        _given(data, "coefficients"),
    )  # fmt: skip


def _camodocal(data: dict[str, Any], path: Path) -> dict[str, Any]:
    kind = str(data.get("model_type")).upper()
    size = data.get("image_width"), data.get("image_height")
    if kind == "PINHOLE":
        f, d = (
            _block(data, "projection_parameters", path),
            _block(data, "distortion_parameters", path),
        )
        k = [f.get("fx"), 0.0, f.get("cx"), 0.0, f.get("fy"), f.get("cy"), 0.0, 0.0, 1.0]
        return _as_ros(size, k, "radtan", [d.get(key) for key in ("k1", "k2", "p1", "p2")])
    if kind == "KANNALA_BRANDT":
        f = _block(data, "projection_parameters", path)
        k = [f.get("mu"), 0.0, f.get("u0"), 0.0, f.get("mv"), f.get("v0"), 0.0, 0.0, 1.0]
        return _as_ros(size, k, "equidistant", [f.get(key) for key in ("k2", "k3", "k4", "k5")])
    raise CameraError(
        f"{path} model_type: unknown {shown(data.get('model_type'))}; camodocal's PINHOLE and"
        " KANNALA_BRANDT are read"
    )


def _block(data: dict[str, Any], key: str, path: Path) -> dict[str, Any]:
    if not isinstance(data.get(key), dict):
        raise CameraError(f"{path}: `{key}` is missing; camodocal's mapping is needed")
    return dict(data[key])


def _t265(data: dict[str, Any], path: Path) -> dict[str, Any]:
    """librealsense's rs2_intrinsics: width, height, ppx, ppy, fx, fy, model, coeffs."""
    said = str(data.get("model", "kannala_brandt4")).lower().removeprefix("rs2_distortion_")
    said = said.removeprefix("distortion.").replace(" ", "_")
    model = _T265.get(said)
    if model is None:
        raise CameraError(f"{path} model: unknown {shown(said)}; kannala_brandt4, brown_conrady or"
                          " none is needed")  # fmt: skip
    coeffs = data.get("coeffs")
    if model == "equidistant" and isinstance(coeffs, list):
        coeffs = coeffs[:4]  # the fifth of rs2_intrinsics is unused
    k = [data["fx"], 0.0, data["ppx"], 0.0, data["fy"], data["ppy"], 0.0, 0.0, 1.0]
    return _as_ros((data.get("width"), data.get("height")), k, model, coeffs or [])


_Tool = tuple[Callable[[dict[str, Any]], bool], Callable[[dict[str, Any], Path], dict[str, Any]]]
_TOOLS: tuple[_Tool, ...] = (
    (lambda d: isinstance(d.get("resolution"), dict) and "cameraIntrinsics" in d, _photonvision),
    (lambda d: "model_type" in d, _camodocal),
    (lambda d: {"fx", "fy", "ppx", "ppy"} <= set(d), _t265),
    (lambda d: "distortion_model" not in d and "intrinsics" not in d
     and _given(d, "camera_matrix") is not None, _opencv),
)  # fmt: skip
