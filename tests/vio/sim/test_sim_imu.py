"""The IMU model term by term: each fault alone, and that it is as big as it is said to be."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import butter, group_delay
from scipy.stats import chi2
from strategies import seeds
from study_flights import t1

from vio.records import ImuNoise
from vio.sim.sensors.clocks import Clock, delays, jittered, kept
from vio.sim.sensors.imu_model import (
    ImuModel,
    LowPass,
    drawn_lay,
    low_passed,
    quantised,
    sampled,
    saturated,
    stated,
    white,
)
from vio.sim.sensors.simple_imu import bias_walk, true_rates
from vio.sim.world import course as crs
from vio.sim.world.airframe import Harmonic, Rotors, hum, vibration
from vio.sim.world.dynamics import DOWN_W, body_flight
from vio.sim.world.trajectory import t1_command

PERFECT = {
    "gyro_density": 0.0, "accel_density": 0.0, "gyro_walk": 0.0, "accel_walk": 0.0,
    "vibration": 0.0,
}  # fmt: skip
FLIGHT = body_flight(crs.followed(t1_command()))
CLOCK = Clock(1_700_000_000_123_456_789)


def samples(seed=0, seconds=4.0, **faults):
    model = ImuModel(**{**PERFECT, **faults})
    return sampled(FLIGHT, seconds, model, CLOCK, np.random.default_rng(seed))


def test_a_perfect_imu_gives_the_true_rates_of_the_older_model():
    """That one differences attitudes, and knows nothing of this one's formula."""
    track, biases = samples(seconds=20.0)
    t_s = np.arange(len(track)) / 200.0
    gyro, accel = true_rates(t1()[0], t_s, DOWN_W)
    assert_allclose(track.gyro_I, gyro, atol=1e-6)
    assert_allclose(track.accel_I, accel, atol=1e-9)
    assert_array_equal(track.t_ns, CLOCK.zero_ns + np.rint(t_s * 1e9).astype(np.int64))
    assert_array_equal(track.arrival_ns, track.t_ns)
    assert not biases.gyro.any()


def within(figure, expected_var, n, level=1e-7):
    """Whether the sum of n squares is chi-square about what is expected, two-sided."""
    low, high = chi2.ppf([level, 1.0 - level], n) / n
    return low < figure / expected_var < high


@given(seed=seeds, density=st.floats(1e-5, 1e-1), rate=st.sampled_from([200.0, 1000.0]))
@settings(max_examples=10)
def test_white_noise_integrates_to_its_density(seed, density, rate):
    """After T seconds the integral has variance density^2 T, whatever the rate."""
    x = white((round(rate * 2.0), 300), density, rate, np.random.default_rng(seed))
    integral = x.sum(axis=0) / rate
    assert within(np.mean(integral**2), density**2 * 2.0, 300)


@given(seed=seeds)
@settings(max_examples=10)
def test_a_bias_walks_as_its_density_says(seed):
    rng, walk, rate, seconds = np.random.default_rng(seed), 5e-4, 200.0, 3.0
    ends = [bias_walk(int(rate * seconds), 0.0, walk / np.sqrt(rate), rng)[-1] for _ in range(60)]
    assert within(np.mean(np.square(ends)), walk**2 * seconds, 180)
    starts = [bias_walk(2, 0.1, 0.0, rng)[0] for _ in range(60)]
    assert within(np.mean(np.square(starts)), 0.01, 180)


def test_noise_and_biases_of_a_flight_are_those_of_the_model():
    noisy, biases = samples(seconds=20.0, gyro_density=1e-3, accel_density=1e-2,
                            gyro_bias_rad_s=0.02, accel_bias_m_s2=0.3)  # fmt: skip
    clean, _ = samples(seconds=20.0)
    rest = noisy.gyro_I - clean.gyro_I - biases.gyro
    assert within(np.mean(rest**2), 1e-6 * 200.0, rest.size)
    rest = noisy.accel_I - clean.accel_I - biases.accel
    assert within(np.mean(rest**2), 1e-4 * 200.0, rest.size)
    assert 0.0 < np.abs(biases.accel[0]).max() < 1.5
    assert_allclose(biases.accel, biases.accel[:1].repeat(len(noisy), axis=0))


