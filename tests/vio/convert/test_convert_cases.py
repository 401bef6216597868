"""Troubles of real users, from their own kinds of files: each gives the right value or word."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_calls import tagvio
from numpy.testing import assert_allclose

from tagvo.camera.calibration import load_camera
from tagvo.errors import CameraError
from tagvo.maps.formats import read_map_file

DATA = os.environ.get("TAGVIO_DATA")
CASES = Path(DATA).parent / "cases" if DATA else Path("nowhere")
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="TAGVIO_DATA has no cases beside it")
ARENA = Path(__file__).parents[3] / "configs/maps/arena.yaml"
T_CAM_IMU = "[[0, -1, 0, 0], [-1, 0, 0, 0.1], [0, 0, -1, -0.05], [0, 0, 0, 1]]"


def case(number: str) -> Path:
    return next(CASES.glob(f"{number}-*"))


def converted(bag: Path, log: Path, *words, extrinsics: bool = True) -> str:
    done = tagvio("convert", bag, "--out", log, "--map", ARENA, *words)
    assert done.code == 0, done.err
    if extrinsics:
        path = log / "camchain-imucam.yaml"
        head, _, rest = path.read_text().partition("  T_cam_imu:")
        rest = rest[rest.index("  timeshift") :]
        path.write_text(f"{head}  T_cam_imu: {T_CAM_IMU}\n{rest}")
    return done.err


def rms(log: Path, *words) -> dict[str, float]:
    """Position error at capture [m] by estimator."""
    done = tagvio("compare", log, "--out", log / "out", *words)
    assert done.code == 0, done.err
    content = json.loads((log / "out/comparison.json").read_text())
    return {name: one["capture"]["position_rmse_m"] for name, one in content["estimators"].items()}


def test_01_rectified_tags_and_images_take_p(tmp_path):
    said = converted(case("01") / "detections", tmp_path / "tags")
    assert "is taken for rectified" in said
    camera = load_camera(tmp_path / "tags/camchain-imucam.yaml")
    assert_allclose(camera.intrinsics, [494.83, 510.27, 319.12, 239.88], atol=0.005)
    assert not camera.coeffs.any()
    errors = rms(tmp_path / "tags")
    assert errors["vo"] < 0.0022  # 1.8 mm by the README
    assert errors["vio"] < 0.0055  # 4.2 mm
    converted(case("01") / "images", tmp_path / "images")
    assert rms(tmp_path / "images", "--vo-only")["vo"] < 0.002


def test_01_a_raw_calibration_of_rectified_images_is_doubted(tmp_path):
    rig = case("02") / "camchain-imucam.yaml"
    bag = case("01") / "images"
    doubt = "its distortion is of raw images"
    assert doubt in converted(bag, tmp_path / "a", "--camera", f"{rig}:cam1", extrinsics=False)
    raw = converted(bag, tmp_path / "b", "--camera", f"{rig}:cam1", "--rectified", "no",
                    extrinsics=False)  # fmt: skip
    assert doubt not in raw


def test_02_the_camera_of_the_image_topic_is_taken(tmp_path):
    rig = case("02") / "camchain-imucam.yaml"
    converted(case("02") / "bag", tmp_path / "log", "--camera", rig, extrinsics=False)
    assert_allclose(load_camera(tmp_path / "log/camchain-imucam.yaml").intrinsics[:2], 530.0)
    assert rms(tmp_path / "log", "--vo-only")["vo"] < 0.0012  # 0.95 mm


def test_03_halves_of_an_imu_are_put_together(tmp_path):
    said = converted(case("03") / "bag", tmp_path / "log")
    assert "gyro of /camera/gyro/sample, accelerometer of /camera/accel/sample" in said
    assert rms(tmp_path / "log")["vio"] < 0.006  # 3.3 mm where both come in one topic


def test_07_a_setpoint_is_no_truth(tmp_path):
    said = converted(case("07") / "bag", tmp_path / "log", extrinsics=False)
    assert "no topic whose name speaks for a truth" in said
    assert "/mavros/setpoint_position/local" in said
    assert not (tmp_path / "log/mav0/state_groundtruth_estimate0").exists()


def test_08_short_rows_of_clover():
    tags = read_map_file(case("08") / "map.txt").tag_map
    places = dict(zip(tags.tag_id.tolist(), tags.p_WT.tolist(), strict=True))
    assert [places[i] for i in (3, 4, 5, 6)] == [[1, 0, 0.5], [0, 1, 0], [1, 0.5, 0], [2.2, 0.2, 0]]
    assert_allclose(tags.R_WT, np.broadcast_to(np.eye(3), (len(tags), 3, 3)), atol=1e-12)
    flat = read_map_file(case("08") / "flat.txt").tag_map
    assert flat.size.tolist() == [0.4] * 4


def test_09_an_uncalibrated_camera_info_stops_nothing(tmp_path):
    said = converted(case("09") / "bag", tmp_path / "a", extrinsics=False)
    assert "/camera/camera_info is not calibrated (K is 0): give --camera" in said
    assert not (tmp_path / "a/camchain-imucam.yaml").exists()
    given = ARENA.parents[1] / "cameras/arena.yaml"
    converted(case("09") / "bag", tmp_path / "b", "--camera", given, extrinsics=False)
    assert load_camera(tmp_path / "b/camchain-imucam.yaml").resolution == (640, 480)


def one_image_log(root: Path, image: Path, tag_map: Path, camera: Path) -> Path:
    (root / "mav0/cam0/data").mkdir(parents=True)
    shutil.copy(tag_map, root / "tagmap.yaml")
    shutil.copy(camera, root / "camchain-imucam.yaml")
    shutil.copy(image, root / f"mav0/cam0/data/{image.name}")
    (root / "mav0/cam0/data.csv").write_text(f"#timestamp [ns],filename\n1000,{image.name}\n")
    return root


def test_11_tags_that_are_not_on_the_map_are_told(tmp_path):
    a = case("11")
    log = one_image_log(tmp_path / "log", a / "photo.png", a / "tagmap.yaml", a / "camera.yaml")
    done = tagvio("run", log, "--out", tmp_path / "out")
    assert done.code == 0
    assert "tags 0 (in 1 frame) are seen and not on the map, which has 2" in done.err
    assert json.loads((tmp_path / "out/run.json").read_text())["tags_not_on_map"] == {"0": 1}
    text = (log / "tagmap.yaml").read_text()
    (log / "tagmap.yaml").write_text(text.replace("id: 2", "id: 0"))
    done = tagvio("run", log, "--out", tmp_path / "out")
    assert "not on the map" not in done.err
    p = np.array((tmp_path / "out/vo.tum").read_text().split()[1:4], dtype=float)
    assert_allclose(p, [0.040, -0.004, 0.404], atol=0.002)


def test_11_another_family_is_named(tmp_path):
    a = case("11")
    log = one_image_log(tmp_path / "log", a / "family.jpg", a / "family_map.yaml",
                        a / "family_camera.yaml")  # fmt: skip
    done = tagvio("run", log, "--out", tmp_path / "out")
    assert "no tag of tag25h9 is seen, but of tag36h11: 1;" in done.err


def test_13_calibrations_of_other_tools():
    for name in ("photonvision.json", "opencv.yml", "ost.txt"):
        camera = load_camera(case("13") / name)
        assert camera.intrinsics.tolist() == [530.0, 530.0, 319.5, 239.5], name
        assert_allclose(camera.coeffs, [-0.18, 0.05, 0.001, -0.0005, 0.0])
        assert (camera.model, camera.resolution) == ("radtan", (640, 480))
    camera = load_camera(case("13") / "camodocal.yaml")
    assert camera.intrinsics.tolist() == [461.6, 460.3, 363.0, 248.1]
    skewed = load_camera(case("13") / "ros_skew.yaml")
    assert "a skew of -0.61 px is taken as 0" in skewed.notes[0]
    with pytest.raises(CameraError, match="unknown 'ds'; supported: pinhole"):
        load_camera(case("13") / "camchain_ds.yaml")
