"""`tagvio simulate` as a user calls it: logs that replay, the same again, and what stops it."""

import contextlib
import hashlib
import json
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from cli_calls import SET_SHORT, SHORT, tagvio
from numpy.testing import assert_allclose
from once import once

from tagvo import geometry as geo
from tagvo.camera.calibration import load_camera
from tagvo.detect import make_detector
from vio.evaluate.truth import clean_truth, interpolate
from vio.sim.scenario import load_scenario
from vio.sources.flight_log.log import FlightLog

PLAIN = ["--set", "scene.texture.kind=plain"]


def simulate(out, *words, scenario="t1_qr"):
    return tagvio("simulate", scenario, "--out", out, *SET_SHORT, *words)


def digest(folder):
    """One hash of all files of a log and their names."""
    sums = hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        sums.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return sums.hexdigest()


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    def make(root):
        done = simulate(root / "log", "--detections")
        assert done.code == 0, done.err
        assert "frames, 801 IMU samples" in done.out or "frames, 800 IMU samples" in done.out
        assert "leaning by up to" in done.err

    return once(tmp_path_factory, "simulated", make) / "log"


def test_the_log_is_a_flight_log_like_any_other(written):
    log = FlightLog.open(written)
    assert [w for w in log.warnings if "imu_gap" not in w and "before_imu" not in w] == []
    assert [p.name for p in log.phases] == ["flight"]
    assert log.imu_noise.rate_hz == 200.0
    assert log.truth.v_WI is not None
    assert np.abs(log.truth.b_a).max() > 0.0
    assert log.frame_count >= 37
    assert (log.frames.arrival_ns > log.frames.t_ns).all()


def test_what_is_written_beside_it_says_what_was_true(written):
    said, true = (
        load_camera(written / name) for name in ("camchain-imucam.yaml", "truth_rig.yaml")
    )
    assert np.degrees(geo.angle(said.R_CI @ true.R_CI.T)) == pytest.approx(0.1, abs=1e-6)
    assert said.timeshift_s == true.timeshift_s == 0.005
    assert said.intrinsics[0] != true.intrinsics[0] == 530.0
    assert load_scenario(str(written / "scenario.yaml")) == load_scenario("t1_qr", SHORT)


def test_imu_and_truth_belong_together(written):
    """The truth's slope is its velocity, and the gyro what turns its attitude, to the noise."""
    log = FlightLog.open(written)
    truth, t_ns = clean_truth(log.truth), log.imu.t_ns
    t = (truth.t_ns - truth.t_ns[0]) * 1e-9
    assert_allclose(np.gradient(truth.p_WI, t, axis=0)[1:-1], truth.v_WI[1:-1], atol=2e-3)
    a, b = (interpolate(truth, t_ns[k]) for k in (slice(50, 650), slice(70, 670)))
    turned = geo.log(np.swapaxes(a.R_WI, -1, -2) @ b.R_WI)
    dt = (t_ns[70:670] - t_ns[50:650]) * 1e-9
    gyro = np.stack([log.imu.gyro_I[50 + i : 70 + i].mean(axis=0) for i in range(600)])
    bias = log.truth.b_g[0]
    assert_allclose(turned / dt[:, None], gyro - bias, atol=0.03)


def test_compare_finds_the_flight(written, tmp_path):
    done = tagvio("compare", written, "--out", tmp_path)
    assert done.code == 0, done.err
    views = json.loads((tmp_path / "comparison.json").read_text())["estimators"]
    assert views["vo"]["capture"]["position_rmse_m"] < 0.02
    assert views["vio"]["now"]["position_rmse_m"] < 0.02
    assert views["vio"]["now"]["coverage"] > 0.5


def test_the_same_scenario_gives_the_same_log_and_another_seed_another(written, tmp_path):
    again = tmp_path / "again"
    # from the scenario that the log holds, by its own file alone
    done = tagvio("simulate", written / "scenario.yaml", "--out", again, "--detections")
    assert done.code == 0, done.err
    for name in ("imu0/data.csv", "cam0/data.csv", "cam0/detections.csv"):
        assert (again / "mav0" / name).read_bytes() == (written / "mav0" / name).read_bytes()
    other = tmp_path / "other"
    assert simulate(other, "--detections", "--set", "seed=2").code == 0
    assert (other / "mav0/imu0/data.csv").read_bytes() != (
        written / "mav0/imu0/data.csv"
    ).read_bytes()


def test_a_log_is_replaced_only_when_asked(written, tmp_path):
    before = digest(written)
    done = simulate(written, "--detections")
    assert (done.code, "holds a log already" in done.err) == (1, True)
    assert digest(written) == before
    out = tmp_path / "log"
    assert simulate(out, "--detections").code == 0
    assert simulate(out, "--detections", "--replace").code == 0
    assert digest(out) == before


def test_along_the_log_that_was_written(written, tmp_path):
    out = tmp_path / "along"
    done = tagvio("simulate", "along", "--along", written, "--out", out, "--detections",
                  "--set", "along.end_s=2", "--set", "stream.rate_hz=10")  # fmt: skip
    assert done.code == 0, done.err
    assert "truth: 801 rows" in done.err
    log = FlightLog.open(out)
    assert (out / "mav0/imu0/data.csv").read_bytes() == (
        written / "mav0/imu0/data.csv"
    ).read_bytes()
    assert log.frame_count >= 17
    assert "--along" in (out / "scenario.yaml").read_text().splitlines()[0]


ONE_A_SECOND = ["--set", "stream.rate_hz=1", "--set", "lens.supersample=3"]