def test_scale_and_misalignment_are_small_turns_and_stretches():
    model = ImuModel(gyro_scale=0.01, accel_scale=0.02, misalignment_deg=0.5)
    lays = [drawn_lay(model, np.random.default_rng(k)) for k in range(200)]
    for name, scale in (("gyro", 0.01), ("accel", 0.02)):
        M = np.array([getattr(lay, name) for lay in lays])
        assert within(np.mean((M[:, range(3), range(3)] - 1.0) ** 2), scale**2, 600)
        turn = 0.5 * (M - np.swapaxes(M, -1, -2))
        assert within(np.mean(turn[:, [2, 0, 1], [1, 2, 0]] ** 2), np.radians(0.5) ** 2, 600)
    track, _ = samples(seed=4, gyro_scale=0.01, accel_scale=0.02, misalignment_deg=0.5)
    clean, _ = samples(seed=4)
    lay = drawn_lay(model, np.random.default_rng(4))
    assert_allclose(track.accel_I, clean.accel_I @ lay.accel.T, atol=1e-12)
    assert_allclose(track.gyro_I, clean.gyro_I @ lay.gyro.T, atol=1e-12)


def lag_s(low_pass, rate_hz):
    """The filter's group delay at rest [s]: how late its output is for slow motion."""
    b, a = butter(low_pass.order, low_pass.cutoff_hz, fs=rate_hz)
    return group_delay((b, a), w=[low_pass.cutoff_hz * 1e-3], fs=rate_hz)[1][0] / rate_hz


@given(cutoff=st.floats(20.0, 120.0), order=st.integers(1, 4), hz=st.floats(0.5, 4.0))
@settings(max_examples=15)
def test_the_filter_is_late_by_its_group_delay(cutoff, order, hz):
    low_pass, rate = LowPass(cutoff_hz=cutoff, order=order), 2000.0
    t = np.arange(0.0, 3.0, 1.0 / rate)
    x = np.sin(2 * np.pi * hz * t)[:, None]
    late = lag_s(low_pass, rate)
    expected = np.sin(2 * np.pi * hz * (t - late))[:, None]
    assert_allclose(low_passed(x, low_pass, rate)[2000:], expected[2000:], atol=0.02)
    assert 0.0 < late < 0.06
    assert_allclose(low_passed(np.full((50, 3), 9.81), low_pass, rate), 9.81, rtol=1e-9)


def test_the_stream_behind_a_filter_is_late_and_nothing_says_so():
    low_pass = {"cutoff_hz": 20.0, "order": 2}
    track, _ = samples(seconds=20.0, raw_hz=1000.0, low_pass=low_pass)
    clean, _ = samples(seconds=20.0)
    assert_array_equal(track.t_ns, clean.t_ns)
    late = lag_s(LowPass(**low_pass), 1000.0)
    t = np.arange(len(clean)) / 200.0
    moved = np.stack([np.interp(t - late, t, g) for g in clean.gyro_I.T], axis=-1)
    lag = np.abs(clean.gyro_I - track.gyro_I).max()
    assert lag > 0.01
    assert np.abs(moved - track.gyro_I)[20:].max() < 0.1 * lag


def waves_of(hz, order=1.0, accel=2.0, gyro=0.1, wander=0.0, spread=0.0, count=1, seed=0):
    harmonics = (Harmonic(order=order, accel_m_s2=accel, gyro_rad_s=gyro),)
    rotors = Rotors(count=count, hz=hz, spread=spread, wander=wander, harmonics=harmonics)
    return vibration(rotors, np.random.default_rng(seed))


def peak_hz(x, rate):
    power = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2
    return float(np.fft.rfftfreq(len(x), 1.0 / rate)[np.argmax(power)])


def test_vibration_folds_back_unless_it_is_filtered():
    """170 Hz sampled at 200 Hz stands at 30 Hz; behind a filter at 1 kHz nearly nothing is left."""
    waves = waves_of(170.0)
    shaking = lambda t: hum(waves, t)[:2]  # noqa: E731

    def seen(**model):
        faults = ImuModel(**{**PERFECT, "vibration": 1.0, **model})
        rng = np.random.default_rng(0)
        track, _ = sampled(FLIGHT, 2.0, faults, CLOCK, rng, shaking=shaking)
        return track.accel_I - samples(seconds=2.0)[0].accel_I

    folded = seen()
    axis = int(np.argmax(folded.std(axis=0)))
    assert peak_hz(folded[:, axis], 200.0) == pytest.approx(30.0, abs=0.6)
    assert np.sqrt((folded**2).sum(axis=1).mean()) == pytest.approx(2.0 / np.sqrt(2), rel=0.02)
    filtered = seen(raw_hz=4000.0, low_pass={"cutoff_hz": 30.0, "order": 3})
    assert np.abs(filtered)[20:].max() < 0.02


def test_rotors_share_a_harmonic_and_beat_against_each_other():
    t = np.arange(0.0, 30.0, 1e-3)
    gyro, accel, _ = hum(waves_of(80.0, order=2.0, count=6, spread=0.05, seed=2), t)
    assert np.sqrt((accel**2).sum(axis=1).mean()) == pytest.approx(2.0 / np.sqrt(2), rel=0.1)
    assert np.sqrt((gyro**2).sum(axis=1).mean()) == pytest.approx(0.1 / np.sqrt(2), rel=0.1)
    assert 152.0 < peak_hz(accel[:, 0], 1000.0) < 168.0


