"""Camera files as Kalibr, OpenVINS, EuRoC and ROS write them, and every fault a field can have."""

import os
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.camera.calibration import camera_to_yaml, load_camera, save_camera
from tagvo.camera.model import Camera
from tagvo.errors import CameraError

KALIBR = """
cam0:
  camera_model: pinhole
  intrinsics: [461.629, 460.152, 362.680, 246.049]
  distortion_model: radtan
  distortion_coeffs: [-0.27695497, 0.06712482, 0.00087538, 0.00011556]
  T_cam_imu:
  - [0.01779318, 0.99967549, -0.01822936, 0.07008565]
  - [-0.9998017, 0.01795239, 0.00860714, -0.01771023]
  - [0.00893160, 0.01807260, 0.99979678, 0.00399246]
  - [0.0, 0.0, 0.0, 1.0]
  timeshift_cam_imu: -8.121e-05
  rostopic: /cam0/image_raw
  resolution: [752, 480]
"""
EUROC = """
sensor_type: camera
comment: VI-Sensor cam0 (MT9M034)
T_BS: {cols: 4, rows: 4, data: [0.0148655429818, -0.999880929698, 0.00414029679422,
  -0.0216401454975, 0.999557249008, 0.0149672133247, 0.025715529948, -0.064676986768,
  -0.0257744366974, 0.00375618835797, 0.999660727178, 0.00981073058949, 0.0, 0.0, 0.0, 1.0]}
rate_hz: 20
resolution: [752, 480]
camera_model: pinhole
intrinsics: [458.654, 457.296, 367.215, 248.375] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]
"""
ROS = """
image_width: 640
image_height: 480
camera_name: head
camera_matrix: {rows: 3, cols: 3, data: [600.5, 0, 320.5, 0, 601.5, 240.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.1, -0.2, 0.003, 1e-4, 0]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""


def load(tmp_path: Path, text: str) -> Camera:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    return load_camera(path)


def edited(text: str, **fields: object) -> str:
    """A file with some fields of the camera changed; None takes a field away."""
    data = yaml.safe_load(text)
    block = data.get("cam0", data)
    for key, value in fields.items():
        block.pop(key, None)
        if value is not None:
            block[key] = value
    return yaml.safe_dump(data)


def test_kalibr(tmp_path: Path) -> None:
    camera = load(tmp_path, KALIBR)
    assert camera.model == "radtan"
    assert camera.resolution == (752, 480)
    assert camera.timeshift_s == -8.121e-05
    assert_allclose(camera.intrinsics, [461.629, 460.152, 362.680, 246.049])
    assert_allclose(camera.coeffs, [-0.27695497, 0.06712482, 0.00087538, 0.00011556])
    assert_allclose(camera.p_CI, [0.07008565, -0.01771023, 0.00399246])
    assert_allclose(camera.R_CI[1], [-0.9998017, 0.01795239, 0.00860714], atol=1e-6)
    assert_allclose(camera.R_CI @ camera.R_CI.T, np.eye(3), atol=1e-14)


def test_openvins_and_the_flattened_form_say_the_same(tmp_path: Path) -> None:
    rows = np.array(yaml.safe_load(KALIBR)["cam0"]["T_cam_imu"])
    inverse = np.linalg.inv(rows).tolist()
    openvins = "%YAML:1.0 # needed by OpenCV\n\n" + edited(
        KALIBR, T_cam_imu=None, T_imu_cam=inverse
    )
    flat = edited(KALIBR, T_cam_imu=rows.ravel().tolist())
    opencv = edited(KALIBR, T_cam_imu=None) + "  T_imu_cam: !!opencv-matrix\n"
    opencv += f"    rows: 4\n    cols: 4\n    dt: d\n    data: {np.ravel(inverse).tolist()}\n"
    expected = load(tmp_path, KALIBR)
    for text in (openvins, flat, opencv, "%YAML:1.0\n---\n" + flat):
        camera = load(tmp_path, text)
        assert_allclose(camera.R_CI, expected.R_CI, atol=1e-6)
        assert_allclose(camera.p_CI, expected.p_CI, atol=1e-6)


def test_euroc_is_the_inverse_of_kalibr(tmp_path: Path) -> None:
    camera = load(tmp_path, EUROC)
    assert camera.model == "radtan"
    assert_allclose(camera.R_CI[0], [0.0148655429818, 0.999557249008, -0.0257744366974], atol=1e-9)
    assert_allclose(camera.p_CI, [0.0652229095355, -0.0207063854927, -0.00805460246003], atol=1e-9)
    assert camera.timeshift_s == 0.0


def test_ros_camera_info(tmp_path: Path) -> None:
    camera = load(tmp_path, ROS)
    assert_allclose(camera.intrinsics, [600.5, 601.5, 320.5, 240.5])
    assert_allclose(camera.coeffs, [0.1, -0.2, 0.003, 1e-4, 0])
    assert camera.resolution == (640, 480)
    assert_allclose(camera.R_CI, np.eye(3))
    rational = load(
        tmp_path,
        edited(
            ROS,
            distortion_model="rational_polynomial",
            distortion_coefficients={"data": [1, 2, 3, 4, 5, 6, 7, 8]},
        ),
    )
    assert rational.model == "radtan"
    assert len(rational.coeffs) == 8
    for name in ("equidistant", "fisheye"):
        four = {"rows": 1, "cols": 4, "data": [0.1, 0.2, 0.3, 0.4]}
        text = edited(ROS, distortion_model=name, distortion_coefficients=four)
        assert load(tmp_path, text).model == "equidistant"


@pytest.mark.parametrize(
    ("model", "coeffs", "expected", "kept"),
    [
        ("radtan", [0.1] * 4, "radtan", 4),
        ("radtan", [0.1] * 5, "radtan", 5),
        ("rational_polynomial", [0.1] * 8, "radtan", 8),
        ("radtan", [0.1] * 8 + [0.0] * 4, "radtan", 8),
        ("radtan", [0.1] * 8 + [0.0] * 6, "radtan", 8),
        ("equi", [0.1] * 4, "equidistant", 4),
        ("none", [], "none", 0),
        ("none", [0, 0, 0, 0], "none", 0),
        ("none", None, "none", 0),
    ],
)
def test_distortion_names_and_counts(tmp_path: Path, model, coeffs, expected, kept) -> None:
    camera = load(tmp_path, edited(KALIBR, distortion_model=model, distortion_coeffs=coeffs))
    assert camera.model == expected
    assert len(camera.coeffs) == kept


SHEAR = [[1, 0.01, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
MIRROR = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
LAST_ROW = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0.1, 0, 0, 1]]
FAULTS = [
    (KALIBR, {"camera_model": "omni"}, "camera_model: unknown 'omni'; supported: pinhole"),
    (KALIBR, {"camera_model": "ds"}, "'ds'; supported"),
    (KALIBR, {"camera_model": "eucm"}, "'eucm'; supported"),
    (KALIBR, {"distortion_model": "fov"}, "distortion_model: unknown 'fov'; choose one of radtan"),
    (KALIBR, {"distortion_model": None}, "`distortion_model` is missing"),
    (KALIBR, {"distortion_coeffs": None}, "`distortion_coeffs` is missing"),
    (KALIBR, {"distortion_coeffs": [0.1, 0.2, 0.3]}, "distortion_coeffs: 3 numbers"),
    (KALIBR, {"distortion_coeffs": [0.1, 0.2, 0.3, "x"]}, "distortion_coeffs"),
    (KALIBR, {"distortion_coeffs": 0.1}, "distortion_coeffs: 0.1"),
    (KALIBR, {"distortion_coeffs": [0.1] * 12}, "beyond the eighth"),
    (KALIBR, {"distortion_model": "equidistant", "distortion_coeffs": [0.1] * 5}, "takes 4"),
    (KALIBR, {"distortion_model": "none"}, "without distortion"),
    (KALIBR, {"intrinsics": None}, "`intrinsics` is missing"),
    (KALIBR, {"intrinsics": [460.0, 460.0, 320.0]}, "intrinsics"),
    (KALIBR, {"intrinsics": [460.0, -460.0, 320.0, 240.0]}, "must be positive"),
    (KALIBR, {"intrinsics": [460.0, float("nan"), 320.0, 240.0]}, "4 finite numbers"),
    (KALIBR, {"resolution": None}, "`resolution` is missing"),
    (KALIBR, {"resolution": [752]}, "resolution: [752]"),
    (KALIBR, {"resolution": [752.5, 480]}, "whole numbers"),
    (KALIBR, {"resolution": [0, 480]}, "whole numbers"),
    (KALIBR, {"T_cam_imu": SHEAR}, "T_cam_imu: the upper left 3x3 is no rotation"),
    (KALIBR, {"T_cam_imu": MIRROR}, "mirrors"),
    (KALIBR, {"T_cam_imu": LAST_ROW}, "last row [0.1"),
    (KALIBR, {"T_cam_imu": SHEAR[:3]}, "a list of 16 finite numbers"),
    (KALIBR, {"T_cam_imu": "eye"}, "T_cam_imu: 'eye'"),
    (KALIBR, {"timeshift_cam_imu": "soon"}, "timeshift_cam_imu: 'soon'"),
    (EUROC, {"T_BS": {"rows": 4, "cols": 4}}, "T_BS: None"),
    (ROS, {"image_width": None}, "image_width, image_height"),
    (ROS, {"camera_matrix": {"data": [600, 3, 320, 0, 600, 240, 0, 0, 1]}}, "no skew"),
    (ROS, {"camera_matrix": {"data": [600] * 4}}, "camera_matrix"),
    (ROS, {"distortion_model": "thin_prism"}, "unknown 'thin_prism'"),
]


@pytest.mark.parametrize(("text", "fields", "said"), FAULTS)
def test_a_wrong_field_is_named_with_its_file(tmp_path: Path, text, fields, said) -> None:
    with pytest.raises(CameraError) as caught:
        load(tmp_path, edited(text, **fields))
    assert said in str(caught.value)
    assert str(tmp_path / "camera.yaml") in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["", "cam1: {}", "a: [", "[1, 2]", "cam0: 3", "x: {y: 2}"])
def test_a_file_without_the_camera_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(CameraError, match=r"camera\.yaml"):
        load(tmp_path, text)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(CameraError, match="no such file"):
        load_camera(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(CameraError, match="not a text file"):
        load_camera(tmp_path / "binary.yaml")


def test_another_camera_of_the_chain_is_taken_by_name(tmp_path: Path) -> None:
    path = tmp_path / "chain.yaml"
    path.write_text(KALIBR + KALIBR.replace("cam0:", "cam1:").replace("752", "640"))
    assert load_camera(path, "cam1").resolution == (640, 480)
    with pytest.raises(CameraError, match="no `cam2`; it has cam0, cam1"):
        load_camera(path, "cam2")


finite = st.floats(-10, 10)
models = st.sampled_from([("radtan", 4), ("radtan", 5), ("radtan", 8), ("equidistant", 4)])


@settings(max_examples=60, deadline=None)
@given(data=st.data(), kind=st.one_of(models, st.just(("none", 0))), shift=st.floats(-1, 1))
def test_a_saved_camera_is_read_back(tmp_path_factory, data, kind, shift) -> None:
    model, count = kind
    numbers = st.lists(finite, min_size=count, max_size=count)
    R_CI = geo.exp(np.array(data.draw(st.lists(finite, min_size=3, max_size=3))))
    camera = Camera(
        model,
        np.array(data.draw(st.lists(st.floats(1.0, 1e5), min_size=4, max_size=4))),
        np.array(data.draw(numbers), dtype=float),
        (data.draw(st.integers(1, 9999)), data.draw(st.integers(1, 9999))),
        R_CI,
        np.array(data.draw(st.lists(finite, min_size=3, max_size=3))),
        shift,
    )
    path = tmp_path_factory.mktemp("camera") / "camchain-imucam.yaml"
    save_camera(camera, path)
    back = load_camera(path)
    assert (back.model, back.resolution, back.timeshift_s) == (model, camera.resolution, shift)
    for name in ("intrinsics", "coeffs", "p_CI"):
        np.testing.assert_array_equal(getattr(back, name), getattr(camera, name))
    assert_allclose(back.R_CI, R_CI, atol=1e-14)


@settings(max_examples=100, deadline=None)
@given(at=st.integers(0, len(KALIBR) - 1), byte=st.characters(max_codepoint=126))
def test_a_damaged_file_gives_a_camera_or_a_word(tmp_path_factory, at: int, byte: str) -> None:
    path = tmp_path_factory.mktemp("damaged") / "camera.yaml"
    path.write_text(KALIBR[:at] + byte + KALIBR[at + 1 :])
    try:
        camera = load_camera(path)
    except CameraError as error:
        said, camera = str(error), None
    if camera is None:
        assert str(path) in said
        assert "\n" not in said
    else:
        assert np.isfinite(camera.intrinsics).all()
        assert abs(np.linalg.det(camera.R_CI) - 1.0) < 1e-9


def test_every_real_camera_file_is_read() -> None:
    root = os.environ.get("TAGVIO_DATA")
    if not root:
        pytest.skip("TAGVIO_DATA is not set: no real camera files here")
    files = [*Path(root).glob("*/camchain-imucam.yaml"), *Path(root).glob("*/camera.yaml")]
    assert len(files) >= 4
    for path in files:
        camera = load_camera(path)
        assert min(camera.resolution) > 0
        assert camera_to_yaml(camera).startswith("cam0:")


@pytest.mark.parametrize("focal", [1e-300, 0.5])
def test_a_focal_length_that_is_none_names_file_and_key(tmp_path: Path, focal: float) -> None:
    with pytest.raises(CameraError, match=r"camera.yaml cam0 intrinsics: .*at least 1 pixel"):
        load(tmp_path, edited(KALIBR, intrinsics=[focal, 460.0, 362.0, 246.0]))


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"resolution": [1, 1]}, "resolution: 1x1 pixels hold no tag"),
        ({"resolution": [320, 240]}, "lies outside of 320x240 pixels"),
        ({"distortion_coeffs": [-90.0, 0.0, 0.0, 0.0]}, "folds the image"),
    ],
)
def test_an_absurd_calibration_earns_a_word(
    tmp_path: Path, fields: dict[str, object], said: str
) -> None:
    assert load(tmp_path, KALIBR).notes == ()
    (note,) = load(tmp_path, edited(KALIBR, **fields)).notes
    assert said in note
