"""`tagvio convert`: other people's logs give what our own give, and say what they lack."""

import csv
import gzip
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from cli_calls import rendered_log, tagvio
from flying_log import write_flying_log
from numpy.testing import assert_allclose, assert_array_equal
from once import once

from tagvo import geometry as geo
from tagvo.records import Frame
from vio.convert.attitude import between
from vio.convert.images import picture
from vio.convert.topics import COMPRESSED, IMAGE, ODOMETRY, Topic, choose
from vio.frames import FLIP, enu_of_ned, flu_in_enu
from vio.sources.flight_log.files import read_truth
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally

rosbags = pytest.importorskip("rosbags")
from bag_writer import Bag, bag_of  # noqa: E402

TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    return rendered_log(tmp_path_factory)


@pytest.fixture(scope="session")
def flown(rendered, tmp_path_factory):
    """The trajectory of `rendered`, byte by byte."""
    root = once(tmp_path_factory, "flown", lambda root: run(rendered, root / "out"))
    return (root / "out/vio.tum").read_bytes()


def run(log, out):
    done = tagvio("run", log, "--out", out)
    assert done.code == 0, done.err
    return (out / "vio.tum").read_bytes()


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_a_bag_flies_as_the_log_itself(rendered, flown, tmp_path, kind):
    bag = bag_of(FlightLog.open(rendered), tmp_path / ("a.bag" if kind == "ros1" else "a"), kind)
    rig = ["--map", rendered / "tagmap.yaml", "--camera", rendered / "camchain-imucam.yaml",
           "--imu-noise", rendered / "imu.yaml"]  # fmt: skip
    done = tagvio("convert", bag, "--out", tmp_path / "log", *rig)
    assert done.code == 0, done.err
    assert "image is /camera/image_raw" in done.err
    assert "truth is /vicon/drone" in done.err
    assert run(tmp_path / "log", tmp_path / "out") == flown
    again, truth = (read_truth(p / TRUTH, Tally()) for p in (tmp_path / "log", rendered))
    assert_array_equal(again.t_ns, truth.t_ns)
    assert_allclose(again.p_WI, truth.p_WI, atol=1e-9)


def test_our_own_mcap_comes_back_as_it_went(rendered, flown, tmp_path):
    done = tagvio("convert", rendered, "--out", tmp_path / "a.mcap")
    assert done.code == 0, done.err
    back = tagvio("convert", tmp_path / "a.mcap", "--out", tmp_path / "log", "--map",
                  rendered / "tagmap.yaml", "--imu-noise", rendered / "imu.yaml")  # fmt: skip
    assert back.code == 0, back.err
    assert "lacks" not in back.out
    shutil.copy(rendered / "camchain-imucam.yaml", tmp_path / "log")  # a bag has no extrinsics
    assert run(tmp_path / "log", tmp_path / "out") == flown
    again, truth = (read_truth(p / TRUTH, Tally()) for p in (tmp_path / "log", rendered))
    assert_allclose(again.v_WI, truth.v_WI, atol=1e-8)
    again = tagvio("convert", tmp_path / "a.mcap", "--out", tmp_path / "truth.tum")
    assert again.code == 0
    assert len((tmp_path / "truth.tum").read_text().splitlines()) == len(truth)


def test_tags_go_into_an_mcap_and_come_back(tmp_path):
    log = write_flying_log(tmp_path, seconds=3.0)
    assert tagvio("convert", log, "--out", tmp_path / "a.mcap").code == 0
    back = tagvio("convert", tmp_path / "a.mcap", "--out", tmp_path / "back", "--map",
                  log / "tagmap.yaml", "--camera", log / "camchain-imucam.yaml")  # fmt: skip
    assert back.code == 0, back.err
    there, again = (FlightLog.open(p, use_detections=True) for p in (log, tmp_path / "back"))
    assert_array_equal(again.frames.t_ns, there.frames.t_ns)
    assert_array_equal(again.frames.arrival_ns, there.frames.arrival_ns)
    for k in (0, 7, 20):
        a, b = (f.frames.frame(k).detections for f in (there, again))
        assert_array_equal(a.tag_id, b.tag_id)
        assert_allclose(a.corners_px, b.corners_px, atol=1e-9)


