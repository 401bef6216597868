"""The estimator as a whole: order of arrival, lateness, consistency, start, prior, determinism."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from flights import CAMERA, CLEAN, edit_poses, events, feed, fly, replay, rms
from numpy.testing import assert_allclose
from oracles.suspect_study import flight
from study_flights import PoseNoise

from tagvo import geometry as geo
from vio.config.filter import PriorConfig, VioConfig
from vio.filter import state as at
from vio.filter.eskf import ErrorStateFilter
from vio.filter.health import State
from vio.filter.history import _mean_rate, _rate_span
from vio.filter.measurements import constraints, kinds, pose
from vio.frames import level_frame
from vio.localize.localizer import Localizer
from vio.records import ImuSample
from vio.sim.sensors.camera_stream import wrong_rig
from vio.sim.sensors.simple_imu import PIXHAWK


def run(whats, config=None, camera=CAMERA):
    estimator = ErrorStateFilter(config or VioConfig(), camera, PIXHAWK)
    outputs = [feed(estimator, what) for what in whats]
    return estimator, [o for o in outputs if o is not None]


def in_order(flown, delays_ns):
    whats = [(s.t_ns, 0, i, s) for i, s in enumerate(flown.imu)]
    poses = [p for _, p in flown.poses]
    whats += [(p.t_ns + int(delays_ns[i]), 1, i, p) for i, p in enumerate(poses)]
    return [w[3] for w in sorted(whats, key=lambda w: w[:3])]


@pytest.mark.parametrize("ahead_s", [0.9, 10.0, 1e8])
def test_one_pose_from_the_future_is_refused_and_leaves_nothing(ahead_s):
    """What its stamp says must not stay: neither LOST for ever, nor a restart in vain."""
    flown = fly("T3", 3, seconds=7.0)
    whats = events(flown)
    k = next(i for i, w in enumerate(whats) if not isinstance(w, ImuSample) and w.t_ns > 4e9)
    false = replace(whats[k], t_ns=whats[k].t_ns + round(ahead_s * 1e9))
    clean, _ = run(whats)
    estimator, states = ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK), []
    for what in [*whats[:k], false, *whats[k + 1 :]]:
        feed(estimator, what)
        states.append(estimator.health().state)
    assert State.LOST not in states[k + 50 :]
    assert estimator.counters.get("restarts", 0) == 0
    if ahead_s > 1.0:
        assert estimator.counters["too_early"] == 1
        assert np.linalg.norm((estimator.state() - clean.state())[:3]) < 2e-3


def test_a_frame_repeated_before_the_start_does_not_crowd_the_others_out():
    whats = events(fly("T3", 3, seconds=4.0))
    often = [w for what in whats for w in [what] * (1 if isinstance(what, ImuSample) else 40)]
    once, _ = run(whats)
    many, _ = run(often)
    assert np.array_equal(many.state(), once.state())
    assert many.counters["duplicate"] == 39 * sum(not isinstance(w, ImuSample) for w in whats)


def test_of_one_stamp_kinds_and_cameras_lie_in_their_own_order_and_none_twice():
    """Two cameras' poses and a rest at one nanosecond: each refused a second time."""
    whats = events(fly("T3", 3, seconds=4.0))
    last = next(w for w in reversed(whats) if not isinstance(w, ImuSample))
    done = []
    moved = replace(last, p_WC=last.p_WC + 1e-3, camera=1)
    rows = [pose.pack(last), pose.pack(moved), constraints.still(0.5)]
    for order in permutations(range(3)):
        estimator, _ = run([w for w in whats if w is not last])
        history = estimator._history
        for k in order:
            assert history.insert(last.t_ns, rows[k]) == ""
        for row in rows:
            assert history.insert(last.t_ns, row) == "duplicate"
        same = history.rows.stamp[: history.count] == last.t_ns
        placed = history.rows.z[: history.count][same][:, [kinds.KIND, kinds.CAMERA]]
        assert placed.tolist() == [[kinds.STILL, 0], [kinds.POSE, 0], [kinds.POSE, 1]]
        done.append(estimator.state())
    assert all(np.array_equal(done[0], other) for other in done[1:])


