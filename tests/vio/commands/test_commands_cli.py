"""`tagvio run` and `tagvio compare` from outside: files, keys, options, exit codes, one's bytes."""

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_calls import STEP, T0, TIMESHIFT_S, tagvio, write_true_log
from flying_log import write_flying_log
from small_log import FRAME_STAMPS, IMU_STAMPS, write_log

from vio.localize.warmup import warm_up
from vio.sinks.tum import read_tum

STATS = {
    "position_rmse_m", "position_mean_m", "position_median_m", "position_std_m", "position_p95_m",
    "position_max_m", "rotation_rmse_deg", "rotation_mean_deg", "rotation_median_deg",
    "rotation_std_deg", "velocity_rmse_m_s", "nees_pose", "coverage", "n",
}  # fmt: skip
RUN_KEYS = {"frames", "imu", "rejected", "states", "timing_ms", "counters"}
FRAME_KEYS = {"total", "with_pose", "fused", "rejected"}
TUM_LINE = re.compile(r"\d+\.\d{9}( -?\d+\.\d+){7}")
FRAME_DONE = re.compile(rb"(?<!\d)[1-9]\d*/400")  # the bar of `slow_log` has moved


@pytest.fixture(scope="module")
def true_log(tmp_path_factory):
    return write_true_log(tmp_path_factory.mktemp("true"))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("small"), detections=True)


def run_json(out: Path) -> dict:
    return json.loads((out / "run.json").read_text())


def run(log, out, *words) -> dict:
    done = tagvio("run", log, "--out", out, *words)
    assert done.code == 0, done.err
    return run_json(out)


def stamps(out: Path) -> list[int]:
    return read_tum(out / "vo.tum")[0].tolist()


def truth_of(log):
    rows = np.loadtxt(log / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",")
    return rows[:, 1:4], rows[:, 4:8]


def test_run_writes_the_pose_of_the_imu_in_the_map_at_the_imus_time(true_log, tmp_path):
    summary = run(true_log, tmp_path)
    assert set(summary) >= RUN_KEYS
    assert set(summary["frames"]) == FRAME_KEYS
    assert summary["frames"] == {"total": 12, "with_pose": 12, "fused": None, "rejected": None}
    assert summary["interrupted"] is False
    assert set(summary["timing_ms"]) == {"detect", "tagpose", "select", "fuse", "joint", "total"}
    assert all(set(t) == {"p50", "p99"} for t in summary["timing_ms"].values())
    t_ns, p_WI, q_WI = read_tum(tmp_path / "vo.tum")
    assert t_ns.tolist() == [T0 + i * STEP + round(TIMESHIFT_S * 1e9) for i in range(12)]
    p_true, q_true = truth_of(true_log)
    np.testing.assert_allclose(p_WI, p_true, atol=1e-6)
    np.testing.assert_allclose(np.abs(np.sum(q_WI * q_true, axis=1)), 1.0, atol=1e-9)


def test_tum_lines_are_what_evo_reads(true_log, tmp_path):
    run(true_log, tmp_path)
    lines = (tmp_path / "vo.tum").read_text().split("\n")
    assert lines.pop() == ""
    assert [line for line in lines if not TUM_LINE.fullmatch(line)] == []
    evo = pytest.importorskip("evo.tools.file_interface", exc_type=ImportError)
    assert evo.read_tum_trajectory_file(tmp_path / "vo.tum").num_poses == 12


def test_the_same_call_writes_the_same_bytes(true_log, small, tmp_path):
    for log, words in ((true_log, ()), (small, ("--detections",))):
        one, two = tmp_path / "one", tmp_path / "two"
        run(log, one, *words)
        run(log, two, *words)
        assert (one / "vo.tum").read_bytes() == (two / "vo.tum").read_bytes() != b""


