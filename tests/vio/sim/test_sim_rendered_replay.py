"""Flying along a recorded flight: the truth is met, moved over the map, or refused."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from simulated import arena, corners_seen
from strategies import seeds

from tagvo import geometry as geo
from vio.errors import LogError, SimulationError
from vio.records import Truth
from vio.sim import rendered_replay as alg
from vio.sim.recording import rig_of, simulated
from vio.sim.scenario import load_scenario
from vio.sim.sensors.image_stream import frames as pictures
from vio.sim.validity import extent
from vio.sim.world import course as crs
from vio.sim.world.dynamics import body_flight
from vio.sim.world.trajectory import t3_command
from vio.sim.world.truth_spline import left_out, spline_of, velocity_misfit
from vio.sim.write_log import write_log
from vio.sources.flight_log.arrivals import same_clock
from vio.sources.flight_log.log import FlightLog

SHORT = ["flight.takeoff=false", "imu.raw_hz=null", "imu.low_pass=null", "lens.readout_s=0"]
EXACT = [
    *SHORT,
    "corners.sigma_px=0",
    "scene.laying_scale=0",
    "stream.drop_share=0",
    "scene.texture.kind=plain",
]
DATA = pytest.mark.skipif("TAGVIO_DATA" not in os.environ, reason="TAGVIO_DATA is not set")


def truth_of(flight, t_s, t0_ns=5_000_000_000):
    motion = flight(t_s)
    t_ns = t0_ns + np.rint(t_s * 1e9).astype(np.int64)
    return Truth(t_ns, motion.p_WI, geo.quat_from_matrix(motion.R_WI), motion.v_WI)


T3 = body_flight(crs.followed(t3_command()))
TRUTH = truth_of(T3, np.arange(0.0, 39.0, 0.01))


def test_the_spline_meets_the_flight_between_the_rows():
    t = np.random.default_rng(0).uniform(0.1, 38.8, 500)
    R_WI, p_WI = spline_of(TRUTH).pose(t)
    motion = T3(t)
    assert_allclose(p_WI, motion.p_WI, atol=1e-6)
    assert geo.angle(np.swapaxes(R_WI, -1, -2) @ motion.R_WI).max() < 1e-6
    assert velocity_misfit(TRUTH, spline_of(TRUTH)) < 1e-5
    p_m, angle = left_out(TRUTH)
    assert p_m.max() < 1e-4
    assert angle.max() < 1e-4


def test_the_spline_does_not_care_for_the_quaternions_sign():
    sign = np.where(np.random.default_rng(1).random((len(TRUTH), 1)) < 0.5, -1, 1)
    a = spline_of(TRUTH).pose(np.linspace(0.0, 38.0, 333))
    b = spline_of(replace(TRUTH, q_WI=sign * TRUTH.q_WI)).pose(np.linspace(0.0, 38.0, 333))
    assert_allclose(a[0], b[0], atol=1e-12)


@given(seed=seeds, yaw=st.floats(0.0, 6.28))
@settings(max_examples=20)
def test_a_flight_from_elsewhere_is_brought_over_the_map(seed, yaw):
    """Wherever and however turned it was recorded, the camera then is over the map, nothing else
    about the flight has changed, and one that was over it already stays where it was."""
    rng, (low, high) = np.random.default_rng(seed), extent(arena())
    camera = rig_of(load_scenario("along"))
    turn = geo.exp(np.array([0.0, 0.0, yaw]))
    few = truth_of(T3, np.arange(0.0, 39.0, 0.1))
    far = alg.moved(few, alg.Move(turn, np.array([*rng.uniform(-50.0, 50.0, 2), 0.0]), 0.0))
    move, words = alg.placed(far, camera, low, high)
    there = alg.moved(far, move)
    R_WI = geo.matrix_from_quat(there.q_WI)
    p_WC = geo.transform(R_WI, there.p_WI, geo.invert(camera.R_CI, camera.p_CI)[1])
    inside = ((p_WC[:, :2] >= low - 1e-6) & (p_WC[:, :2] <= high + 1e-6)).all(axis=1).mean()
    assert inside > 0.95
    assert "turned by" in words
    assert ("beside the map" in words) == (inside < 1.0)
    v_I = np.einsum("nji,nj->ni", R_WI, there.v_WI)
    was = np.einsum("nji,nj->ni", geo.matrix_from_quat(few.q_WI), few.v_WI)
    assert_allclose(v_I, was, atol=1e-9)
    assert_allclose(there.p_WI[:, 2], few.p_WI[:, 2], atol=1e-9)
    same, words = alg.placed(few, camera, low, high)
    assert (same.yaw_deg, same.p.tolist(), words) == (0.0, [0.0, 0.0, 0.0], "")


def test_a_flight_too_big_or_under_the_floor():
    camera, (low, high) = rig_of(load_scenario("along")), extent(arena())
    wide = replace(TRUTH, p_WI=8.0 * TRUTH.p_WI)
    with pytest.raises(SimulationError, match=r"m wide, the map 2\.9 x 5\.0 m: at best \d+ %"):
        alg.placed(wide, camera, low, high)
    sunk = replace(TRUTH, p_WI=TRUTH.p_WI - [0.0, 0.0, 0.7])
    move, words = alg.placed(sunk, camera, low, high)
    assert 0.02 < move.p[2] < 0.2
    assert "shifted by" in words


@given(seed=seeds, drift=st.floats(-4e-3, 4e-3))
@settings(max_examples=15)
def test_arrivals_of_another_clock_are_brought_into_the_stamps(seed, drift):
    """Latency is what comes back, whatever epoch and rate the other clock has."""
    rng = np.random.default_rng(seed)
    t_ns = np.arange(4000, dtype=np.int64) * 5_000_000
    latency = rng.exponential(2e-3, 4000) * (rng.random(4000) < 0.7)
    other = 1_795_325_787_000_000_000 + np.rint((t_ns * 1e-9 * (1 + drift) + latency) * 1e9)
    arrival = same_clock(t_ns, other.astype(np.int64))
    assert (arrival >= t_ns).all()
    assert_allclose((arrival - t_ns) * 1e-9, latency, atol=1e-4)


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """A log of corners of its own, to fly along: T1, which begins and ends in the air."""
    path = tmp_path_factory.mktemp("flown") / "log"
    scenario = load_scenario("t1_hr", [*EXACT, "stream.rate_hz=2"])
    made = simulated(scenario)
    write_log(path, made, pictures(made, scenario, corners=True, workers=1), "{}\n")
    return path


def test_along_a_log_the_camera_sees_what_it_would_have_seen(flown):
    """Corners rendered along the log's truth are projections of the map from the true poses."""
    scenario = load_scenario("along", ["vehicle=hr", *EXACT, "calibration.rotation_deg=0"])
    made = alg.followed(scenario, flown, "imu0")
    log = FlightLog.open(flown)
    assert_array_equal(made.imu.t_ns, log.imu.t_ns)
    assert_array_equal(made.imu.gyro_I, log.imu.gyro_I)
    assert_array_equal(made.imu.arrival_ns, log.imu.arrival_ns)
    assert made.noise == log.imu_noise
    assert made.phases == log.phases
    assert_allclose(made.truth.p_WI, log.truth.p_WI, atol=1e-12)
    motion = simulated(load_scenario("t1_hr", SHORT))
    drift = 1.0 + load_scenario("t1_hr").imu.drift_ppm * 1e-6  # the log's clock is the IMU's
    for k in (50, 300, 600):
        R_WC, p_WC = (x[0] for x in made.pose_at(made.frames.t_s[k : k + 1]))
        was = motion.pose_at(made.frames.t_s[k : k + 1] / drift)
        assert_allclose(p_WC, was[1][0], atol=2e-5)
        assert np.degrees(geo.angle(R_WC.T @ was[0][0])) < 0.05  # the rotors' hum is in that one
        rows, pixels = corners_seen(arena(), made.true_camera, R_WC, p_WC)
        frame = next(pictures(made, scenario, corners=True, workers=1, first=k))
        assert_array_equal(frame.detections.tag_id, arena().tag_id[rows])
        assert_allclose(frame.detections.corners_px, pixels[rows], atol=1e-9)