@pytest.mark.parametrize("seed", range(4))
def test_late_and_shuffled_arrival_leave_no_trace(seed):
    noise = PoseNoise(dropouts=0, delay_s=(0.0, 0.0), stamp_s=0.0)
    flown, rng = fly("T3", seed, noise, seconds=9.0), np.random.default_rng(seed)
    delays = rng.integers(0, 150_000_000, len(flown.poses))
    early = np.array([p.t_ns < 2_000_000_000 or p.t_ns > 8_700_000_000 for _, p in flown.poses])
    delays[early] = 0  # the start is the same; at the end everything has arrived
    a, _ = run(in_order(flown, np.zeros(len(delays))))
    b, _ = run(in_order(flown, delays))
    assert_allclose(a.state(), b.state(), atol=1e-12)
    assert_allclose(a.covariance(), b.covariance(), rtol=1e-9, atol=1e-15)
    assert a.counters["fused"] == b.counters["fused"]


def test_duplicates_and_old_poses_are_refused_and_counted():
    flown = fly("T2", 1, seconds=6.0)
    whats = events(flown)
    estimator, _ = run(whats)
    before = estimator.state()
    estimator.pose(flown.poses[-1][1])
    estimator.pose(flown.poses[10][1])
    assert estimator.counters["duplicate"] == 1
    assert estimator.counters["too_old"] == 1
    assert np.array_equal(estimator.state(), before)


def test_an_early_pose_waits_for_the_imu():
    flown = fly("T2", 2, seconds=6.0)
    whats = events(flown)
    cut = next(i for i, w in enumerate(whats) if w is flown.imu[1000])
    estimator, _ = run(whats[:cut])
    now = flown.imu[999].t_ns
    ahead = next(p for _, p in flown.poses if p.t_ns > now + 20_000_000)
    estimator.pose(ahead)
    assert estimator.counters["waiting"] == 1
    for sample in flown.imu[1000:1040]:
        estimator.imu(sample)
    assert "waiting" not in estimator.counters


def test_the_same_input_gives_the_same_bytes():
    flown = fly("T3", 3, PoseNoise(), seconds=8.0)
    _, a = run(events(flown))
    _, b = run(events(flown))
    assert [o.p_WI.tobytes() + o.cov.tobytes() for o in a] == [
        o.p_WI.tobytes() + o.cov.tobytes() for o in b
    ]


def test_output_is_valid_now_at_the_imus_rate():
    flown = fly("T3", 4, seconds=10.0)
    _, outputs = run(events(flown))
    stamps = np.array([o.t_ns for o in outputs])
    assert np.array_equal(np.diff(stamps), np.full(len(stamps) - 1, 5_000_000))
    assert outputs[0].t_ns < 1.5e9
    truth = flown.flight(stamps * 1e-9)
    late = stamps > 4e9
    p = np.array([o.p_WI for o in outputs]) - truth.p_WI
    v = np.array([o.v_WI for o in outputs]) - truth.v_WI
    assert rms(p[late]) < 0.012
    assert rms(v[late]) < 0.03


def test_errors_are_as_large_as_the_filter_says():
    """White poses, exact models: NEES/6 over flights, and neither side too small nor too large."""
    config = VioConfig(r_adapt=False, r_inflation=1.0)
    nees = []
    for seed in range(8):
        track = replay(fly("T3", 100 + seed, CLEAN, seconds=15.0), config)
        nees.append(track.nees[track.t_s > 3.0].mean())
    assert 0.6 < np.mean(nees) < 1.6


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 90.0])
def test_gravity_is_found_wherever_it_points(tilt_deg):
    R_WG = geo.exp(np.radians(tilt_deg) * np.array([0.6, 0.8, 0.0]))
    track = replay(fly("T3", 5, CLEAN, seconds=12.0, R_WG=R_WG))
    x = track.estimator.state()
    up = geo.matrix_from_quat(x[at.X_QWL : at.X_QWL + 4])[:, 2]
    assert np.degrees(np.arccos(np.clip(up @ R_WG[:, 2], -1.0, 1.0))) < 0.5
    assert rms(track.p[track.t_s > 5.0]) < 0.015


