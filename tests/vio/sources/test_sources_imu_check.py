"""An IMU file in the wrong unit or clock is named as such."""

import numpy as np
import pytest
from flights import fly

from vio.errors import LogError
from vio.records import ImuTrack
from vio.sources.imu_check import check_imu

FRAMES = np.arange(10) * 50_000_000


def track(gyro=1.0, accel=1.0, shift=0):
    samples = fly("T3", 0, seconds=4.0).imu
    t = np.array([s.t_ns + shift for s in samples])
    w = np.array([s.gyro_I * gyro for s in samples])
    return ImuTrack(t, w, np.array([s.accel_I * accel for s in samples]), t)


def test_a_sound_track_passes():
    assert check_imu(track(), FRAMES, "imu0") == []
    assert check_imu(track(), FRAMES[:0], "imu0") == []


def test_units_that_are_not_ours_are_refused():
    spinning = track(gyro=0.0)
    spinning.gyro_I[:] = np.degrees([0.2, 0.1, 0.3])
    with pytest.raises(LogError, match="deg/s"):
        check_imu(spinning, FRAMES, "imu0")
    with pytest.raises(LogError, match="in g"):
        check_imu(track(accel=1.0 / 9.81), FRAMES, "imu0")


@pytest.mark.parametrize("scale", [0.93, 1.07])
def test_gravity_off_by_more_than_five_percent_is_a_warning(scale):
    [text] = check_imu(track(accel=scale), FRAMES, "imu0")
    assert "5 %" in text
    assert check_imu(track(accel=1.0 + 0.4 * (scale - 1.0)), FRAMES, "imu0") == []


def test_clocks_that_do_not_overlap_are_refused():
    with pytest.raises(LogError, match="overlap"):
        check_imu(track(shift=10**18), FRAMES, "imu0")


def test_too_few_rows_are_a_warning_since_visual_odometry_needs_none():
    short = track()
    short.accel_I[:-5] = np.nan
    (warning,) = check_imu(short, FRAMES, "imu0")
    assert "5 valid" in warning