def test_compare_writes_the_contracted_json_report_and_trajectories(true_log, tmp_path):
    done = tagvio("compare", true_log, "--out", tmp_path)
    assert done.code == 0, done.err
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert set(content) == {"align", "estimators", "frames", "timing_ms"}
    assert content["align"] == "none"
    assert set(content["estimators"]) == {"vo", "vo_fir", "vo_kf"}  # the log has no IMU
    assert content["frames"] == {"total": 12, "with_pose": 12, "fused": None, "rejected": None}
    for views in content["estimators"].values():
        assert set(views) == {"capture", "now"}
        assert all(set(stats) == STATS for stats in views.values())
    vo = content["estimators"]["vo"]["capture"]
    assert vo["position_max_m"] < 1e-6
    assert vo["rotation_rmse_deg"] < 1e-4
    assert vo["n"] == 12
    assert vo["velocity_rmse_m_s"] is None
    assert content["estimators"]["vo_fir"]["capture"]["position_rmse_m"] > 0.01  # it lags
    page = (tmp_path / "report.html").read_text()
    assert "<html" in page
    assert not re.search(r"<(script|link|img)[^>]+(src|href)=", page), (
        "the report must open offline"
    )
    assert {p.name for p in tmp_path.glob("*.tum")} == {"vo.tum", "vo_fir.tum", "vo_kf.tum"}
    assert "capture" in done.out
    assert str(tmp_path / "report.html") in done.out


def test_fir_smooths_vo_tum_where_it_is_configured(true_log, tmp_path):
    run(true_log, tmp_path / "raw")
    run(true_log, tmp_path / "fir", "--set", "tagvo.fir=paper")
    run(true_log, tmp_path / "end", "--set", "tagvo.fir=endpoint")
    p_true, _ = truth_of(true_log)
    raw, fir, end = (read_tum(tmp_path / d / "vo.tum")[1] for d in ("raw", "fir", "end"))
    speed = 0.4
    lag = (p_true - fir)[6:]  # the IMU sits beside the turning camera: the line bends a little
    assert np.linalg.norm(lag, axis=1).mean() == pytest.approx(2 * STEP * 1e-9 * speed, rel=0.5)
    assert np.linalg.norm(p_true - end, axis=1)[6:].max() < 0.005
    assert np.abs(raw - p_true).max() < 1e-6


