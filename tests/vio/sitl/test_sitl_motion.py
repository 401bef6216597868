"""The IMU at another rate keeps its integrals; frames and clocks of what a simulator is told."""

import json

import numpy as np
import pytest
from scipy.integrate import quad
from study_flights import t3

from tagvo import geometry as geo
from vio.evaluate.truth import clean_truth
from vio.frames import FLIP
from vio.records import ImuTrack, Truth
from vio.sim.sensors.simple_imu import true_rates
from vio.sitl.ardupilot import state_line
from vio.sitl.estimate import Said, Sent, fc_trajectory
from vio.sitl.motion import ImuMeans, Motion, placed

MS = 1_000_000
T0 = 1_700_000_000_000_000_000


def test_means_are_those_of_the_linear_interpolation_by_quadrature():
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.integers(3 * MS, 7 * MS, size=40)).astype(np.int64) + T0
    f = rng.normal(size=(40, 2))
    means = ImuMeans(t, f)
    for a, b in ((t[3] + 100, t[3] + 2000), (t[2] - 5, t[9] + 77), (t[0] - 9 * MS, t[1]),
                 (t[-2] + 1, t[-1] + 20 * MS)):  # fmt: skip
        got = means.mean(np.array([a]), np.array([b]))[0]
        for k in range(2):
            knots = [float(x - T0) for x in t if a < x < b]
            total, _ = quad(lambda x, k=k: np.interp(x, (t - T0).astype(float), f[:, k]),
                            float(a - T0), float(b - T0), points=knots, limit=200)  # fmt: skip
            assert got[k] == pytest.approx(total / (b - a), abs=1e-7)


@pytest.mark.parametrize("rate", [50, 250, 400, 1200])
def test_integrals_survive_any_rate(rate):
    rng = np.random.default_rng(1)
    t = np.arange(0, 2_000 * MS, 5 * MS, dtype=np.int64) + T0
    f = np.cumsum(rng.normal(size=(len(t), 6)), axis=0)
    means, period = ImuMeans(t, f), 10**9 // rate
    ends = np.arange(t[0] + period, t[-1] + 1, period)
    summed = means.mean(ends - period, ends).sum(axis=0) * period * 1e-9
    whole = (0.5 * (f[:-1] + f[1:])).sum(axis=0) * 0.005
    left = means.integral(t[-1:])[0] - means.integral(ends[-1:])[0]
    np.testing.assert_allclose(summed + left, whole, rtol=1e-9, atol=1e-9)


def flown(R_BI=None, R_WL=None, seconds=10.0):
    """A noiseless IMU of T3 and its truth, in a map that lies as R_WL says."""
    R_WL = np.eye(3) if R_WL is None else R_WL
    flight, _ = t3(R_WL)
    t_s = np.arange(0.0, seconds, 0.005)
    gyro, accel = true_rates(flight, t_s, -R_WL[:, 2])
    now = flight(t_s)
    t_ns = np.round(t_s * 1e9).astype(np.int64) + T0
    truth = Truth(t_ns, now.p_WI, geo.quat_from_matrix(now.R_WI), now.v_WI)
    return ImuTrack(t_ns, gyro, accel, t_ns), clean_truth(truth), flight