def test_a_broken_bag_is_read_as_far_as_it_goes(rendered, tmp_path):
    bag = bag_of(FlightLog.open(rendered), tmp_path / "a.bag", "ros1")
    whole = bag.read_bytes()
    head = whole.find(b"mono8", len(whole) // 2) - 200  # where an image's record begins
    bag.write_bytes(whole[:head] + b"\xff" * 210 + whole[head + 210 :])
    done = tagvio("convert", bag, "--out", tmp_path / "log")
    assert done.code == 0, done.err
    assert "warning" in done.err
    assert "a.bag" in done.err.split("warning")[1]
    read = len(list((tmp_path / "log/mav0/cam0/data").iterdir()))
    assert 5 < read < FlightLog.open(rendered).frame_count
    bag.write_bytes(whole[: len(whole) // 3])
    cut = tagvio("convert", bag, "--out", tmp_path / "cut")
    assert cut.code == 1
    assert cut.err.count("\n") == 1
    assert "a.bag" in cut.err
    assert "reindex" in cut.err


def test_unknown_types_are_left_alone_and_no_use_is_said(tmp_path):
    with Bag(tmp_path / "b", "sqlite3") as bag:
        text = bag.new("std_msgs/msg/String", data="hello")
        bag.put("/chatter", text, 10)
    done = tagvio("convert", tmp_path / "b", "--out", tmp_path / "log")
    assert done.code == 1
    assert "neither an IMU nor images" in done.err
    assert "/chatter (std_msgs/msg/String)" in done.err
    assert not (tmp_path / "log").exists()


def test_tags_of_a_bag_are_corners_of_ours(tmp_path):
    """apriltag_msgs has the library's corners: lower left first, pixel centres at a half."""
    with Bag(tmp_path / "b", "mcap") as bag:
        corners = [bag.new("apriltag_msgs/msg/Point", x=x + 0.5, y=y + 0.5)
                   for x, y in ((10, 50), (50, 50), (50, 10), (10, 10))]  # fmt: skip
        tag = bag.new("apriltag_msgs/msg/AprilTagDetection", family="tagStandard41h12", id=7,
                      hamming=1, goodness=0.0, decision_margin=55.0, homography=np.zeros(9),
                      centre=bag.new("apriltag_msgs/msg/Point", x=30.5, y=30.5),
                      corners=corners)  # fmt: skip
        array = bag.new("apriltag_msgs/msg/AprilTagDetectionArray", header=bag.head(5 * 10**9),
                        detections=[tag])  # fmt: skip
        bag.put("/detections", array, 5 * 10**9 + 7)
    done = tagvio("convert", tmp_path / "b", "--out", tmp_path / "log")
    assert done.code == 0, done.err
    (row,) = list(csv.DictReader((tmp_path / "log/mav0/cam0/detections.csv").open()))
    assert [float(row[f"{a}_{c}"]) for c in ("tl", "tr", "br", "bl") for a in "uv"] == [
        10.0, 10.0, 50.0, 10.0, 50.0, 50.0, 10.0, 50.0]  # fmt: skip
    assert (row["tag_id"], row["hamming"]) == ("7", "1")
    assert "lacks a tag map (--map), a calibration (--camera)" in done.out


def test_topics_are_guessed_as_a_person_would():
    topics = [
        Topic("/cam1/image_raw", IMAGE, 900),
        Topic("/cam0/image_raw/compressed", COMPRESSED, 900),
        Topic("/cam0/image_raw", IMAGE, 800),
        Topic("/depth/image_raw", IMAGE, 999),
        Topic("/odom", ODOMETRY, 5000),
        Topic("/vicon/uav", "geometry_msgs/msg/PoseStamped", 100),
        Topic("/mavros/imu/data", "sensor_msgs/msg/Imu", 100),
        Topic("/cam0/imu", "sensor_msgs/msg/Imu", 0),
    ]
    chosen, words = choose(topics, {}, "x.bag")
    assert {what: t.name for what, t in chosen.items()} == {
        "image": "/cam0/image_raw", "truth": "/vicon/uav", "imu": "/mavros/imu/data"}  # fmt: skip
    assert any("not /odom" in w for w in words)
    chosen, _ = choose(topics, {"truth": "none", "image": "/cam1/image_raw"}, "x.bag")
    assert chosen["image"].name == "/cam1/image_raw"
    assert "truth" not in chosen


@pytest.mark.parametrize(
    ("encoding", "channels", "order"),
    [("rgb8", 3, [0, 1, 2]), ("bgr8", 3, [2, 1, 0]), ("bgra8", 4, [2, 1, 0]), ("mono16", 2, None)],
)
def test_pictures_of_every_encoding_are_the_same_grey(encoding, channels, order):
    rng = np.random.default_rng(5)
    grey = rng.integers(0, 256, (6, 8), dtype=np.uint8)
    rows = np.zeros((6, 8 * channels + 3), dtype=np.uint8)  # a row is longer than its pixels
    pixels = rows[:, : 8 * channels].reshape(6, 8, channels)
    if order is None:
        pixels[..., 1] = grey  # the high byte comes last
    else:
        pixels[...] = 7
        pixels[..., order] = grey[..., None]
    message = type("M", (), {"encoding": encoding, "height": 6, "width": 8, "is_bigendian": 0,
                             "step": rows.shape[1], "data": rows.reshape(-1)})  # fmt: skip
    rows[:, : 8 * channels] = pixels.reshape(6, -1)
    assert_allclose(picture(message), grey, atol=1)
    message.data = message.data[:-1]
    assert picture(message) is None


def test_a_video_with_csv_files_is_a_log(rendered, tmp_path):
    cv2 = pytest.importorskip("cv2")
    frames = [e for e in FlightLog.open(rendered).events() if isinstance(e, Frame)]
    h, w = frames[0].image.shape
    film = cv2.VideoWriter(str(tmp_path / "a.avi"), cv2.VideoWriter_fourcc(*"MJPG"), 20, (w, h))
    for frame in frames:
        film.write(cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
    film.release()
    stamps = tmp_path / "stamps.csv"
    stamps.write_text("timestamp [ns]\n" + "".join(f"{f.t_ns}\n" for f in frames))
    words = ["--imu-csv", rendered / "mav0/imu0/data.csv", "--truth-csv", rendered / TRUTH]
    done = tagvio("convert", tmp_path / "a.avi", "--stamps", stamps, *words, "--out",
                  tmp_path / "log", "--map", rendered / "tagmap.yaml", "--camera",
                  rendered / "camchain-imucam.yaml")  # fmt: skip
    assert done.code == 0, done.err
    log = FlightLog.open(tmp_path / "log")
    assert_array_equal(log.frames.t_ns, [f.t_ns for f in frames])
    image = log.frames.frame(3).image
    assert np.abs(image.astype(int) - frames[3].image).mean() < 3.0  # JPEG
    assert len(log.imu) == len(FlightLog.open(rendered).imu)
    stamps.write_text("timestamp [ns]\n1\n2\n")
    done = tagvio("convert", tmp_path / "a.avi", "--stamps", stamps, "--out", tmp_path / "no")
    assert done.code == 1
    assert f"2 stamps, {tmp_path / 'a.avi'} has {len(frames)} frames" in done.err


def test_a_log_is_never_converted_over_itself(rendered, tmp_path):
    log = shutil.copytree(rendered, tmp_path / "log")
    before = sorted(p.relative_to(log) for p in log.rglob("*"))
    done = tagvio("convert", log, "--out", tmp_path / "." / "log", "--replace")
    assert done.code == 1
    assert "is what is to be converted" in done.err
    assert sorted(p.relative_to(log) for p in log.rglob("*")) == before


def test_what_is_no_log_is_said_in_one_line(tmp_path):
    junk = np.random.default_rng(1).integers(0, 256, 5000, dtype=np.uint8).tobytes()
    for name in ("x.bin", "x.ulg", "x.tlog", "x.bag", "x.mcap", "x.db3", "x.mp4", "x.txt", "x.gz"):
        (tmp_path / name).write_bytes(junk)
        done = tagvio("convert", tmp_path / name, "--out", tmp_path / "log")
        assert done.code == 1, name
        (line,) = [x for x in done.err.splitlines() if x.startswith("tagvio:")]
        assert name in line
        assert not (tmp_path / "log").exists()
    done = tagvio("convert", tmp_path / "nothing.bag", "--out", tmp_path / "log")
    assert "no such file" in done.err
    done = tagvio("convert", tmp_path, "--out", tmp_path / "log")
    assert "a folder that is no log" in done.err


def test_attitudes_between_anchors_are_those_that_the_gyro_flew():
    """A turn with a changing rate and a gyro with a bias: every anchor met, little lost between."""
    t = np.linspace(0.0, 2.0, 2001)
    rate = np.stack([np.sin(3 * t), 0.5 * np.cos(2 * t), 0.3 + 0 * t], axis=-1)
    R = [np.eye(3)]
    fine = 20  # an independent, much finer integration
    step_s = (t[1] - t[0]) / fine
    s = (np.arange(fine * (len(t) - 1)) + 0.5) * step_s
    w = np.stack([np.sin(3 * s), 0.5 * np.cos(2 * s), 0.3 + 0 * s], axis=-1)
    for turn in geo.exp(w * step_s):
        R.append(R[-1] @ turn)
    q = geo.quat_from_matrix(np.stack(R[::fine]))
    ns = np.rint(t * 1e9).astype(np.int64)
    anchors, bias = np.arange(0, 2001, 40), np.array([0.01, -0.02, 0.01])
    anchors = anchors[1:-1]
    got = between(ns, ns[anchors], q[anchors], ns, rate + bias)
    off = geo.angle(np.swapaxes(geo.matrix_from_quat(q), -1, -2) @ geo.matrix_from_quat(got))
    between_them = off[anchors[0] : anchors[-1] + 1]
    assert between_them.max() < 2e-5
    assert off[anchors].max() < 1e-9
    assert_array_equal(got[:3], np.broadcast_to(got[anchors[0]], (3, 4)))  # outside it stays


def test_north_east_down_becomes_east_north_up():
    rng = np.random.default_rng(2)
    q = rng.standard_normal((50, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    M = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    want = M @ geo.matrix_from_quat(q) @ np.diag(FLIP)
    assert_allclose(geo.matrix_from_quat(flu_in_enu(q)), want, atol=1e-12)
    assert_allclose(enu_of_ned(np.array([1.0, 2.0, 3.0])), [2.0, 1.0, -3.0])


# the autopilots' own logs


@pytest.fixture(scope="module")
def flights():
    root = os.environ.get("TAGVIO_DATA")
    if not root:
        pytest.skip("TAGVIO_DATA is not set: no autopilot's log here")
    return Path(root) / "autopilot_flights"


def table(path, *columns):
    """Stamps and named groups of columns of a CSV file: (name, type, width)..."""
    kinds = [("t", "i8"), *columns]
    return np.loadtxt(path, delimiter=",", skiprows=1, dtype=kinds)


IMU = (("gyro", "f8", 3), ("accel", "f8", 3))
POSE = (("p", "f8", 3), ("q", "f8", 4), ("v", "f8", 3))


def within(want, got, end_ns):
    """Both up to a moment, of the second only rows that the first has."""
    want = want[want["t"] < end_ns]
    return want, got[np.isin(got["t"], want["t"])]


def converted(flights, name, ending, out, tmp_path):
    packed = flights / name / f"{name}.{ending}.gz"
    with gzip.open(packed) as source:
        whole = source.read()
    part = whole[: len(whole) // 3] if ending == "BIN" else whole  # pymavlink takes its time
    (tmp_path / f"f.{ending}").write_bytes(part)
    link = flights / name / f"{name}.tlog"
    done = tagvio("convert", tmp_path / f"f.{ending}", link, "--out", out, "--shift", "2.4,3.4,0")
    assert done.code == 0, done.err
    assert "lacks a tag map (--map), a calibration (--camera), frames" in done.out


@pytest.mark.parametrize(
    ("name", "ending", "turn"),
    [("arducopter_flight", "BIN", 2e-6), ("px4_flight", "ulg", 2e-7)],
)
def test_an_autopilots_own_log_gives_what_lies_beside_it(flights, tmp_path, name, ending, turn):
    out, beside = tmp_path / "log", flights / name
    converted(flights, name, ending, out, tmp_path)
    more = (("arrival", "i8"), ("mean", "i8"))

    want = table(beside / "mav0/imu0/data.csv", *IMU)
    got = table(out / "mav0/imu0/data.csv", *IMU, *more)
    end_ns = got["t"][-20]  # where a file was cut, its last rows are not whole
    want, got = within(want, got, end_ns)
    assert len(want) > 29_000
    assert_array_equal(got["t"], want["t"])  # as uneven as they are
    assert_allclose(got["gyro"], want["gyro"], atol=5.1e-7)
    assert_allclose(got["accel"], want["accel"], atol=5.1e-6)

    want, got = table(beside / TRUTH, *POSE), table(out / TRUTH, *POSE)
    want, got = within(want, got, min(end_ns, got["t"][-20]))
    assert_array_equal(got["t"], want["t"])
    assert_allclose(got["p"], want["p"], atol=5.1e-6)
    assert_allclose(got["v"], want["v"], atol=5.1e-6)
    R, R_there = (geo.matrix_from_quat(x["q"]) for x in (got, want))
    assert geo.angle(np.swapaxes(R, -1, -2) @ R_there).max() < turn

    want = table(beside / "mav0/imu_mavlink/data.csv", *IMU, ("arrival", "i8"))
    got = table(out / "mav0/imu_mavlink/data.csv", *IMU, *more)
    got = got[np.isin(got["t"], want["t"])]
    assert_array_equal(got["t"], want["t"])
    assert_array_equal(got["arrival"], want["arrival"])
    assert_allclose(got["gyro"], want["gyro"], atol=5.1e-7)
    assert_allclose(got["accel"], want["accel"], atol=5.1e-6)


def test_a_ulog_without_an_imu_says_what_it_has(flights, tmp_path):
    from pyulog import ULog

    with gzip.open(flights / "px4_flight" / "px4_flight.ulg.gz") as source:
        (tmp_path / "whole.ulg").write_bytes(source.read())
    ULog(str(tmp_path / "whole.ulg"), ["vehicle_attitude_groundtruth"]).write_ulog(
        str(tmp_path / "part.ulg")
    )
    done = tagvio("convert", tmp_path / "part.ulg", "--out", tmp_path / "log")
    assert done.code == 1
    (line,) = done.err.splitlines()
    assert "no sensor_combined in it; it has vehicle_attitude_groundtruth" in line
