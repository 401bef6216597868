"""IMU samples that cannot be true: dropped and counted, while real blows pass."""

from dataclasses import replace

import numpy as np
import pytest
from flights import edit_imu, fly, replay, states_between
from study_flights import PoseNoise

from vio.filter.imu_noise import NoiseMeter
from vio.filter.preprocessing import ImuIntake
from vio.records import ImuSample

NOISY = PoseNoise(white=(0.02, 0.6), slow=(0.01, 0.3), outliers=0.0, dropouts=0, stamp_s=0.0)
STEP_NS = 5_000_000
REST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
DENSITIES = np.repeat([3e-4, 5e-3], 3)


def intake():
    return ImuIntake(0.005, 34.9, 156.9, NoiseMeter(DENSITIES, 0.25, 0.005))


def sample(k, six, t_ns=None):
    t_ns = k * STEP_NS if t_ns is None else t_ns
    return ImuSample(t_ns, six[:3], six[3:], t_ns)


def resting(n, seed=0):
    rng = np.random.default_rng(seed)
    return REST + rng.normal(size=(n, 6)) * np.repeat([4e-3, 0.07], 3)


def taken(rows, stamps=None):
    """All intervals of rows (n, 6), and the intake."""
    one, out = intake(), []
    for k, six in enumerate(rows):
        out += one.take(sample(k, six, None if stamps is None else stamps[k]))[0]
    return out, one


@pytest.fixture(scope="module")
def flown():
    flight = fly("T1", 3, NOISY, seconds=11.0)
    return flight, replay(flight, every=1)


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize(("value", "count"), [(1e2, 1), (-1e2, 3), (1e30, 1), (1e9, 3)])
def test_a_spike_on_any_axis_moves_the_filter_by_nothing(flown, axis, value, count):
    flight, whole = flown

    def spoil(s):
        if not 1800 <= round(s.t_ns / STEP_NS) < 1800 + count:
            return [s]
        six = np.concatenate([s.gyro_I, s.accel_I])
        six[axis] = value
        return [replace(s, gyro_I=six[:3], accel_I=six[3:])]

    track = replay(edit_imu(flight, spoil), every=1)
    counters = track.estimator.counters
    assert counters.get("imu_beyond_range", 0) + counters.get("imu_spikes", 0) == count
    assert track.estimator.health().resets == 0
    assert states_between(track, 3.0, 10.9) == {"TRACKING"}
    late = track.t_s > 8.9
    there = np.isin(whole.t_s, track.t_s[late])
    assert np.linalg.norm(track.p[late] - whole.p[there], axis=1).max() < 0.01


def test_the_axis_holds_its_last_good_value_and_is_believed_less():
    rows = resting(300)
    rows[250, 3] = 1e20
    steps, _ = taken(rows)
    held = steps[249]  # the interval up to row 250
    assert held.t_ns == 250 * STEP_NS
    assert held.accel[0] == pytest.approx(rows[249, 3])  # the mean of it and of itself
    assert held.accel[1] == pytest.approx(0.5 * (rows[249, 4] + rows[250, 4]))
    assert steps[250].accel[0] == pytest.approx(0.5 * (rows[249, 3] + rows[251, 3]))
    for step in steps[249:251]:  # the sample after a held one still stands on it
        assert step.scale[3] >= 100.0
        assert step.scale[4] < 3.0
    assert steps[251].scale[3] < 3.0


def test_the_sample_after_a_saturated_one_is_doubted_too():
    rows = resting(300)
    rows[250:260, 0] = 34.9
    steps, one = taken(rows)
    assert one.counters["imu_saturated"] == 10
    assert one.counters.get("imu_beyond_range", 0) == 0
    assert [bool(s.scale[0] >= 100.0) for s in steps[248:262]] == [False] + 11 * [True] + 2 * [
        False
    ]


def test_a_gaps_noise_grows_with_the_square_of_its_length():
    rows, stamps = resting(300), [k * STEP_NS for k in range(200)]
    stamps += [stamps[-1] + 80_000_000 + k * STEP_NS for k in range(100)]
    steps, one = taken(rows, stamps)
    assert one.counters["imu_gap"] == 1
    inside = [s for s in steps if stamps[199] < s.t_ns <= stamps[200]]
    assert len(inside) == 8
    for step in inside:
        np.testing.assert_allclose(step.scale, 16.0**2, rtol=0.3)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_up_to_three_suspects_are_spikes(count):
    rows = resting(300)
    rows[250 : 250 + count, 3] = 100.0
    steps, one = taken(rows)
    assert one.counters["imu_spikes"] == count
    assert max(abs(s.accel[0]) for s in steps) < 1.0
    assert len(steps) == 299  # the time they took is not lost