def test_a_part_of_a_flight_and_gaps_of_its_truth(flown, tmp_path):
    log = tmp_path / "log"
    shutil.copytree(flown, log)
    path = log / "mav0/state_groundtruth_estimate0/data.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:1000], *lines[1200:]]) + "\n")  # a second is missing
    part = ["along.start_s=2", "along.end_s=8"]
    made = alg.followed(load_scenario("along", [*EXACT, *part]), log, "imu0")
    assert 2.0 < made.frames.t_s[0] < 2.2
    assert made.frames.t_s[-1] < 8.0
    assert ((made.frames.t_s < 4.99) | (made.frames.t_s > 5.99)).all()
    assert any("29 frames left out" in n or "30 frames left out" in n for n in made.notes)
    with pytest.raises(SimulationError, match=r"along\.start_s 90 .*the truth lasts 24\.4 s"):
        alg.followed(load_scenario("along", ["along.start_s=90"]), log, "imu0")


def test_what_cannot_be_flown_along_is_refused(flown, tmp_path):
    scenario = load_scenario("along")
    with pytest.raises(LogError, match=r"no IMU 'imu_x' \(mav0/imu_x/data\.csv\); it has imu0"):
        alg.followed(scenario, flown, "imu_x")
    with pytest.raises(LogError, match=r"no IMU 'imu0'.*it has no IMU"):
        alg.followed(scenario, tmp_path, "imu0")
    log = tmp_path / "log"
    shutil.copytree(flown, log)
    path = log / "mav0/state_groundtruth_estimate0/data.csv"
    lines = path.read_text().splitlines()

    rng = np.random.default_rng(0)

    def replaced(line, first, values):
        cells = line.split(",")
        cells[first : first + len(values)] = [f"{v:.6f}" for v in values]
        return ",".join(cells)

    changes = [
        ("the IMU's z is not up", 4, lambda: [0.5, 0.5, 0.5, 0.5]),
        ("too sparse or too noisy", 1, lambda: rng.normal(1.5, 0.1, 3)),
        (r"velocities and positions disagree by \d+\.\d+ m/s", 8, lambda: [9.0, 0.0, 0.0]),
    ]
    for says, first, values in changes:
        rows = [replaced(line, first, values()) for line in lines[1:]]
        path.write_text("\n".join([lines[0], *rows]) + "\n")
        with pytest.raises(SimulationError, match=says):
            alg.followed(scenario, log, "imu0")
    path.unlink()
    with pytest.raises(LogError, match="no truth to fly along"):
        alg.followed(scenario, log, "imu0")


