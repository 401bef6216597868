"""Flight logs: order of arrival, options, and copies of a clean log with one fault each."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from small_log import (
    DETECTIONS_HEADER,
    FRAME_STAMPS,
    FRAMES_HEADER,
    IMU_HEADER,
    IMU_STAMPS,
    IMU_START,
    N_FRAMES,
    N_IMU,
    T0,
    corner_cells,
    imu_row,
    write_log,
)

from tagvo.errors import CameraError, MapError, TagvoError
from tagvo.records import Frame
from vio.errors import LogError, VioError
from vio.records import ImuSample
from vio.sources.flight_log.log import FlightLog

CAM, IMU = "mav0/cam0", "mav0/imu0"


def frames_of(log: FlightLog) -> list[Frame]:
    return [e for e in log.events() if isinstance(e, Frame)]


def edit(path: Path, change: Callable[[str], str]) -> None:
    path.write_text(change(path.read_text()))


def without_line(number: int) -> Callable[[str], str]:
    return lambda text: "".join(line for i, line in enumerate(text.splitlines(True)) if i != number)


def test_a_clean_log_is_read_whole(tmp_path: Path) -> None:
    log = FlightLog.open(write_log(tmp_path))
    events = list(log.events())
    frames = [e for e in events if isinstance(e, Frame)]
    samples = [e for e in events if isinstance(e, ImuSample)]
    assert [f.t_ns for f in frames] == FRAME_STAMPS
    assert [s.t_ns for s in samples] == IMU_STAMPS
    assert (log.frame_count, log.imu_count) == (N_FRAMES, N_IMU)
    assert log.t0_ns == IMU_START
    for i, frame in enumerate(frames):
        assert frame.image is not None
        assert frame.image.dtype == np.uint8
        assert (frame.image == i).all()
        assert frame.detections is None
    assert log.truth is not None
    assert log.truth.v_WI is not None
    assert [p.name for p in log.phases] == ["all", "leg"]
    assert log.imu_noise is not None
    assert log.config_path is None
    assert log.camera.timeshift_s == 0.001
    assert len(log.tag_map) == 2
    assert log.counters == {"frame_before_imu": 1}


def test_events_come_in_order_of_arrival_imu_first(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    names = "".join(f"{t},{t}.png,{t + 1}\n" for t in FRAME_STAMPS)  # then as an IMU stamp
    (path / CAM / "data.csv").write_text("#timestamp [ns],filename,arrival_ns\n" + names)
    events = list(FlightLog.open(path).events())
    known = [(e.arrival_ns, isinstance(e, Frame)) for e in events]
    assert known == sorted(known)
    ties = [i for i, (t, is_frame) in enumerate(known) if is_frame and t in IMU_STAMPS]
    assert len(ties) == 19
    assert all(known[i - 1] == (known[i][0], False) for i in ties)


def test_latency_counts_from_the_stamp(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    log = FlightLog.open(path, latency_s=0.055)
    assert [f.arrival_ns for f in frames_of(log)] == [t + 55_000_000 for t in FRAME_STAMPS]
    last = list(log.events())[-1]
    assert isinstance(last, ImuSample)
    late = FlightLog.open(path, latency_s=3.0)
    assert [isinstance(e, Frame) for e in late.events()] == [False] * N_IMU + [True] * N_FRAMES


def test_late_imu_samples_come_late(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    rows = [
        imu_row(i).strip() + f",{t + 30_000_000 * (i == 4)}\n" for i, t in enumerate(IMU_STAMPS)
    ]
    header = IMU_HEADER.strip() + ",arrival_ns\n"
    (path / IMU / "data.csv").write_text(header + "".join(rows))
    samples = [e.t_ns for e in FlightLog.open(path).events() if isinstance(e, ImuSample)]
    assert samples[:8] == [IMU_STAMPS[i] for i in (0, 1, 2, 3, 5, 6, 4, 7)]


def test_detections_stand_in_where_there_is_no_image(tmp_path: Path) -> None:
    path = write_log(tmp_path, detections=True)
    for i in (2, 5):
        (path / CAM / "data" / f"{FRAME_STAMPS[i]}.png").unlink()
    frames = frames_of(FlightLog.open(path))
    assert len(frames) == N_FRAMES
    assert [i for i, f in enumerate(frames) if f.image is None] == [2, 5]
    seen = frames[2].detections
    assert seen is not None
    assert seen.tag_id.tolist() == [3, 7, 99]
    assert_allclose(seen.corners_px[1, 0], [10.27, 10.27])
    nothing = frames[5].detections
    assert nothing is not None
    assert len(nothing) == 0


def test_detections_are_used_when_asked_for(tmp_path: Path) -> None:
    path = write_log(tmp_path, detections=True)
    frames = frames_of(FlightLog.open(path, use_detections=True))
    assert [len(f.detections) if f.detections else 0 for f in frames].count(3) == N_FRAMES - 1
    assert all(f.image is None for f in frames)
    (path / CAM / "detections.csv").unlink()
    with pytest.raises(LogError, match="--detections needs one"):
        FlightLog.open(path, use_detections=True)


def test_detections_carry_their_own_arrival(tmp_path: Path) -> None:
    path = write_log(tmp_path, images=False)
    header = DETECTIONS_HEADER.strip() + ",arrival_ns\n"
    rows = [f"{FRAME_STAMPS[1]},{i},{corner_cells(1, i)},{T0 + 900 + i}\n" for i in (3, 7)]
    (path / CAM / "detections.csv").write_text(header + "".join(rows))
    arrivals = {f.t_ns: f.arrival_ns for f in frames_of(FlightLog.open(path))}
    assert arrivals[FRAME_STAMPS[1]] == T0 + 907
    assert arrivals[FRAME_STAMPS[2]] == FRAME_STAMPS[2]


def test_without_data_csv_the_detections_list_the_frames(tmp_path: Path) -> None:
    path = write_log(tmp_path, images=False, detections=True)
    (path / CAM / "data.csv").unlink()
    log = FlightLog.open(path)
    assert [f.t_ns for f in frames_of(log)] == [t for i, t in enumerate(FRAME_STAMPS) if i != 5]
    assert any("no data.csv" in w for w in log.warnings)


def test_detections_of_no_frame_are_counted(tmp_path: Path) -> None:
    path = write_log(tmp_path, images=False, detections=True)
    edit(path / CAM / "data.csv", without_line(4))
    log = FlightLog.open(path)
    assert len(frames_of(log)) == N_FRAMES - 1
    assert log.counters["detections_no_frame"] == 3


def test_only_tags_shrinks_map_and_detections(tmp_path: Path) -> None:
    path = write_log(tmp_path, images=False, detections=True)
    log = FlightLog.open(path, only_tags=[7, 7])
    assert log.tag_map.tag_id.tolist() == [7]
    assert {int(t) for f in frames_of(log) if f.detections for t in f.detections.tag_id} == {7}
    with pytest.raises(MapError, match="no tag 99"):
        FlightLog.open(path, only_tags=[7, 99])
    with pytest.raises(LogError, match="at least one tag id"):
        FlightLog.open(path, only_tags=[])


def test_every_takes_each_nth_frame(tmp_path: Path) -> None:
    log = FlightLog.open(write_log(tmp_path), every=3)
    assert [f.t_ns for f in frames_of(log)] == FRAME_STAMPS[::3]
    assert log.frame_count == 7


@pytest.mark.parametrize("imu", [True, False])
def test_blackout_counts_from_the_first_imu_sample_or_frame(tmp_path: Path, imu: bool) -> None:
    path = write_log(tmp_path, imu=imu)
    log = FlightLog.open(path, blackout=(1.0, 0.3))
    t0 = IMU_START if imu else T0
    assert log.t0_ns == t0
    kept = [t for t in FRAME_STAMPS if (t - t0) % 1_000_000_000 >= 300_000_000]
    assert [f.t_ns for f in frames_of(log)] == kept
    assert log.counters["frame_blackout"] == N_FRAMES - len(kept) == 6
    assert log.frame_count == len(kept)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"every": 0}, "--every: 0"),
        ({"latency_s": -0.1}, "--latency: -0.1"),
        ({"latency_s": float("nan")}, "--latency: nan"),
        ({"blackout": (0.0, 0.0)}, "--blackout"),
        ({"blackout": (1.0, 2.0)}, "--blackout: 1.0,2.0"),
        ({"blackout": (float("inf"), 2.0)}, "--blackout"),
        ({"imu": "imu_mavlink"}, "no IMU 'imu_mavlink' (mav0/imu_mavlink/data.csv); it has imu0"),
    ],
)
def test_options_out_of_range_are_refused(tmp_path: Path, options, said: str) -> None:
    with pytest.raises(LogError) as caught:
        FlightLog.open(write_log(tmp_path), **options)
    assert said in str(caught.value)


def test_another_imu_is_taken_by_name(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    shutil.copytree(path / IMU, path / "mav0/imu_mavlink")
    edit(path / "mav0/imu_mavlink/data.csv", without_line(1))
    assert FlightLog.open(path, imu="imu_mavlink").imu_count == N_IMU - 1
    shutil.rmtree(path / IMU)
    log = FlightLog.open(path)
    assert log.imu is None
    assert any("--imu takes imu_mavlink" in w for w in log.warnings)


def test_without_imu_truth_and_phases_it_is_a_log(tmp_path: Path) -> None:
    path = write_log(tmp_path, imu=False)
    shutil.rmtree(path / "mav0/state_groundtruth_estimate0")
    (path / "phases.csv").unlink()
    (path / "config.yaml").write_text("tagvo: {}\n")
    log = FlightLog.open(path)
    assert (log.imu, log.imu_noise, log.truth, log.phases) == (None, None, None, ())
    assert log.config_path == path / "config.yaml"
    assert log.t0_ns == T0
    assert log.counters == {}
    assert log.warnings == []


def test_sensor_yaml_stands_in_for_the_camchain(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    (path / "camchain-imucam.yaml").unlink()
    (path / CAM / "sensor.yaml").write_text(
        "T_BS: {data: [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}\nresolution: [64, 48]\n"
        "intrinsics: [60, 60, 31.5, 23.5]\ndistortion_model: radial-tangential\n"
        "distortion_coefficients: [0, 0, 0, 0]\n"
    )
    log = FlightLog.open(path)
    assert len(frames_of(log)) == N_FRAMES
    assert any("no T_cam_imu?" in w for w in log.warnings)


def bad_images(path: Path) -> None:
    files = sorted((path / CAM / "data").iterdir())
    files[1].write_bytes(b"")
    files[3].write_bytes(files[3].read_bytes()[:40])
    files[4].write_bytes(b"no picture")
    files[6].unlink()
    files[6].mkdir()


def small_image(path: Path) -> None:
    import cv2

    cv2.imwrite(str(sorted((path / CAM / "data").iterdir())[2]), np.zeros((24, 32), np.uint8))


def truncate(file: str, n: int) -> Callable[[Path], None]:
    return lambda path: (path / file).write_bytes((path / file).read_bytes()[:-n])


def insert(file: str, line: int, text: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        lines = (path / file).read_text().splitlines(True)
        (path / file).write_text("".join([*lines[:line], text, *lines[line:]]))

    return change


FRAME_CSV, IMU_CSV = f"{CAM}/data.csv", f"{IMU}/data.csv"
FAULTS = [
    (bad_images, {"image_unreadable": 3, "image_missing": 1}, -4, 0),
    (small_image, {"image_size": 1}, -1, 0),
    (truncate(FRAME_CSV, 30), {"frames_truncated": 1}, -1, 0),
    (truncate(IMU_CSV, 25), {"imu_truncated": 1}, 0, -1),
    (
        insert(FRAME_CSV, 4, f"{FRAME_STAMPS[2]},x.png\n"),
        {"frames_repeated_stamp": 1},
        0,
        0,
    ),
    (
        insert(FRAME_CSV, 9, f"{T0 + 5},{T0}.png\n"),
        {"frames_backward_stamp": 1, "frame_before_imu": 2},
        1,
        0,
    ),
    (
        insert(FRAME_CSV, 9, "nan,2.png\n7\n"),
        {"frames_not_a_whole_number": 1, "frames_too_few_columns": 1},
        0,
        0,
    ),
    (
        insert(FRAME_CSV, 9, f"{T0 + 150_000_000},\n"),
        {"frames_backward_stamp": 1, "image_missing": 1},
        0,
        0,
    ),
    (insert(IMU_CSV, 9, f"{IMU_START},0,0,0,0,0,nan\n"), {"imu_not_finite": 1}, 0, 0),
]


@pytest.mark.parametrize(("fault", "counted", "frames", "samples"), FAULTS)
def test_a_fault_is_counted_and_survived(tmp_path, fault, counted, frames, samples) -> None:
    path = write_log(tmp_path)
    fault(path)
    log = FlightLog.open(path)
    events = list(log.events())
    assert log.counters == {"frame_before_imu": 1} | counted
    assert sum(isinstance(e, Frame) for e in events) == N_FRAMES + frames
    assert sum(isinstance(e, ImuSample) for e in events) == N_IMU + samples
    assert len(log.warnings) == len(log.counters)


def test_clocks_that_share_nothing_are_warned_of(tmp_path: Path) -> None:
    path = write_log(tmp_path)
    edit(path / FRAME_CSV, lambda text: text.replace("\n1403", "\n1503"))
    warnings = FlightLog.open(path).warnings
    assert any("truth and frames do not overlap" in w for w in warnings)
    assert any("are the clocks the same" in w for w in warnings)


def swap(a: str, b: str) -> Callable[[Path], None]:
    def change(path: Path) -> None:
        first, second = (path / a).read_bytes(), (path / b).read_bytes()
        (path / a).write_bytes(second)
        (path / b).write_bytes(first)

    return change


def no_frame_left(path: Path) -> None:
    shutil.rmtree(path / CAM / "data")
    (path / CAM / "detections.csv").unlink()


TRUTH_CSV = "mav0/state_groundtruth_estimate0/data.csv"
DETECTIONS_CSV = f"{CAM}/detections.csv"
REFUSED = [
    (lambda p: shutil.rmtree(p), "no such folder; a flight log needs tagmap.yaml"),
    (lambda p: shutil.rmtree(p / "mav0"), "no mav0/cam0/data.csv; a flight log needs"),
    (lambda p: shutil.rmtree(p / CAM), "no mav0/cam0/data.csv; a flight log needs"),
    (lambda p: (p / "tagmap.yaml").unlink(), "no tagmap.yaml; a flight log needs"),
    (lambda p: (p / "camchain-imucam.yaml").unlink(), "no camchain-imucam.yaml; a flight log"),
    (lambda p: (p / "tagmap.yaml").write_text(""), "the file is empty; a mapping"),
    (lambda p: (p / "camchain-imucam.yaml").write_text("x"), "a mapping `key: value` is needed"),
    (lambda p: (p / IMU_CSV).write_text(""), "the file is empty; timestamp [ns], gyro"),
    (lambda p: (p / FRAME_CSV).write_text(FRAMES_HEADER), "no valid row"),
    (lambda p: (p / DETECTIONS_CSV).write_text(DETECTIONS_HEADER), "no valid row"),
    (lambda p: (p / DETECTIONS_CSV).write_text("hello\n"), "no column"),
    (lambda p: (p / "imu.yaml").write_text("update_rate: 1\n"), "accelerometer_noise_density"),
    (lambda p: (p / IMU_CSV).write_bytes(b"\x89PNG\r\n\x1a\n\x00"), "no column"),
    (swap(IMU_CSV, TRUTH_CSV), "no column gyro_x"),
    (swap(IMU_CSV, FRAME_CSV), "no column gyro_x"),
    (swap(FRAME_CSV, DETECTIONS_CSV), "no column"),
    (swap("imu.yaml", "camchain-imucam.yaml"), "no `cam0`"),
    (no_frame_left, "none of 20 images"),
]  # fmt: skip


@pytest.mark.parametrize(("fault", "said"), REFUSED)
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, fault, said: str) -> None:
    path = write_log(tmp_path, detections=True)
    fault(path)
    with pytest.raises((LogError, MapError, CameraError)) as caught:
        FlightLog.open(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_is_no_log(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("")
    with pytest.raises(LogError, match="is a file; a flight log needs"):
        FlightLog.open(path)


def test_reading_twice_gives_the_same(tmp_path: Path) -> None:
    log = FlightLog.open(write_log(tmp_path, detections=True), use_detections=True)
    first, second = list(log.events()), list(log.events())
    assert [type(e) for e in first] == [type(e) for e in second]
    for a, b in zip(frames_of(log), frames_of(log), strict=True):
        assert a.detections is not None
        assert b.detections is not None
        assert_array_equal(a.detections.corners_px, b.detections.corners_px)


FILES = (
    FRAME_CSV, DETECTIONS_CSV, IMU_CSV, TRUTH_CSV, "phases.csv", "imu.yaml", "tagmap.yaml",
    "camchain-imucam.yaml",
)  # fmt: skip


@settings(max_examples=120, deadline=None)
@given(st.sampled_from(FILES), st.integers(0, 3000), st.integers(0, 4), st.binary(max_size=4))
def test_a_damaged_file_never_gives_a_traceback(pristine: Path, file, at, cut, put) -> None:
    whole = (pristine / file).read_bytes()
    at %= len(whole)
    (pristine / file).write_bytes(whole[:at] + put + whole[at + cut :])
    try:
        log = FlightLog.open(pristine, use_detections=True)
        events = list(log.events())
    except (TagvoError, VioError) as error:
        said, events = str(error), []
    else:
        said = ""
        assert sum(isinstance(e, Frame) for e in events) == log.frame_count
        assert sum(isinstance(e, ImuSample) for e in events) == log.imu_count
    finally:
        (pristine / file).write_bytes(whole)
    assert "\n" not in said


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_log(tmp_path_factory.mktemp("pristine"), images=False, detections=True)