def test_more_than_three_suspects_are_motion_and_come_late():
    rows = resting(300)
    rows[250:258, 3] = 100.0
    one, late = intake(), []
    for k, six in enumerate(rows):
        steps = one.take(sample(k, six))[0]
        late += [(k * STEP_NS - s.t_ns) for s in steps]
    assert one.counters.get("imu_spikes", 0) == 0
    assert one.counters["imu_late_suspects"] == 4
    assert max(late) == 3 * STEP_NS  # 15 ms


def landing(rows):
    rows[250:255, 5] += 30.0 * np.hanning(7)[1:-1] / np.hanning(7).max()


def take_off(rows):
    rows[250:, 5] += 6.0 * (1.0 - np.exp(-np.arange(len(rows) - 250) / 10.0))


def hand_shake(rows):
    t = np.arange(len(rows) - 250) * 0.005
    rows[250:, 0] += 9.0 * np.sin(2.0 * np.pi * 4.0 * t)
    rows[250:, 3] += 40.0 * np.sin(2.0 * np.pi * 4.0 * t)


@pytest.mark.parametrize("motion", [landing, take_off, hand_shake])
def test_real_motion_drops_nothing(motion):
    rows = resting(500)
    motion(rows)
    steps, one = taken(rows)
    assert not {"imu_spikes", "imu_beyond_range"} & set(one.counters)
    np.testing.assert_allclose(steps[251].accel, 0.5 * (rows[251, 3:] + rows[252, 3:]))


def test_an_axis_that_never_comes_back_is_a_lost_imu():
    rows = resting(500)
    rows[200:, 4] = 1e12
    one, lost = intake(), []
    for k, six in enumerate(rows):
        if one.take(sample(k, six))[1]:
            lost.append(k)
    assert lost == [400]  # after a second, once: then nothing comes at all
    assert one.counters["imu_lost"] == 1


@pytest.mark.parametrize("odd_ns", [2**63 - 1, 0, 10**18, -(2**62)])
def test_one_corrupt_stamp_restarts_nothing(odd_ns):
    rows = resting(300)
    stamps = [k * STEP_NS + 5 * 10**9 for k in range(300)]
    stamps[250] = odd_ns
    one, lost = intake(), []
    for k, six in enumerate(rows):
        lost.append(one.take(sample(k, six, stamps[k]))[1])
    assert not any(lost)
    assert one.counters["imu_stamp_jump"] == 1


@pytest.mark.parametrize("shift_ns", [-4 * 10**9, 3 * 10**9])
def test_a_clock_that_starts_anew_is_followed(shift_ns):
    rows = resting(300)
    stamps = [k * STEP_NS + 5 * 10**9 + (shift_ns if k >= 250 else 0) for k in range(300)]
    one, lost = intake(), []
    for k, six in enumerate(rows):
        if one.take(sample(k, six, stamps[k]))[1]:
            lost.append(k)
    assert lost == [251]  # the second of the new stamps confirms them


@pytest.mark.parametrize("noted", [False, True])
@pytest.mark.parametrize("ahead_ns", [150_000_000, 500_000_000, 990_000_000])
def test_a_corrupt_stamp_ahead_costs_its_own_sample_alone(ahead_ns, noted):
    """noted: whether the arrival is known besides the stamp."""
    one = intake()
    rows, steps, late = resting(300), [], 3_000_000 * noted
    for k, six in enumerate(rows):
        t_ns = k * STEP_NS
        stamp = t_ns + (ahead_ns if k == 250 else 0)
        arrival = t_ns + late if noted else stamp
        found, lost = one.take(replace(sample(k, six, stamp), arrival_ns=arrival))
        assert not lost
        steps += found
    assert one.counters["imu_stamp_jump"] == 1
    assert one.counters["imu_backward"] == 0
    assert [s.t_ns for s in steps] == [k * STEP_NS for k in range(1, 300) if k != 250]


@pytest.mark.parametrize("noted", [False, True])
def test_a_real_gap_is_bridged_with_the_next_sample_at_latest(noted):
    one, gap_ns, steps, known = intake(), 400_000_000, [], []
    for k, six in enumerate(resting(300)):
        t_ns = k * STEP_NS + (gap_ns if k >= 250 else 0)
        arrival = t_ns + 3_000_000 * noted
        found, lost = one.take(replace(sample(k, six, t_ns), arrival_ns=arrival))
        assert not lost
        known += [k] * len(found)
        steps += found
    assert one.counters["imu_gap"] == 1
    assert one.counters["imu_stamp_jump"] == 0
    assert steps[-1].t_ns == 299 * STEP_NS + gap_ns
    assert sum(s.t_ns - s.t0_ns for s in steps) == steps[-1].t_ns
    assert (250 in known) == noted  # without a word on its arrival, the next one tells
