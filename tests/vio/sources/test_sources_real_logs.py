"""Every real log there is, read whole: row counts of the files, nothing skipped, stamps kept."""

import os
from pathlib import Path

import numpy as np
import pytest

from tagvo.records import Frame
from vio.sources.flight_log.files import (
    read_detections,
    read_imu,
    read_imu_noise,
    read_phases,
    read_truth,
)
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally


@pytest.fixture(scope="module")
def data() -> Path:
    root = os.environ.get("TAGVIO_DATA")
    if not root:
        pytest.skip("TAGVIO_DATA is not set: no real logs here")
    return Path(root)


def rows_of(path: Path) -> list[list[str]]:
    lines = [line for line in path.read_text().splitlines() if line.strip()]
    return [line.split(",") for line in lines[1:]]


@pytest.mark.parametrize(
    ("name", "frames", "samples", "tags"),
    [
        ("euroc_imu_april", 801, 8000, 36),
        ("tagslam_aviary", 680, 0, 96),
        ("tagslam_line5", 297, 0, 5),
    ],
)
def test_a_whole_log(data: Path, name: str, frames: int, samples: int, tags: int) -> None:
    log = FlightLog.open(data / name)
    events = list(log.events())
    seen = [e for e in events if isinstance(e, Frame)]
    assert (len(seen), len(events) - len(seen)) == (frames, samples)
    assert (log.frame_count, log.imu_count, len(log.tag_map)) == (frames, samples, tags)
    stamps = [int(row[0]) for row in rows_of(data / name / "mav0/cam0/data.csv")]
    assert [f.t_ns for f in seen] == stamps
    detected = sum(len(f.detections) for f in seen if f.detections is not None)
    assert detected == len(rows_of(data / name / "mav0/cam0/detections.csv"))
    assert set(log.counters) <= {"frame_before_imu"}
    assert log.truth is not None


def test_each_imu_file(data: Path) -> None:
    files = sorted(data.rglob("imu*/data.csv"))
    assert len(files) == 6
    for path in files:
        tally = Tally()
        track = read_imu(path, tally)
        rows = rows_of(path)
        assert track.t_ns.tolist() == [int(row[0]) for row in rows]
        assert track.gyro_I[-1].tolist() == [float(x) for x in rows[-1][1:4]]
        assert track.accel_I[-1].tolist() == [float(x) for x in rows[-1][4:7]]
        assert np.array_equal(track.arrival_ns, track.t_ns)  # `arrival [ns]` is another clock's
        assert tally.counters == {}


def test_each_truth_file(data: Path) -> None:
    files = sorted(data.rglob("state_groundtruth_estimate0/data.csv"))
    assert len(files) == 6
    for path in files:
        tally = Tally()
        truth = read_truth(path, tally)
        rows = rows_of(path)
        assert truth.t_ns.tolist() == [int(row[0]) for row in rows]
        assert truth.p_WI[-1].tolist() == [float(x) for x in rows[-1][1:4]]
        np.testing.assert_allclose(truth.q_WI[-1], [float(x) for x in rows[-1][4:8]], atol=1e-3)
        assert (truth.v_WI is not None) == (len(rows[0]) > 8)
        assert (truth.b_a is not None) == (len(rows[0]) > 11)
        assert tally.counters == {}


def test_the_rest(data: Path) -> None:
    for path in sorted(data.rglob("phases.csv")):
        assert len(read_phases(path, Tally())) == len(rows_of(path))
    for path in sorted(data.rglob("imu.yaml")):
        assert read_imu_noise(path).gyro_density > 0
    mocap = data / "mocap_aprilgrid"
    assert len(read_detections(mocap / "detections.csv", Tally())) == 492
    body = read_truth(mocap / "mocap_body0.csv", Tally())
    last = [float(x) for x in rows_of(mocap / "mocap_body0.csv")[-1]]
    np.testing.assert_allclose(body.q_WI[-1], [last[7], *last[4:7]], atol=1e-5)  # xyzw there
