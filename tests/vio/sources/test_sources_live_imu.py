"""The autopilot's IMU as samples: units, frames, stamps in our clock, traps named, nonsense out."""

import numpy as np
import pytest
from fc_ardupilot import ArduPilot
from fc_px4 import Px4
from fc_vehicle import Vehicle
from fc_world import EPOCH, MS, S, World
from pymavlink.dialects.v20 import ardupilotmega as m
from scipy.spatial.transform import Rotation

from vio.mavlink.codec import Codec
from vio.sources.live.imu import MavlinkImu, body_frd, trap

GYRO, FORCE = np.array([0.1, -0.25, 0.5]), np.array([0.5, -1.25, -9.75])  # body FRD
G = 9.80665


def message(name, t_us=5_000_000):
    milli = [round(x) for x in [*(FORCE / G * 1e3), *(GYRO * 1e3)]]
    made = {
        "HIGHRES_IMU": lambda: m.MAVLink_highres_imu_message(t_us, *FORCE, *GYRO, *[0] * 7, 63),
        "RAW_IMU": lambda: m.MAVLink_raw_imu_message(t_us, *milli, 0, 0, 0),
        "SCALED_IMU": lambda: m.MAVLink_scaled_imu_message(t_us // 1000, *milli, 0, 0, 0),
        "SCALED_IMU2": lambda: m.MAVLink_scaled_imu2_message(t_us // 1000, *milli, 0, 0, 0),
        "SCALED_IMU3": lambda: m.MAVLink_scaled_imu3_message(t_us // 1000, *milli, 0, 0, 0),
    }[name]()
    packed = made.pack(m.MAVLink(None, srcSystem=1, srcComponent=1))
    return Codec(1, 197).decode(bytes(packed))[0]


@pytest.mark.parametrize(
    "name", ["HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"]
)
def test_units_and_stamps_of_every_message(name):
    gyro, force, t_ns = body_frd(message(name))
    exact = name == "HIGHRES_IMU"
    np.testing.assert_allclose(gyro, GYRO, atol=1e-6 if exact else 5.1e-4)
    np.testing.assert_allclose(force, FORCE, atol=1e-6 if exact else 5.1e-4 * G)
    assert t_ns == 5 * S


def flown(kind, config=None, until_s=4.0, seed=0, R_BI=None, **keys):
    rng = np.random.default_rng(seed)
    fc = kind(Vehicle(), rng, **keys)
    w = World(fc, rng, config, with_imu=True, tick_ns=5 * MS // 2 if kind is ArduPilot else 4 * MS)
    if R_BI is not None:
        w.imu = MavlinkImu(w.companion, R_BI, w.samples.append)
    w.run(until_s)
    return w


@pytest.mark.parametrize(
    ("kind", "name"),
    [(ArduPilot, "HIGHRES_IMU"), (ArduPilot, "RAW_IMU"), (ArduPilot, "SCALED_IMU2"),
     (Px4, "HIGHRES_IMU")],
)  # fmt: skip
def test_level_and_still_is_plus_g_along_up_in_our_clock(kind, name):
    """0.1 ahead, 0.2 to the left, 9.81 up: what the in-test autopilot's body feels, as FLU."""
    w = flown(kind, {"imu": {"message": name}})
    force = np.mean([s.accel_I for s in w.samples], axis=0)
    np.testing.assert_allclose(force, [0.1, 0.2, 9.81], atol=0.01)
    late = w.samples[len(w.samples) // 2 :]
    ages = np.array([s.arrival_ns - s.t_ns for s in late]) / MS
    assert -2.0 < np.median(ages) < 4.0  # the wire takes 0.2 to 1.5 ms, TIMESYNC waits for a loop
    t = np.array([s.t_ns for s in w.samples])
    assert (np.diff(t) > 0).all()
    assert abs(t[-1] - EPOCH - 4 * S) < 20 * MS
    assert {s.mean for s in w.samples} == {kind is Px4}  # PX4's are means of increments


def test_i_in_the_body():
    """I turned in the body: the same force, written in I."""
    R_BI = Rotation.from_euler("ZYX", [90, 20, -30], degrees=True)
    w = flown(ArduPilot, R_BI=R_BI.as_matrix())
    force = np.mean([s.accel_I for s in w.samples], axis=0)
    np.testing.assert_allclose(R_BI.apply(force), [0.1, 0.2, 9.81], atol=0.01)


def test_samples_wait_for_the_clock_and_are_counted():
    w = flown(Px4, until_s=1.0)
    first = w.samples[0].arrival_ns - EPOCH
    assert first < 0.4 * S
    assert w.imu.counters["imu_clock_unknown"] < 80
    assert w.imu.counters["imu"] == len(w.samples)


@pytest.mark.parametrize("step_s", [5.0, -5.0])
def test_a_step_of_the_autopilots_clock_costs_half_a_second_and_no_wrong_stamp(step_s, caplog):
    w = flown(Px4, until_s=5.03)
    w.fc.step_ns = round(step_s * S)
    w.run(9.0)
    t = np.array([s.t_ns for s in w.samples])
    age = np.array([s.arrival_ns for s in w.samples]) - t
    assert np.abs(age).max() < 60 * MS
    assert (np.diff(t) > 0).all()
    assert np.diff(t).max() < 0.6 * S
    assert 5 < w.imu.counters["imu_off_clock"] < 150
    assert any("clock" in r.message for r in caplog.records)


def test_a_clock_that_wanders_and_runs_slow_is_followed():
    w = flown(Px4, until_s=25.0, drift=-0.004, wander=lambda t: 20e6 * np.sin(t / 4e9))
    late = [s for s in w.samples if s.arrival_ns - EPOCH > 10 * S]
    age = np.array([s.arrival_ns - s.t_ns for s in late]) / MS
    assert np.percentile(np.abs(age - np.median(age)), 95) < 3.0


def test_repeats_and_other_vehicles_are_left_out():
    w = flown(Px4, until_s=2.0)
    n = len(w.samples)
    same = message("HIGHRES_IMU", w.fc.clock(w.t) // 1000)
    for _ in range(3):
        w.imu.heard(same, w.now)
    assert len(w.samples) == n + 1
    assert w.imu.counters["imu_repeated"] == 2
    made = m.MAVLink_highres_imu_message(1, *FORCE, *GYRO, *[0] * 7, 63)
    alien = Codec(1, 197).decode(bytes(made.pack(m.MAVLink(None, srcSystem=9, srcComponent=1))))[0]
    w.imu.heard(alien, w.now)
    assert len(w.samples) == n + 1


def test_the_traps_are_named_once(caplog):
    flown(ArduPilot, until_s=1.0)
    (word,) = [r.message for r in caplog.records if "INS_GYRO_FILTER" in r.message]
    assert "11.5 ms" in word


@pytest.mark.parametrize(
    ("autopilot", "name", "says"),
    [
        (3, "HIGHRES_IMU", "when it sends"), (3, "RAW_IMU", "raw by name only"),
        (3, "SCALED_IMU2", "milliseconds"), (12, "HIGHRES_IMU", "subtracts"),
        (12, "RAW_IMU", "does not send"), (12, "SCALED_IMU2", "does not send"),
        (12, "SCALED_IMU", "no bias removed"),
    ],
)  # fmt: skip
def test_every_trap_of_both_families(autopilot, name, says):
    assert says in trap(autopilot, name)
