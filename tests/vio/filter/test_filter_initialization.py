"""Starts that look like rest and are none, resets soon after, and the way out of LOST."""

from dataclasses import replace

import numpy as np
import pytest
from flights import CAMERA, CLEAN, edit_imu, edit_poses, fly, replay, states_between
from simulated import arena
from study_flights import PoseNoise, hover

from tagvo import geometry as geo
from tagvo.tags.tag_map import Gravity
from vio.config.filter import HealthConfig, PriorConfig, RecoveryConfig, VioConfig
from vio.filter import state as at
from vio.filter.health import Health, Signs, State, judge
from vio.filter.initialization import CalibrationBounds, Rig, moves, trend
from vio.filter.relocalization import LostWatch

SHARP = PoseNoise(
    white=(0.002, 0.1), slow=(0.001, 0.05), outliers=0.0, dropouts=0, stamp_s=0.0, rate_hz=30.0
)


def hovering(yaw_deg_s, speed, seed=0, noise=SHARP, seconds=12.0):
    rng = np.random.default_rng(seed)
    return fly(hover(speed, np.radians(yaw_deg_s), rng, seconds), seed, noise, seconds=seconds)


@pytest.mark.parametrize(("yaw_deg_s", "speed"), [(2.7, 0.0), (-5.0, 0.1), (0.0, 0.1), (5.0, 0.0)])
def test_a_hover_that_drifts_or_yaws_is_no_rest(yaw_deg_s, speed):
    track = replay(hovering(yaw_deg_s, speed))
    late = track.t_s > 3.0
    assert np.linalg.norm(track.p[late], axis=1).max() < 0.03
    assert np.degrees(np.linalg.norm(track.rotation[late], axis=1)).max() < 4.0  # T_cam_imu's prior
    assert track.nees[late].mean() < 2.0
    assert track.estimator.health().resets == 0


def test_true_rest_is_used_and_the_gyros_bias_known_from_it():
    track = replay(hovering(0.0, 0.0), VioConfig())
    assert track.estimator.health().resets == 0
    x = track.estimator.state()
    true = np.mean([s.gyro_I for s in hovering(0.0, 0.0).imu], axis=0)
    np.testing.assert_allclose(x[at.X_BG : at.X_BG + 3], true, atol=1e-3)


def test_how_poses_move_is_seen_through_outliers():
    poses = [p for _, p in hovering(3.0, 0.08).poses[:20]]
    line = trend(poses)
    assert line.rate == pytest.approx(np.radians(3.0), abs=3 * line.rate_sigma)
    assert line.speed == pytest.approx(0.08, abs=5 * line.speed_sigma)
    poses[7] = replace(poses[7], p_WC=poses[7].p_WC + 2.0)
    assert trend(poses).speed == pytest.approx(0.08, abs=0.02)
    assert moves(poses)
    assert not moves([p for _, p in hovering(0.0, 0.0).poses[:20]])
    assert not moves(poses[:2])


def test_a_reset_soon_after_a_start_begins_again_with_priors():
    """The time offset has been led astray by 0.2 s: what a relocation would keep is forgotten."""
    flown = fly("T3", 5, CLEAN, seconds=16.0)
    late = edit_imu(flown, lambda s: [replace(s, t_ns=s.t_ns + 200_000_000) if s.t_ns < 4e9 else s])
    track = replay(late)
    assert track.estimator.counters["restarts"] >= 1
    assert track.estimator.counters.get("resets", 0) == 0
    good = track.t_s > 9.0
    assert np.linalg.norm(track.p[good], axis=1).max() < 0.1
    assert abs(track.estimator.state()[at.X_TD]) < 0.01


def test_a_camera_tilted_far_beyond_its_prior_never_tracks_in_silence():
    tilted = replace_rotation(geo.exp(np.array([np.radians(10.0), 0.0, 0.0])))
    floor = replace(arena(), gravity=Gravity((0.0, 0.0, -1.0), 1.0))
    flown = fly("T3", 6, CLEAN, seconds=14.0)
    assert "start_tilted" not in replay(flown, tag_map=floor).estimator.counters
    track = replay(flown, camera=tilted, tag_map=floor)
    assert track.estimator.counters["start_tilted"] >= 1
    tracking = np.array([s == "TRACKING" for _, s in track.states[-len(track.t_s) :]])
    if tracking.any():
        assert track.nees[tracking].mean() < 2.5
    assert "calibration_far" in {r for _, r in track.reasons}


def replace_rotation(turn):
    return type(CAMERA)(
        CAMERA.model, CAMERA.intrinsics, CAMERA.coeffs, CAMERA.resolution, CAMERA.R_CI @ turn,
        CAMERA.p_CI, CAMERA.timeshift_s, CAMERA.source,
    )  # fmt: skip