def test_level_frame_stands_against_gravity():
    for down in np.random.default_rng(0).normal(size=(20, 3)):
        R = level_frame(down)
        assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert_allclose(R[:, 2], -down / np.linalg.norm(down), atol=1e-12)


def test_offset_and_extrinsics_are_learnt_where_the_file_is_wrong():
    noise = PoseNoise(white=(0.01, 0.3), slow=(0.0, 0.0), outliers=0.0, dropouts=0, stamp_s=0.03)
    rig = wrong_rig(CAMERA, 2.0, 0.0, np.random.default_rng(1))
    track = replay(fly("T3", 6, noise), camera=rig)
    x = track.estimator.state()
    assert x[at.X_TD] == pytest.approx(0.03, abs=2e-3)
    R_IC = geo.matrix_from_quat(x[at.X_QIC : at.X_QIC + 4])
    assert np.degrees(geo.angle(CAMERA.R_CI @ R_IC)) < 0.4
    assert "rig_confirmed" not in track.estimator.counters


def test_a_true_calibration_is_confirmed_and_held():
    track = replay(fly("T3", 7, CLEAN, seconds=25.0))
    P, x = track.estimator.covariance(), track.estimator.state()
    assert track.estimator.counters["rig_confirmed"] == 2
    assert np.degrees(np.sqrt(P[at.EX, at.EX])) < 0.06
    assert abs(x[at.X_TD]) < 1e-3


@pytest.fixture(scope="module")
def white():
    """A flight whose poses' errors remember nothing."""
    return replay(fly("T3", 8, PoseNoise(slow=(0.0, 0.0), outliers=0.0, dropouts=0)))


def test_inflation_follows_the_memory_of_the_errors(white):
    from vio.filter.adaptive_noise import NoisePolicy, inflation

    policy = NoisePolicy(4.0, True, False, 0.0, 1.0)
    slow = PoseNoise(white=(0.003, 0.1), slow=(0.02, 0.7), slow_s=0.3, outliers=0.0, dropouts=0)
    correlated = replay(fly("T3", 8, slow))
    assert inflation(white.estimator.state(), policy, True) < 2.5
    assert inflation(correlated.estimator.state(), policy, True) > 6.0


def test_the_slow_share_is_learnt(white):
    """Errors that last 5 s are told from white ones; where they are told nothing, none is."""
    from vio.filter.adaptive_noise import NoisePolicy, slow_share

    policy = NoisePolicy(4.0, True, False, 0.0, 1.0)
    slow = replay(fly("T3", 8, PoseNoise(slow=(0.025, 1.0), outliers=0.0, dropouts=0)))  # half
    assert slow_share(white.estimator.state(), policy, True)[0] < 0.1
    of_positions, of_rotations = slow_share(slow.estimator.state(), policy, True)
    assert 0.2 < of_positions < 0.8
    assert 0.0 < of_rotations < of_positions
    assert slow_share(slow.estimator.state(), policy, False) == (0.0, 0.0)
    policy = policy._replace(share_given=True, share=0.4)
    assert slow_share(white.estimator.state(), policy, True) == (0.4, 0.4)


def test_prior_is_where_the_camera_will_be():
    flown = fly("T3", 9, seconds=8.0)
    estimator, _ = run(events(flown))
    t_ns = flown.imu[-1].t_ns
    for t in (t_ns - 30_000_000, t_ns, t_ns + 30_000_000):
        prior, truth = estimator.prior(t), flown.flight(np.array([t * 1e-9]))
        R_IC, p_IC = geo.invert(CAMERA.R_CI, CAMERA.p_CI)
        R_WC, p_WC = geo.compose(truth.R_WI[0], truth.p_WI[0], R_IC, p_IC)
        e = np.concatenate([p_WC - prior.p_WC, geo.log(prior.R_WC.T @ R_WC)])
        assert np.linalg.norm(e[:3]) < 0.03
        assert e @ np.linalg.solve(prior.cov, e) < 40.0
    assert ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK).prior(0) is None