@DATA
@pytest.mark.parametrize("name", ["arducopter_flight", "px4_flight"])
@pytest.mark.parametrize("imu", ["imu0", "imu_mavlink"])
def test_the_autopilots_flights_can_be_flown_along(name, imu):
    log = Path(os.environ["TAGVIO_DATA"]) / "autopilot_flights" / name
    made = alg.followed(load_scenario("along"), log, imu)
    assert 115.0 < made.frames.t_s[-1] < 121.0
    late = (made.imu.arrival_ns - made.imu.t_ns) * 1e-9
    if imu == "imu0":
        assert not late.any()
    else:  # README: arrival spacing std 2.1 and 0.5 ms, largest 13.4 and 35.9 ms
        assert 0.0 <= np.median(late) < 0.008
        assert late.min() == 0.0
        assert late.max() < 0.06
    p_m, angle = left_out(made.truth)
    assert np.percentile(p_m, 99) < 2e-4
    assert np.degrees(np.percentile(angle, 99)) < 0.01
    R_WC, p_WC = made.pose_at(made.frames.t_s)
    low, high = extent(made.tag_map)
    assert ((p_WC[:, :2] > low) & (p_WC[:, :2] < high)).all()
    assert p_WC[:, 2].min() > 0.02
    assert (R_WC[:, 2, 2] < -0.9).all()