def test_images_show_the_map_where_the_true_camera_sees_it(tmp_path):
    """Tags found in the images lie on the exact corners; any number of workers, the same images."""
    images, corners = tmp_path / "images", tmp_path / "corners"
    assert simulate(images, *ONE_A_SECOND, scenario="clean").code == 0
    words = [*ONE_A_SECOND, "--set", "corners.sigma_px=0"]
    assert simulate(corners, *words, "--detections", scenario="clean").code == 0
    seen, exact = FlightLog.open(images), FlightLog.open(corners, use_detections=True)
    detector, count = make_detector("auto", seen.tag_map.family), 0
    for row in range(4):
        found, true = detector.detect(seen.frames.frame(row).image), exact.frames.frame(row)
        both = np.isin(true.detections.tag_id, found.tag_id)
        assert both.sum() > 5
        rows = [int(np.flatnonzero(found.tag_id == t)[0]) for t in true.detections.tag_id[both]]
        error = found.corners_px[rows] - true.detections.corners_px[both]
        assert np.sqrt(np.mean(error**2)) < 0.1
        count += len(rows)
    assert count > 60
    one = tmp_path / "one"
    assert simulate(one, *ONE_A_SECOND, "--workers", "1", scenario="clean").code == 0
    assert digest(one) == digest(images)


def test_ctrl_c_while_images_are_drawn(tmp_path):
    out = tmp_path / "log"
    with start(out, *SET_SHORT) as process:
        wait_for(out / "mav0/cam0/data.csv", 200)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    log = FlightLog.open(out)
    assert 2 <= log.frame_count < 38
    assert f"stopped by Ctrl-C after {log.frame_count} of" in err
    assert (log.truth.t_ns[-1] - log.truth.t_ns[0]) * 1e-9 < 3.9
    assert sum(1 for e in log.events() if hasattr(e, "image")) == log.frame_count
    assert not list(out.rglob("*.tmp"))


BAD = [
    (["t9", "--out", "x"], 1, "t9: no such file or scenario; choose one of along, clean"),
    (["t1_qr", "--out", "x", "--set", "sed=1"], 1, "unknown 'sed'; choose one of title, seed"),
    (["t1_qr", "--out", "x", "--set", "flight.middle=[1]"], 1, "flight.middle"),
    (["t1_qr"], 2, "Missing option '--out'"),
    (["t1_qr", "--out", "x", "--workers", "0"], 2, "Invalid value for '--workers'"),
    (["along", "--out", "x", "--along", "nowhere"], 1, "nowhere: no IMU 'imu0'"),
    (["t3_qr", "--out", "x", "--set", "flight.speed_m_s=5"], 1, "QR would lean over by"),
    (
        ["t1_qr", "--out", "x", "--set", "map.every=3", "--set", "map.file=maps/arena.yaml",
         "--set", "flight.name=waypoints",
         "--set", "flight.waypoints=[[0,1,1,1,0],[9,9,1,1,0]]"],
        1, "flight: it leaves the map at",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("words", "code", "says"), BAD)
def test_bad_calls_end_in_one_clear_line(words, code, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = tagvio("simulate", *words)
    assert done.code == code
    assert says in done.err
    if code == 1:
        assert done.err.strip().count("\n") <= 1
    assert not list(tmp_path.rglob("*.csv"))


def start(out, *words):
    """The command in a process of its own, to be interrupted."""
    code = f"import sys; sys.argv = {['tagvio', 'simulate', 't1_qr', '--out', str(out), *words]!r}"
    code += "\nfrom vio.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


@contextlib.contextmanager
def room_for(size):
    """Within it no file may grow beyond a size: what would is refused, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def wait_for(path, size):
    """Until a file has grown to a size."""
    end = time.monotonic() + 120
    while not (path.exists() and path.stat().st_size > size) and time.monotonic() < end:
        time.sleep(0.02)


def test_a_disk_that_fills_leaves_a_log_that_can_be_read(tmp_path):
    out = tmp_path / "log"
    with room_for(300_000):
        done = tagvio("simulate", "t1_qr", "--out", out, "--detections", *PLAIN)
    assert done.code == 1
    assert "the disk is full" in done.err
    assert "frames before that are a log that can be read" in done.err
    log = FlightLog.open(out)
    frames = list(log.events())
    assert [w for w in log.warnings if "imu_gap" not in w and "before_imu" not in w] == []
    assert log.frame_count > 50
    assert len(frames) > 500
    sizes = {path: path.stat().st_size for path in out.rglob("*.csv")}
    assert 290_000 < max(sizes.values()) <= 300_000
    assert all(path.read_bytes().endswith(b"\n") for path in sizes)
    spent = (log.frames.t_ns[-1] - log.imu.t_ns[0]) * 1e-9
    assert abs((log.imu.t_ns[-1] - log.imu.t_ns[0]) * 1e-9 - spent) < 0.3  # a whole, shorter flight


def test_a_disk_that_fills_while_images_are_drawn(tmp_path):
    """The one that does not fit leaves nothing behind, and the drawing of others ends in order."""
    out = tmp_path / "log"
    with room_for(50_000):  # an image takes some 200 kB
        done = simulate(out, *PLAIN)
    assert (done.code, "the disk is full" in done.err) == (1, True)
    assert "no frame was written" in done.err
    assert not list(out.rglob("*.tmp"))
    assert not list(out.rglob("*.png"))


def test_no_room_for_anything(tmp_path):
    with room_for(1000):
        done = simulate(tmp_path / "log", "--detections")
    assert (done.code, "the disk is full" in done.err) == (1, True)