@pytest.mark.parametrize("name", ["T1", "T3"])
def test_starts_neither_diverge_nor_lie(name):
    """A part of what `tools/filter_study.py starts` does: at rest, and in the middle of motion."""
    for seed in range(25):
        flown = fly(name, 1000 + seed, PoseNoise(dropouts=0), seconds=14.0)
        begin = int(np.random.default_rng(seed).uniform(0.0, 8.0) * 200)
        t0 = flown.imu[begin].t_ns
        flown.imu, flown.poses = flown.imu[begin:], [q for q in flown.poses if q[0] > t0]
        track = replay(flown, every=40)
        late = track.t_s > t0 * 1e-9 + 3.0
        assert np.linalg.norm(track.p[late], axis=1).max() < 0.4, seed
        assert track.estimator.counters.get("resets", 0) == 0


def test_ground_holds_the_velocity_at_zero():
    config = VioConfig(prior=PriorConfig(velocity_m_s=1.0))
    flown = fly("T2", 3, CLEAN, seconds=12.0)
    still = [ImuSample(s.t_ns, 0.002 + 0 * s.gyro_I, np.array([0.02, 0.0, 9.81]), s.t_ns)
             for s in flown.imu]  # fmt: skip
    pose = flown.poses[0][1]
    from dataclasses import replace

    flown.imu = still
    flown = edit_poses(flown, lambda p: replace(pose, t_ns=p.t_ns))
    estimator = ErrorStateFilter(config, CAMERA, PIXHAWK)
    estimator.ground(True)
    for what in events(flown):
        if isinstance(what, ImuSample) or what.t_ns < 3e9:
            feed(estimator, what)
    assert estimator.health().state in (State.COASTING, State.LOST)
    assert np.linalg.norm(estimator.nav().v_WI) < 0.01


def test_the_rate_behind_the_time_offset_is_a_mean_over_the_span_asked_for():
    rng = np.random.default_rng(5)
    t = np.cumsum(rng.integers(3, 8, size=200)).astype(np.int64) * 1_000_000
    imu = rng.normal(size=(200, 12))
    rows = np.flatnonzero((t[:-1] > t[150] - 100_000_000) & (t[:-1] < t[150])) + 1
    rows = np.union1d(rows, [rows[0] - 1 if t[150] - t[rows[0] - 1] < 100_000_000 else rows[0]])
    dt = np.diff(t)[rows - 1]
    expected = np.average(imu[rows, 0:3], axis=0, weights=dt)
    np.testing.assert_allclose(_mean_rate(t, imu, 150, 1e8), expected, rtol=1e-12)
    np.testing.assert_allclose(_mean_rate(t, imu, 1, 1e8), imu[1, 0:3])


def test_a_quiet_gyro_is_averaged_briefly_a_noisy_one_for_longer():
    q = at.ProcessNoise(*np.zeros(8).tolist())
    spans = []
    for density in (1e-4, 4e-3, 0.1):
        spans.append(_rate_span(q._replace(gyro=density**2)) * 1e-6)
    np.testing.assert_allclose(spans, [15.0, 40.0, 100.0])


def test_a_wobbling_vehicle_does_not_lead_the_time_offset_astray():
    """T2 by the quadrotor, shaken at 1 to 10 Hz, with every nuisance at once."""
    recording, seen = flight(1, "nuisances", ("flight.name=T2", "vehicle=qr"))
    localizer = Localizer(recording.camera, recording.tag_map, imu_noise=recording.noise)
    known = [f.t_ns if f.arrival_ns is None else f.arrival_ns for f in seen]
    merged = [(int(t), 0, i) for i, t in enumerate(recording.imu.arrival_ns)]
    merged += [(int(t), 1, i) for i, t in enumerate(known)]
    for _, kind, i in sorted(merged):
        localizer.process(seen[i] if kind else recording.imu.sample(i))
    core = localizer.filter
    assert core.counters.get("resets", 0) == 0
    assert core.counters.get("gated", 0) <= 3
    assert abs(core.state()[at.X_TD] - recording.true_camera.timeshift_s) < 0.004