def test_bounds_are_four_sigmas_of_the_wide_prior_whatever_a_file_says():
    x = np.zeros(at.NOMINAL)
    x[at.X_QIC] = 1.0
    rig = Rig(np.eye(3), np.zeros(3), 0.0)
    tight = CalibrationBounds(PriorConfig(extrinsic_rotation_deg=0.1, time_offset_s=0.001), rig)
    for deg, far in ((5.9, False), (6.1, True)):
        x[at.X_QIC : at.X_QIC + 4] = geo.quat_from_matrix(geo.exp(np.radians([deg, 0.0, 0.0])))
        assert tight.calibration_far(x) is far
    x[at.X_QIC : at.X_QIC + 4] = [1.0, 0.0, 0.0, 0.0]
    for offset, far in ((0.119, False), (-0.121, True)):
        x[at.X_TD] = offset
        assert tight.calibration_far(x) is far
    x[at.X_TD], x[at.X_BG] = 0.0, 0.21
    assert not tight.calibration_far(x)
    assert tight.implausible(x)
    wide = CalibrationBounds(PriorConfig(extrinsic_rotation_deg=3.0), rig)
    x[at.X_QIC : at.X_QIC + 4] = geo.quat_from_matrix(geo.exp(np.radians([11.0, 0.0, 0.0])))
    assert not wide.calibration_far(x)


LOST = {
    "position": Signs(0.1, 0, 1.0, 0.6, 1.0, False),
    "attitude": Signs(0.1, 0, 1.0, 0.1, 11.0, False),
    "position while poses are rejected": Signs(0.8, 9, 5.0, 283.0, 1.0, False),
    "calibration": Signs(0.1, 0, 1.0, 0.1, 1.0, False, 0.0, True),
}


@pytest.mark.parametrize("why", LOST)
def test_lost_counts_before_all_else(why):
    assert judge(LOST[why], 0, (), HealthConfig()).state is State.LOST


def test_distrust_is_lost_whatever_the_filter_says():
    fine = Signs(0.1, 0, 1.0, 0.01, 0.1, False)
    assert judge(fine, 0, (), HealthConfig()).state is State.TRACKING
    health = judge(fine, 0, (), HealthConfig(), ("setup_gravity",))
    assert (health.state, health.reasons) == (State.LOST, ("setup_gravity",))
    assert judge(None, 0, ("no_pose",), HealthConfig(), ("setup_gravity",)).state is State.LOST
    assert judge(None, 0, ("no_pose",), HealthConfig()).state is State.INIT


def asked(states, step_s=0.05):
    """At which poses, one each 50 ms, it asks to begin anew."""
    watch, out = LostWatch(RecoveryConfig()), []
    for k, state in enumerate(states):
        t_ns = round(k * step_s * 1e9)
        if watch.asks(Health(state, (), None, 0), t_ns, t_ns):
            out.append(round(k * step_s, 2))
            watch.clear()
    return out


def test_lost_for_five_seconds_while_poses_come_begins_anew_and_waits_longer_each_time():
    assert asked(400 * [State.LOST]) == [5.05, 15.15]
    assert asked([*(99 * [State.LOST]), State.TRACKING, *(99 * [State.LOST])]) == []
    assert asked(10 * [State.LOST], step_s=1.5) == []  # poses that hardly come: no restart


def test_a_filter_that_is_lost_comes_back_by_itself():
    """A gyro that is wrong for a while: what it leaves behind is not kept for ever."""
    flown = fly("T3", 8, CLEAN, seconds=24.0)

    def spoil(s):
        wrong = 6.0 < s.t_ns * 1e-9 < 8.0
        return [replace(s, gyro_I=s.gyro_I + np.array([0.0, 1.5, 0.0])) if wrong else s]

    track = replay(edit_imu(flown, spoil))
    assert states_between(track, 20.0, 23.9) == {"TRACKING"}
    assert np.linalg.norm(track.p[track.t_s > 20.0], axis=1).max() < 0.1


def test_positions_alone_do_not_keep_it_tracking():
    """Rotations 40 degrees off, called ambiguous: the positions pass, and count for a second."""
    flip = geo.exp(np.array([0.0, 0.7, 0.0]))

    def turn(p):
        inside = 12e9 < p.t_ns < 15e9
        return replace(p, R_WC=p.R_WC @ flip, flags=("ambiguous",)) if inside else p

    track = replay(edit_poses(fly("T3", 16, CLEAN, seconds=17.0), turn))
    assert track.estimator.counters["fused_position"] > 20
    assert states_between(track, 12.1, 12.9) == {"TRACKING"}
    assert "TRACKING" not in states_between(track, 13.6, 15.0)
    assert states_between(track, 15.5, 16.9) == {"TRACKING"}