@pytest.mark.parametrize(("heading_deg", "tilt"), [(0.0, 0.0), (60.0, 0.4), (200.0, 0.0)])
def test_what_is_told_is_a_motion_in_ned_that_its_own_imu_integrates_to(heading_deg, tilt):
    """A strapdown on the IMU told, at 1200 Hz, ends where the motion told says it does."""
    R_WL = geo.exp(np.array([tilt, -0.3 * tilt, 0.0]))
    track, truth, _ = flown(R_WL=R_WL)
    R_BI = geo.exp(np.array([0.1, -0.2, 1.0]))
    place = placed(track, truth, np.radians(heading_deg), R_BI)
    motion = Motion(track, truth, place, np.random.default_rng(0))
    period = 833_333
    steps = np.arange(period, 5 * 10**9, period, dtype=np.int64) + T0
    states = motion.states(steps, period, T0 - 10**9)
    assert states[0].t_ns == 10**9 + period
    R, v, p = geo.matrix_from_quat(states[0].q_NF), states[0].v_N.copy(), states[0].p_N.copy()
    for s in states[1:]:
        R_next = R @ geo.exp(s.gyro_F * period * 1e-9)
        a = R @ geo.exp(0.5 * s.gyro_F * period * 1e-9) @ s.accel_F + np.array([0, 0, 9.81])
        p = p + v * period * 1e-9 + 0.5 * a * (period * 1e-9) ** 2
        v, R = v + a * period * 1e-9, R_next
    last = states[-1]
    apart = np.linalg.norm(geo.log(R.T @ geo.matrix_from_quat(last.q_NF)))
    assert np.degrees(apart) < 0.1
    level = np.degrees(np.arccos(place.R_NW[2] @ -R_WL[:, 2] * 1.0))
    assert level < 0.05, "level by the log's own mean of the force"
    np.testing.assert_allclose(v, last.v_N, atol=0.02)
    np.testing.assert_allclose(p, last.p_N, atol=0.05)


def test_before_the_log_it_stands_still_with_the_sensor_alive():
    track, truth, _ = flown()
    place = placed(track, truth, 0.0, np.eye(3))
    motion = Motion(track, truth, place, np.random.default_rng(0))
    steps = np.arange(T0 - 10**9, T0 + 1, 4 * MS, dtype=np.int64)
    states = motion.states(steps, 4 * MS, T0 - 2 * 10**9)
    gyro = np.array([s.gyro_F for s in states])
    accel = np.array([s.accel_F for s in states])
    assert np.abs(gyro.mean(axis=0)).max() < 0.02
    assert accel[:, 2].mean() == pytest.approx(-9.81, abs=0.05)
    assert gyro.std(axis=0).min() > 1e-4, "one that never changes counts as stuck"
    assert all((s.v_N == 0).all() for s in states)
    assert all((s.p_N == states[0].p_N).all() for s in states)


def test_a_log_that_begins_in_motion_rests_level_by_its_attitude():
    track, truth, _ = flown()
    late = slice(1400, None)
    moving = ImuTrack(*(a[late] for a in (track.t_ns, track.gyro_I, track.accel_I, track.t_ns)))
    moving.gyro_I[:100] += 1.0
    place = placed(moving, truth, 0.3, np.eye(3))
    motion = Motion(moving, truth, place, np.random.default_rng(0))
    begin = np.array([motion.begin_ns - 10**9])
    (s,) = motion.states(begin, 4 * MS, 0)
    np.testing.assert_allclose(geo.matrix_from_quat(s.q_NF) @ s.accel_F, [0, 0, -9.81], atol=0.03)
    assert np.abs(s.gyro_F).max() < 0.01


