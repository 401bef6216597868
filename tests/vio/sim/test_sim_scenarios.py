"""What goes wrong in flight, as edits of a simulated one: the output and the health asserted."""

from dataclasses import replace

import numpy as np
import pytest
from flights import (
    CAMERA,
    CLEAN,
    edit_imu,
    edit_poses,
    events,
    feed,
    fly,
    reasons_between,
    replay,
    rms,
    states_between,
    without,
)
from numpy.testing import assert_allclose
from study_flights import PoseNoise, circle

from tagvo import geometry as geo
from vio.config.filter import VioConfig
from vio.filter.eskf import ErrorStateFilter
from vio.sim.sensors.simple_imu import PIXHAWK

NOISY = PoseNoise(white=(0.02, 0.6), slow=(0.01, 0.3), outliers=0.0, dropouts=0, stamp_s=0.0)


def late(track, t=4.0):
    return track.p[track.t_s > t]


def test_fifteen_percent_of_outliers():
    track = replay(fly("T3", 0, replace(NOISY, outliers=0.15), seconds=25.0))
    assert rms(late(track)) < 0.06
    assert states_between(track, 3.0, 24.0) == {"TRACKING"}
    assert track.estimator.counters["gated"] > 30
    assert track.estimator.counters.get("resets", 0) == 0


def test_a_kidnap_is_recovered_in_a_second():
    jump = np.array([1.5, 0.0, 0.0])
    flown = fly("T3", 1, NOISY, seconds=20.0)
    moved = edit_poses(flown, lambda p: replace(p, p_WC=p.p_WC + jump) if p.t_ns > 12e9 else p)
    track = replay(moved)
    p = track.p + np.where(track.t_s > 12.0, -1.0, 0.0)[:, None] * jump
    assert np.linalg.norm(p[track.t_s > 13.0], axis=1).max() < 0.3
    assert "RELOCATING" in states_between(track, 12.2, 13.0)
    assert states_between(track, 14.0, 19.9) == {"TRACKING"}
    assert track.estimator.counters["resets"] == 1
    assert track.estimator.health().resets == 1


def test_three_seconds_blind_then_relock():
    track = replay(without(fly("T3", 2, NOISY, seconds=20.0), 10.0, 13.0))
    assert states_between(track, 10.6, 12.9) == {"COASTING"}
    assert states_between(track, 13.3, 19.0) == {"TRACKING"}
    assert reasons_between(track, 10.6, 12.9) == {"no_pose"}
    blind = (track.t_s > 10.0) & (track.t_s < 13.05)
    assert np.linalg.norm(track.p[blind], axis=1).max() < 0.5
    assert track.nees[blind].mean() < 3.0
    assert rms(track.p[track.t_s > 13.5]) < 0.06
    assert track.estimator.counters.get("resets", 0) == 0


def test_blind_for_long_is_lost_and_comes_back():
    track = replay(without(fly("T3", 3, NOISY, seconds=30.0), 8.0, 20.0))
    assert "LOST" in states_between(track, 14.0, 20.0)
    assert "TRACKING" not in states_between(track, 9.0, 20.0)
    assert states_between(track, 22.0, 29.9) == {"TRACKING"}
    assert rms(track.p[track.t_s > 22.0]) < 0.08


@pytest.mark.parametrize(("length", "reasons"), [(0.1, set()), (0.5, {"imu_gap"})])
def test_a_gap_of_the_imu_is_bridged(length, reasons):
    flown = fly("T3", 4, NOISY, seconds=14.0)
    cut = edit_imu(flown, lambda s: [] if 8.0 < s.t_ns * 1e-9 < 8.0 + length else [s])
    track = replay(cut)
    assert track.estimator.counters["imu_gap"] == 1
    assert rms(track.p[track.t_s > 9.5]) < 0.06
    assert states_between(track, 3.0, 13.9) == {"TRACKING"}
    assert reasons_between(track, 8.0 + length, 10.0) == reasons
    assert track.estimator.counters.get("resets", 0) == 0


def test_a_long_gap_of_the_imu_starts_again():
    flown = fly("T3", 5, NOISY, seconds=16.0)
    track = replay(edit_imu(flown, lambda s: [] if 8.0 < s.t_ns * 1e-9 < 9.5 else [s]))
    assert "INIT" in states_between(track, 9.5, 10.5)
    assert states_between(track, 11.0, 15.9) == {"TRACKING"}
    assert track.estimator.counters["restarts"] == 1
    assert track.estimator.health().resets == 1
    assert rms(track.p[track.t_s > 11.5]) < 0.08


