"""The noise that samples show: white noise is found, motion and vibration are no noise."""

import numpy as np
import pytest
from flights import fly

from vio.filter.imu_noise import NoiseMeter, noise_words

STATED = np.repeat([3e-4, 5e-3], 3)
RATE = 200.0


def metered(rows, rate=RATE):
    meter = NoiseMeter(STATED, 0.25, 1.0 / rate)
    return meter, np.array([meter.scale(six, 1.0 / rate) for six in rows])


def white(seconds, densities, rate=RATE, seed=0):
    rng = np.random.default_rng(seed)
    return densities * np.sqrt(rate) * rng.normal(size=(int(seconds * rate), 6))


def test_noise_as_stated_changes_nothing():
    meter, scale = metered(white(30.0, STATED))
    assert scale[:, :3].max() == 1.0
    assert scale[:, 3:].max() < 1.2
    assert noise_words(meter.largest, STATED) is None
    np.testing.assert_allclose(meter.largest, STATED, rtol=0.15)


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0])
def test_white_noise_is_measured_whatever_the_rate(rate):
    true = STATED * np.array([29.0, 15.0, 6.0, 6.0, 21.0, 18.0])
    meter, scale = metered(white(20.0, true, rate), rate)
    np.testing.assert_allclose(meter.largest, true, rtol=0.2)
    late = scale[int(5 * rate) :].mean(axis=0)
    np.testing.assert_allclose(np.sqrt(late), true / STATED, rtol=0.2)
    words = noise_words(meter.largest, STATED)
    assert words is not None
    assert "gyroscope_noise_density: " in words
    said = float(words.split("gyroscope_noise_density: ")[1].split(",")[0])
    assert said == pytest.approx(true[:3].max(), rel=0.2)


def test_a_lively_flight_is_no_noise():
    rows = np.array([np.r_[s.gyro_I, s.accel_I] for s in fly("T3", 5, seconds=30.0).imu])
    meter, scale = metered(rows)
    assert scale[:, :3].max() <= 1.2
    assert noise_words(meter.largest, STATED) is None


def test_vibration_is_no_white_noise():
    """90 Hz, of which a mean over four samples lets little through; the stated noise beside it."""
    rows = white(20.0, STATED)
    t = np.arange(len(rows)) / RATE
    rows[:, 3] += 1.0 * np.sin(2.0 * np.pi * 90.0 * t)
    rows[:, 0] += 0.03 * np.sin(2.0 * np.pi * 90.0 * t)
    meter, scale = metered(rows)
    assert noise_words(meter.largest, STATED) is None
    assert scale[1000:, 0].max() < 5.0  # taken for white it were 70
    assert scale[1000:, 3].mean() > 10.0  # a share of the accelerometer's does not average out