def test_what_the_gyro_feels_is_what_the_camera_is_shaken_by():
    waves = waves_of(90.0, wander=0.02, count=3, spread=0.02)
    t, h = np.linspace(0.0, 2.0, 301), 1e-6
    gyro, _, turn = hum(waves, t)
    slope = (hum(waves, t + h)[2] - hum(waves, t - h)[2]) / (2 * h)
    assert_allclose(slope, gyro, atol=0.03 * np.abs(gyro).max())  # wander within a turn
    assert np.abs(turn).max() < 0.1 / (2 * np.pi * 80.0) * np.sqrt(3.0)


def test_values_end_at_what_the_part_can_show_and_come_in_steps():
    assert_array_equal(saturated(np.array([-3.0, 0.5, 9.0]), 2.0), [-2.0, 0.5, 2.0])
    assert_allclose(quantised(np.array([0.12, -0.26]), 0.1), [0.1, -0.3])
    assert_array_equal(quantised(np.array([0.12]), 0.0), [0.12])
    track, _ = samples(accel_max_m_s2=9.5, gyro_lsb_rad_s=0.01)
    assert track.accel_I.max() == 9.5
    assert_allclose(track.gyro_I / 0.01, np.rint(track.gyro_I / 0.01), atol=1e-9)


def test_quantisation_is_in_what_is_stated():
    """Steps far wider than the noise: what remains has the stated density's variance."""
    model = ImuModel(**{**PERFECT, "gyro_density": 1e-6, "gyro_lsb_rad_s": 0.01})
    x = np.random.default_rng(0).normal(0.0, 1.0, 20000)
    rest = quantised(x, 0.01) - x
    assert within(np.mean(rest**2), stated(model).gyro_density ** 2 * 200.0, 20000 * 5)
    twice = stated(model.model_copy(update={"stated_factor": 2.0}))
    assert twice.gyro_density == pytest.approx(2.0 * stated(model).gyro_density)
    assert stated(ImuModel()) == ImuNoise(5e-3, 5e-4, 3e-4, 2e-5, 200.0)


@given(seed=seeds, drift=st.floats(-5e-3, 5e-3), zero=st.integers(0, 2**61))
@settings(max_examples=20)
def test_a_clock_there_and_back(seed, drift, zero):
    clock = Clock(zero, drift)
    t_s = np.sort(np.random.default_rng(seed).uniform(0.0, 1e3, 20))
    shown = clock.shows(t_s)
    assert_allclose(clock.true(shown), t_s, atol=1e-9)
    gained = (shown[-1] - shown[0]) * 1e-9 - (t_s[-1] - t_s[0])
    assert gained == pytest.approx(drift * (t_s[-1] - t_s[0]), abs=2e-9)


def test_stamps_jitter_samples_get_lost_and_arrive_late():
    track, biases = samples(
        seconds=24.0, stamp_jitter_s=2e-4, drop_share=0.1, latency_s=[0.002, 0.005]
    )
    assert len(track) == len(biases.gyro)
    nominal = CLOCK.zero_ns + np.rint(np.arange(4801) * 5e6).astype(np.int64)
    nearest = nominal[np.clip(np.rint((track.t_ns - CLOCK.zero_ns) / 5e6).astype(int), 0, 4800)]
    assert len(np.unique(nearest)) == len(track)
    assert within(np.mean(((track.t_ns - nearest) * 1e-9) ** 2), 4e-8, len(track))
    assert 0.07 < 1.0 - len(track) / 4801 < 0.13
    late = (track.arrival_ns - nearest) * 1e-9
    assert 0.002 <= late.min() < 0.0021 < 0.0049 < late.max() <= 0.005


def test_helpers_of_the_bus():
    rng = np.random.default_rng(0)
    assert_array_equal(jittered(np.arange(5), 0.0, rng), np.arange(5))
    assert kept(1000, 0.0, rng).all()
    late = delays(20000, (0.01, 0.02), 0.1, 0.5, rng)
    assert 0.05 < (late > 0.02).mean() < 0.11
    assert 0.4 < late.max() <= 0.52


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"raw_hz": 500.0}, "multiple of rate_hz"),
        ({"low_pass": {"cutoff_hz": 100.0}}, "below half of raw_hz"),
        ({"latency_s": [0.2, 0.1]}, "range"),
        ({"gyro_density": -1.0}, "greater than or equal to 0"),
        ({"noise": 1.0}, "Extra inputs"),
    ],
)
def test_impossible_parts_are_refused(keys, says):
    with pytest.raises(ValueError, match=says):
        ImuModel(**keys)
