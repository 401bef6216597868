"""Files of another layout are refused with the word that mends them."""

import numpy as np
import pytest
from small_log import write_log

from vio.errors import LogError
from vio.records import ImuTrack
from vio.sources.flight_log.log import FlightLog
from vio.sources.imu_check import check_imu

IMU = "mav0/imu0/data.csv"


def edited(tmp_path, change):
    log = write_log(tmp_path)
    path = log / IMU
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([head, *map(change, rows)]) + "\n")
    return log


def test_stamps_in_seconds_are_named_with_line_and_column(tmp_path):
    log = edited(tmp_path, lambda r: f"{int(r.split(',')[0]) / 1e9:.9f},{r.split(',', 1)[1]}")
    with pytest.raises(LogError, match=r"line 2 column 1: \d+\.\d+ is no whole number: seconds"):
        FlightLog.open(log)


def test_semicolons_are_named(tmp_path):
    log = write_log(tmp_path)
    path = log / IMU
    path.write_text(path.read_text().replace(",", ";"))
    with pytest.raises(LogError, match="separator ; found, a comma is needed"):
        FlightLog.open(log)


def test_exchanged_gyro_and_accelerometer_are_named():
    n, rng = 100, np.random.default_rng(0)
    gyro, accel = 0.2 * rng.standard_normal((n, 3)), np.tile([0.1, 0.2, 9.8], (n, 1))
    t_ns = np.arange(n) * 5_000_000
    assert check_imu(ImuTrack(t_ns, gyro, accel, t_ns), t_ns[:0], "w") == []
    with pytest.raises(LogError, match="do the accelerometer's columns stand first"):
        check_imu(ImuTrack(t_ns, accel, gyro, t_ns), t_ns[:0], "w")


def test_what_cannot_be_is_counted(tmp_path):
    log = edited(tmp_path, lambda r: f"{r},-5")
    path = log / IMU
    path.write_text(path.read_text().replace("a_z [m s^-2]", "a_z [m s^-2],arrival_ns", 1))
    truth = log / "mav0/state_groundtruth_estimate0/data.csv"
    head, first, *rows = truth.read_text().splitlines()
    cells = first.split(",")
    truth.write_text("\n".join([head, ",".join([cells[0], "1e8", *cells[2:]]), *rows]) + "\n")
    counters = FlightLog.open(log).counters
    assert counters["imu_arrival_before_stamp"] == 200
    assert counters["truth_far"] == 1
    clean = FlightLog.open(write_log(tmp_path / "clean")).counters
    assert not {"imu_arrival_before_stamp", "frame_arrival_before_capture", "truth_far"} & set(
        clean
    )