def test_config_file_and_set(true_log, tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("tagvo: {pose: fused, select: JBT}\n")
    fused = run(true_log, tmp_path / "a", "--config", path)
    assert "joint" not in fused["timing_ms"]
    back = run(true_log, tmp_path / "b", "--config", path, "--set", "tagvo.pose=joint")
    assert "joint" in back["timing_ms"]


def test_a_logs_own_config_is_taken_unless_another_is_given(tmp_path):
    log = write_true_log(tmp_path)
    (log / "config.yaml").write_text("tagvo: {pose: fused}\n")
    other = tmp_path / "other.yaml"
    other.write_text("tagvo: {pose: joint}\n")
    assert "joint" not in run(log, tmp_path / "a")["timing_ms"]
    assert "joint" in run(log, tmp_path / "b", "--config", other)["timing_ms"]


def test_every_nth_frame(true_log, tmp_path):
    run(true_log, tmp_path / "all")
    assert run(true_log, tmp_path / "some", "--every", 5)["frames"]["total"] == 3
    assert stamps(tmp_path / "some") == stamps(tmp_path / "all")[::5]


def test_only_tags(true_log, tmp_path):
    summary = run(true_log, tmp_path, "--only-tags", "4, 1,4")
    assert 0 < summary["frames"]["with_pose"] <= 12
    p_true, _ = truth_of(true_log)
    assert "not_on_map" not in summary["counters"]
    t_ns, p_WI, _ = read_tum(tmp_path / "vo.tum")
    rows = [(t - T0 - round(TIMESHIFT_S * 1e9)) // STEP for t in t_ns.tolist()]
    np.testing.assert_allclose(p_WI, p_true[rows], atol=1e-5)


def test_blackout_counts_from_the_first_imu_sample_else_the_first_frame(true_log, small, tmp_path):
    summary = run(true_log, tmp_path / "vo", "--blackout", "0.2,0.1")
    shift = round(TIMESHIFT_S * 1e9)
    seen = [(t - shift - T0) // STEP for t in stamps(tmp_path / "vo")]
    assert seen == [2, 3, 6, 7, 10, 11]
    assert summary["counters"]["frame_blackout"] == 6
    summary = run(small, tmp_path / "imu", "--detections", "--blackout", "1,0.5")
    kept = [t for t in FRAME_STAMPS if (t - IMU_STAMPS[0]) % 10**9 >= 5 * 10**8]
    assert summary["frames"]["total"] == len(kept) < len(FRAME_STAMPS)


def test_latency_moves_what_is_known_when_not_the_pose(true_log, tmp_path):
    run(true_log, tmp_path / "soon")
    run(true_log, tmp_path / "late", "--latency", 0.2)
    assert stamps(tmp_path / "soon") == stamps(tmp_path / "late")
    errors = {}
    for name, words in {"soon": (), "late": ("--latency", 0.2)}.items():
        tagvio("compare", true_log, "--out", tmp_path / name, *words)
        content = json.loads((tmp_path / name / "comparison.json").read_text())
        errors[name] = content["estimators"]["vo"]
    assert errors["late"]["capture"] == errors["soon"]["capture"]
    now = errors["late"]["now"]
    assert now["position_median_m"] > 0.05  # 0.2 s at 0.4 m/s, and a turning lever arm
    assert now["coverage"] < errors["soon"]["now"]["coverage"]


def test_skip_and_align(true_log, tmp_path):
    done = tagvio("compare", true_log, "--out", tmp_path, "--skip", 0.3, "--align", "yaw")
    assert done.code == 0, done.err
    content = json.loads((tmp_path / "comparison.json").read_text())
    assert content["align"] == "yaw"
    assert content["estimators"]["vo"]["capture"]["n"] == 6
    assert len(stamps(tmp_path)) == 12  # the run itself starts at the beginning


def test_detections_option_prefers_corners_to_images(small, tmp_path):
    assert run(small, tmp_path / "corners", "--detections")["frames"]["with_pose"] == 19
    assert run(small, tmp_path / "images")["frames"]["with_pose"] == 0  # the images are grey


def test_imu_option_names_another_imu(tmp_path):
    log = write_log(tmp_path, detections=True)
    (log / "mav0/imu0").rename(log / "mav0/imu_mavlink")
    assert run(log, tmp_path / "a", "--detections")["imu"]["total"] == 0
    named = run(log, tmp_path / "b", "--detections", "--imu", "imu_mavlink")
    assert named["imu"]["total"] == len(IMU_STAMPS)


def test_vo_only_without_imu(tmp_path):
    log = write_log(tmp_path, detections=True, imu=False)
    assert run(log, tmp_path / "out", "--detections", "--vo-only")["imu"]["total"] == 0


def test_warmup_says_how_long_it_took():
    done = tagvio("warmup")
    assert done.code == 0, done.err
    assert re.fullmatch(r"compiled code is ready: \d+\.\d s\n", done.out)


def test_a_log_without_imu_says_that_visual_odometry_runs_alone(true_log, tmp_path):
    done = tagvio("run", true_log, "--out", tmp_path / "a")
    assert "no IMU, so visual odometry runs alone" in done.err
    assert "no IMU" in run_json(tmp_path / "a")["warnings"][0]
    assert not (tmp_path / "a/vio.tum").exists()
    assert "no IMU" not in tagvio("run", true_log, "--out", tmp_path / "b", "--vo-only").err


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    return write_flying_log(tmp_path_factory.mktemp("flying"))


def test_a_log_with_an_imu_gives_the_filters_trajectory(flying, tmp_path):
    done = tagvio("compare", flying, "--out", tmp_path)
    assert (done.code, done.err) == (0, "")
    content = json.loads((tmp_path / "comparison.json").read_text())
    vio, vo = (content["estimators"][name]["now"] for name in ("vio", "vo"))
    assert vio["position_rmse_m"] < 0.01 < vo["position_rmse_m"]  # the frames come 60 ms late
    assert content["frames"]["fused"] >= 55
    assert "filter" in content["timing_ms"]


@pytest.mark.parametrize("update", ["pose", "corners"])
def test_a_replay_with_the_filter_writes_the_same_bytes_twice(flying, tmp_path, update):
    for name in ("one", "two"):
        run(flying, tmp_path / name, "--set", f"vio.update={update}")
    for name in ("vo.tum", "vio.tum"):
        one, two = ((tmp_path / d / name).read_bytes() for d in ("one", "two"))
        assert one == two
        assert len(one) > 1000


def test_version_help_and_no_arguments():
    assert re.fullmatch(r"tagvio \d+\.\d+\.\d+\n", tagvio("--version").out)
    for words in (
        ("--help",),
        ("-h",),
        ("run", "-h"),
        ("compare", "--help"),
        ("warmup", "-h"),
        ("map", "-h"),
    ):
        done = tagvio(*words)
        assert done.code == 0
        assert "Usage: tagvio" in done.out
    assert tagvio().code == 2


def test_a_closed_pipe_is_no_traceback(true_log, tmp_path):
    words = [sys.executable, "-m", "vio.cli", "run", str(true_log), "--out", str(tmp_path)]
    code = f"import sys; sys.argv = {words[2:]!r}; from vio.cli import main; main()"
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        err = process.stderr.read().decode()
    assert "Traceback" not in err
    assert (tmp_path / "vo.tum").exists()


def slow_log(root: Path, frames: int = 400) -> Path:
    """Many frames of noise, in which the search for tags takes its time."""
    log = write_true_log(root, frames=frames)
    (log / "mav0/cam0/detections.csv").unlink()
    folder = log / "mav0/cam0/data"
    folder.mkdir()
    noise = np.random.default_rng(1).integers(0, 255, (60, 80), dtype=np.uint8)
    cv2.imwrite(str(folder / "one.png"), cv2.resize(noise, (640, 480)))
    for i in range(frames):
        os.link(folder / "one.png", folder / f"{T0 + i * STEP}.png")
    return log


def test_ctrl_c_keeps_what_there_is(tmp_path):
    from tagvo.camera.calibration import load_camera
    from tagvo.config import TagvoConfig

    log, out = slow_log(tmp_path), tmp_path / "out"
    warm_up(load_camera(log / "camchain-imucam.yaml"), TagvoConfig())
    code = f"import sys; sys.argv = ['tagvio', 'run', {str(log)!r}, '--out', {str(out)!r}]\n"
    command = [sys.executable, "-c", code + "from vio.cli import main; main()"]
    ours, theirs = pty.openpty()  # progress is shown to a terminal alone: it tells us when
    with subprocess.Popen(command, stderr=theirs, env={**os.environ, "TERM": "xterm"}) as process:
        seen, deadline = b"", time.monotonic() + 120
        while not FRAME_DONE.search(seen) and time.monotonic() < deadline:
            if select.select([ours], [], [], 1.0)[0]:
                seen += os.read(ours, 4096)
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        while process.poll() is None and time.monotonic() < deadline:
            if select.select([ours], [], [], 0.2)[0]:
                seen += os.read(ours, 4096)
        assert process.returncode == 130, seen
    os.close(ours)
    os.close(theirs)
    summary = run_json(out)
    assert summary["interrupted"] is True
    assert 0 < summary["frames"]["total"] < 400
    assert (out / "vo.tum").exists()
    assert b"Traceback" not in seen