def test_samples_that_are_no_numbers_are_dropped():
    bad = {1600: np.nan, 1601: np.inf, 2000: -np.inf, 2400: np.nan}

    def spoil(s):
        i = round(s.t_ns / 5e6)
        return [replace(s, gyro_I=np.full(3, bad[i]))] if i in bad else [s]

    track = replay(edit_imu(fly("T3", 6, NOISY, seconds=14.0), spoil))
    assert track.estimator.counters["imu_not_finite"] == 4
    assert rms(late(track)) < 0.05
    assert states_between(track, 3.0, 13.9) == {"TRACKING"}


def test_a_saturated_axis_is_believed_less():
    def limit(s):
        if 12.0 < s.t_ns * 1e-9 < 12.2:
            return [replace(s, accel_I=np.array([156.9, *s.accel_I[1:]]))]
        return [s]

    track = replay(edit_imu(fly("T3", 7, NOISY, seconds=18.0), limit))
    assert track.estimator.counters["imu_saturated"] == 39
    assert track.estimator.counters["imu_late_suspects"] == 4  # then it is motion
    assert rms(track.p[track.t_s > 13.5]) < 0.06
    assert states_between(track, 3.0, 12.0) == {"TRACKING"}
    assert states_between(track, 13.5, 17.9) == {"TRACKING"}
    assert states_between(track, 12.0, 13.5) <= {"TRACKING", "RELOCATING", "LOST"}


def test_ten_milliseconds_of_jitter_in_the_stamps():
    rng = np.random.default_rng(0)
    flown = fly("T3", 8, NOISY, seconds=20.0)
    shaken = edit_poses(flown, lambda p: replace(p, t_ns=p.t_ns + int(1e7 * rng.normal())))
    track = replay(shaken)
    assert not np.array_equal(*([p.t_ns for _, p in f.poses] for f in (flown, shaken)))
    assert rms(late(track)) < 0.06
    assert states_between(track, 3.0, 19.9) == {"TRACKING"}


def test_stamps_that_run_backward():
    def back(s):
        return [s, replace(s, t_ns=s.t_ns - 7_000_000)] if s.t_ns % 1_000_000_000 == 0 else [s]

    flown = fly("T3", 9, NOISY, seconds=14.0)
    track, clean = replay(edit_imu(flown, back)), replay(flown)
    assert track.estimator.counters["imu_backward"] == 15
    assert states_between(track, 3.0, 13.9) == {"TRACKING"}
    assert_allclose(track.estimator.state(), clean.estimator.state(), atol=1e-12)


def test_a_clock_that_starts_again_starts_the_filter_again():
    flown = fly("T3", 10, NOISY, seconds=8.0)
    track = replay(flown)
    estimator = track.estimator
    for s in flown.imu[:20]:
        estimator.imu(s)
    assert estimator.counters["restarts"] == 1
    assert str(estimator.health().state) == "INIT"


def test_poses_that_are_no_numbers_are_counted_and_left_out():
    def spoil(p):
        if p.t_ns % 1_000_000_000 < 50_000_000:
            return replace(p, p_WC=p.p_WC * np.nan)
        return p

    track = replay(edit_poses(fly("T3", 11, NOISY, seconds=10.0), spoil))
    assert track.estimator.counters["pose_not_finite"] == 9
    assert states_between(track, 3.0, 9.9) == {"TRACKING"}
    assert rms(late(track)) < 0.05


def test_flipped_rotations_do_not_cost_the_position():
    flip = geo.exp(np.array([0.0, 1.0, 0.0]))
    flown = fly("T3", 12, NOISY, seconds=16.0)
    bad = {i for i in range(len(flown.poses)) if i % 4 == 0}
    order = {id(p): i for i, (_, p) in enumerate(flown.poses)}
    turned = edit_poses(
        flown,
        lambda p: replace(p, R_WC=p.R_WC @ flip) if order[id(p)] in bad and p.t_ns > 3e9 else p,
    )
    track = replay(turned)
    assert track.estimator.counters["fused_position"] > 50
    assert states_between(track, 4.0, 15.9) == {"TRACKING"}
    assert rms(late(track)) < 0.05


def test_poses_that_agree_with_nothing_never_start():
    """Poses that no motion of this IMU explains are refused with a reason, for ever."""
    rng = np.random.default_rng(1)
    flown = fly("T3", 13, NOISY, seconds=6.0)
    wild = edit_poses(flown, lambda p: replace(p, R_WC=geo.exp(rng.normal(size=3) * 2.0)))
    track_states = replay_states(wild)
    assert track_states == {"INIT"}