def test_the_estimate_comes_back_as_the_imu_in_the_map():
    """Told what the motion says, in ms of another clock, the trajectory is the truth."""
    track, truth, flight = flown()
    R_BI = geo.exp(np.array([0.1, -0.2, 1.0]))
    place = placed(track, truth, np.radians(60.0), R_BI)
    motion = Motion(track, truth, place, np.random.default_rng(0))
    t = np.arange(2, 8, 0.02)
    stamps = np.round(t * 1e9).astype(np.int64) + T0
    positions, attitudes = [], []
    for s, now in zip(motion.states(stamps, 4 * MS, T0), stamps, strict=True):
        stamp = int(s.t_ns // MS * MS) + 17 * 10**9
        R = geo.matrix_from_quat(s.q_NF)
        positions.append(Said(stamp, int(now) + 3 * MS, (*s.p_N, *s.v_N)))
        attitudes.append(Said(stamp + 10 * MS, int(now) + 12 * MS, tuple(geo.rpy_from_matrix(R))))
    fc = fc_trajectory(positions, attitudes, [Sent(0, place.R_NW)], place.R_NW, R_BI)
    assert fc.name == "fc"
    assert len(fc) > 280
    off = fc.t_ns[0] - stamps[1]
    assert 0 <= off <= 3 * MS
    at = flight((fc.t_ns - off - T0) * 1e-9)
    np.testing.assert_allclose(fc.p_WI, at.p_WI, atol=2e-3)
    assert fc.v_WI is not None
    np.testing.assert_allclose(fc.v_WI, at.v_WI, atol=5e-3)
    late = flight((fc.t_ns - off - T0) * 1e-9 - 0.01)  # attitudes were stamped 10 ms later
    angle = np.linalg.norm(geo.log(np.swapaxes(late.R_WI, -1, -2) @ fc.R_WI), axis=-1)
    assert np.degrees(angle.max()) < 0.5


def test_a_new_levelling_brings_each_position_back_as_it_was_sent():
    first, second = geo.exp(np.array([0.02, 0.0, 1.0])), geo.exp(np.array([0.0, 0.01, 1.0]))
    p_W, rows, angles = np.array([1.5, 2.5, 1.0]), [], []
    for k in range(40):
        R_NW = first if k < 20 else second
        rows.append(Said(k * 20 * MS, k * 20 * MS, (*(R_NW @ p_W), *(R_NW @ [0.1, 0.2, 0.3]))))
        angles.append(Said(k * 20 * MS, k * 20 * MS, (0.0, 0.0, 0.0)))
    sent = [Sent(-1, first), Sent(20 * 20 * MS, second)]
    fc = fc_trajectory(rows, angles, sent, np.eye(3), np.eye(3))
    np.testing.assert_allclose(fc.p_WI, np.tile(p_W, (40, 1)), atol=1e-12)
    np.testing.assert_allclose(fc.v_WI, np.tile([0.1, 0.2, 0.3], (40, 1)), atol=1e-12)
    np.testing.assert_allclose(fc.R_WI, np.tile(np.diag([1.0, -1, -1]), (40, 1, 1)), atol=1e-12)


def test_no_estimate_is_an_empty_trajectory():
    assert len(fc_trajectory([], [], [], np.eye(3), np.eye(3))) == 0


def test_a_state_is_one_json_line_with_all_that_must_be_there():
    track, truth, _ = flown()
    motion = Motion(track, truth, placed(track, truth, 0.0, np.eye(3)), np.random.default_rng(0))
    (s,) = motion.states(np.array([T0 + 10**9]), 4 * MS, T0)
    line = state_line(s)
    assert line[:1] == b"\n"
    assert line[-1:] == b"\n"
    assert line.count(b"\n") == 2
    said = json.loads(line)
    assert set(said) == {"timestamp", "imu", "position", "quaternion", "velocity"}
    assert set(said["imu"]) == {"gyro", "accel_body"}
    assert said["timestamp"] == 1.0
    R = geo.matrix_from_quat(np.array(said["quaternion"]))
    assert R[2, 2] > 0.9, "the body's down is down"
    assert (FLIP == [1, -1, -1]).all()


def test_fc_is_judged_from_the_first_pose_sent():
    """PX4 is 5227 km away before: the origin of its own place on earth has moved."""
    rows, angles = [], []
    for k in range(100):
        far = 5e6 if k < 60 else 0.0
        rows.append(Said(k * 20 * MS, k * 20 * MS, (far, 0.0, 0.0, 0.0, 0.0, 0.0)))
        angles.append(Said(k * 20 * MS, k * 20 * MS, (0.0, 0.0, 0.0)))
    fc = fc_trajectory(rows, angles, [Sent(60 * 20 * MS, np.eye(3))], np.eye(3), np.eye(3))
    assert len(fc) == 40
    np.testing.assert_allclose(fc.p_WI, 0.0)