def replay_states(flown):
    estimator = ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK)
    states = set()
    for what in events(flown):
        feed(estimator, what)
        states.add(str(estimator.health().state))
    assert estimator.health().reasons
    return states


def test_stamps_of_poses_that_run_backward():
    """Every fourth pose comes two frames after its turn: it is fused where it belongs."""
    flown = fly("T3", 15, NOISY, seconds=10.0)
    held = {i for i in range(40, len(flown.poses)) if i % 4 == 0}
    poses = [(a + 100_000_000 * (i in held), p) for i, (a, p) in enumerate(flown.poses)]
    swapped = replace(flown, poses=sorted(poses, key=lambda p: p[0]))
    assert (np.diff([p.t_ns for _, p in swapped.poses]) < 0).sum() > 30
    track = replay(swapped)
    assert states_between(track, 3.0, 9.9) == {"TRACKING"}
    assert "too_old" not in track.estimator.counters
    assert rms(late(track)) < 0.05


def test_starts_in_full_flight():
    """Up to 1.5 m/s from the first sample on; all of them: `tools/filter_study.py starts`."""
    for seed, speed in enumerate(np.linspace(0.1, 1.5, 8)):
        flight, _ = circle(speed, np.random.default_rng(seed))
        assert np.linalg.norm(flight(np.zeros(1)).v_WI[0, :2]) == pytest.approx(speed, rel=0.02)
        track = replay(fly((flight, 8.0), seed, PoseNoise(dropouts=0)), every=20)
        assert np.linalg.norm(track.p[track.t_s > 3.0], axis=1).max() < 0.4, seed
        assert states_between(track, 3.0, 7.9) <= {"TRACKING", "COASTING"}, seed
        assert track.estimator.counters.get("resets", 0) == 0


def test_a_wrong_start_is_left_behind():
    """The first second of poses lies two metres away: the filter moves to where the rest agree."""
    flown = fly("T3", 14, CLEAN, seconds=10.0)
    moved = edit_poses(
        flown, lambda p: replace(p, p_WC=p.p_WC + 2.0 * np.eye(3)[1]) if p.t_ns < 1.2e9 else p
    )
    track = replay(moved)
    assert rms(track.p[track.t_s > 4.0]) < 0.08
    assert states_between(track, 4.0, 9.9) == {"TRACKING"}


def turned(flown, t0_s, t1_s, flags=()):
    """Rotations 40 degrees off between the two; positions are right, and the poses carry flags."""
    flip = geo.exp(np.array([0.0, 0.7, 0.0]))

    def turn(p):
        inside = t0_s * 1e9 < p.t_ns < t1_s * 1e9
        return replace(p, R_WC=p.R_WC @ flip, flags=flags) if inside else p

    return edit_poses(flown, turn)


def test_an_attitude_that_all_poses_deny_is_given_up():
    """A start from turned poses: positions pass the gate, rotations do not, and they are right."""
    track = replay(turned(fly("T3", 16, NOISY, seconds=14.0), 0.0, 1.2))
    assert track.estimator.counters["fused_position"] >= 5
    assert track.estimator.counters["restarts"] >= 1  # so soon after the start all begins anew
    assert np.degrees(np.linalg.norm(track.rotation[track.t_s > 7.0], axis=1)).max() < 8.0
    assert states_between(track, 7.0, 13.9) == {"TRACKING"}


def test_a_lasting_planar_flip_turns_nothing_over():
    flown = turned(fly("T3", 16, NOISY, seconds=14.0), 6.0, 9.0, flags=("ambiguous",))
    track = replay(flown)
    assert "resets" not in track.estimator.counters
    assert np.degrees(np.linalg.norm(track.rotation[track.t_s > 6.0], axis=1)).max() < 8.0


def test_a_stalled_imu_is_said():
    """No samples for 0.8 s while poses go on: the state held is not called good."""
    flown = fly("T3", 17, NOISY, seconds=8.0)
    before = [s for s in flown.imu if s.t_ns < 6_000_000_000]
    said = []
    estimator = ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK)
    stalled = replace(flown, imu=before)
    for what in events(stalled):
        feed(estimator, what)
        if what.t_ns > 6.6e9:
            said.append(estimator.health())
    assert said
    assert {str(h.state) for h in said} == {"LOST"}
    assert all("imu_stalled" in h.reasons for h in said)
    for s in flown.imu:
        if s.t_ns >= 6_800_000_000:
            estimator.imu(s)
    assert "imu_stalled" not in estimator.health().reasons
