"""Does the autopilot believe what is sent: the check alone, and against both in-test autopilots."""

import numpy as np
import pytest
from fc_ardupilot import ArduPilot
from fc_px4 import Px4
from fc_vehicle import Vehicle
from fc_world import MS, S, World, health, moments
from pymavlink.dialects.v20 import ardupilotmega as m

from vio.config.mavlink import BeliefConfig
from vio.filter.health import State
from vio.mavlink.belief import Belief, BeliefCheck, SentPose

CRITICAL, ACTIVE, TERMINATION = 5, 4, 8


def world(kind, seed=0, yaw_deg=0.0, heading_deg=0.0, **keys):
    rng = np.random.default_rng(seed)
    fc = kind(Vehicle(np.radians(yaw_deg)), rng)
    w = World(fc, rng, tick_ns=5 * MS, **keys)
    w.see(moments(fc.vehicle, rng, heading=np.radians(heading_deg)))
    return w


def texts(w):
    return b" ".join(o.fields["text"] for _, o in w.sent if o.name == "STATUSTEXT").decode()


def status(w):
    return [o.fields["system_status"] for _, o in w.sent if o.name == "HEARTBEAT"][-1]


# the whole, before take-off


def test_an_origin_that_a_ground_station_sets_is_found_and_mended():
    w = world(Px4)
    w.run(9.0)
    assert w.companion.belief.state is Belief.AGREES
    good = w.fc.origin
    w.fc.on_set_gps_global_origin(m.MAVLink_set_gps_global_origin_message(1, *good[:2], 488_000),
                                  w.t)  # fmt: skip
    n = len(w.poses())
    w.run(12.5)
    assert w.companion.belief.state is Belief.DIFFERS
    assert w.companion.belief.position_m == pytest.approx(488.0, abs=0.2)
    assert w.companion.belief.count == 1
    assert "autopilot differs: position by 48" in texts(w)
    assert status(w) == CRITICAL
    assert len(w.poses()) - n == pytest.approx(105, abs=5), "it withholds nothing"
    w.fc.origin = good
    w.run(16.0)
    assert w.companion.belief.state is Belief.AGREES
    assert (status(w), w.companion.alarms) == (ACTIVE, {})
    assert w.companion.belief.count == 1


def test_a_heading_that_is_wrong_by_90_deg_is_found_before_take_off():
    """ArduPilot with a compass: its yaw is true, the map is configured a quarter turn off."""
    w = world(ArduPilot, heading_deg=90.0)
    w.fc.COMPASS = True
    w.run(10.0)
    assert w.companion.belief.state is Belief.DIFFERS
    assert w.companion.belief.yaw_deg == pytest.approx(90.0, abs=2.0)
    assert "yaw by 90 deg" in texts(w)


@pytest.mark.parametrize("seed", range(10))
def test_it_is_silent_in_healthy_flights(seed):
    kind = (Px4, ArduPilot)[seed % 2]
    w = world(kind, seed, yaw_deg=36.0 * seed)
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    for k in range(5):
        w.fc.target = np.array([k % 2, -0.5 * k, -1.0])
        w.run(5.0 + 2.0 * k)
    belief = w.companion.belief
    assert (belief.state, belief.count) == (Belief.AGREES, 0)
    assert belief.position_m < 0.3
    assert belief.yaw_deg < 5.0


def test_null_asks_for_nothing_and_compares_nothing():
    w = world(Px4, config={"belief": None})
    w.run(6.0)
    assert w.companion.belief is None
    asked = [f.param1 for _, f in w.fc.heard["COMMAND_LONG"] if f.command == 511]
    assert not {30, 32} & set(asked)


def test_what_comes_by_itself_is_not_asked_for_and_made_slower():
    w = world(Px4)
    w.fc.streams = {30: 20 * MS, 32: 20 * MS}
    w.run(8.0)
    assert not [f for _, f in w.fc.heard.get("COMMAND_LONG", []) if f.command == 511]


# the check alone


def check(**config):
    return BeliefCheck(BeliefConfig(**config))


def play(one, seconds, position=0.0, yaw_deg=0.0, start_s=0.0, counter=7, pose_hz=20):
    """Poses along a line, and what an autopilot says 30 ms later at 5 Hz, this much off."""
    for k in range(round(seconds * pose_hz)):
        t = round((start_s + k / pose_hz) * S)
        if k % (pose_hz // 5 or 1) == 0:
            stamp = t - 13 * MS
            p = np.array([stamp / S, 0.0, position])
            one.position(stamp, p)
            one.yaw(stamp, np.pi + np.radians(yaw_deg))
        one.sent(SentPose(t, np.array([t / S, 0.0, 0.0]), np.pi), counter)


@pytest.mark.parametrize(
    ("position", "yaw_deg", "state"),
    [(0.49, 0, "agrees"), (0.51, 0, "differs"), (0, 14.9, "agrees"), (0, -15.1, "differs"),
     (0, 359, "agrees"), (float("nan"), 0, "differs")],
)  # fmt: skip
def test_limits_are_those_of_the_configuration(position, yaw_deg, state):
    one = check()
    play(one, 8.0, position, yaw_deg)
    assert one.state.value == state


def test_five_seconds_of_grace_after_the_first_pose_and_each_reset():
    one = check()
    play(one, 6.9, 9.0)
    assert one.state is Belief.UNKNOWN
    play(one, 0.6, 9.0, start_s=6.9)
    assert one.state is Belief.DIFFERS
    two = check()
    play(two, 8.0)
    play(two, 6.8, 9.0, start_s=8.0, counter=8)
    assert two.state is Belief.AGREES


def test_a_short_misfit_is_nothing_and_a_lasting_one_counts_once():
    one = check()
    play(one, 8.0)
    play(one, 1.8, 9.0, start_s=8.0)
    play(one, 3.0, start_s=9.8)
    assert (one.state, one.count) == (Belief.AGREES, 0)
    play(one, 4.0, 9.0, start_s=12.8)
    assert (one.state, one.count) == (Belief.DIFFERS, 1)
    play(one, 1.8, start_s=16.8)
    assert one.state is Belief.DIFFERS, "it clears after two seconds, not before"
    play(one, 0.8, start_s=18.6)
    assert one.state is Belief.AGREES


def test_nothing_is_known_where_no_pose_was_sent_near_it():
    one = check()
    play(one, 8.0)
    for k in range(1, 40):
        one.position(8 * S + k * S // 5, np.array([99.0, 0, 0]))
    one.sent(SentPose(17 * S, np.zeros(3), 0.0), 7)
    assert one.state is Belief.AGREES


# alarms of any kind


def test_an_alarm_is_told_once_and_makes_the_heartbeat_critical_until_it_is_cleared():
    w = world(ArduPilot)
    w.run(4.0)
    for _ in range(3):
        w.companion.alarm("setup", "the camera looks backwards")
    w.run(6.0)
    assert status(w) == CRITICAL
    assert texts(w).count("tagvio the camera looks backwards") == 1
    assert w.companion.counters["alarm_setup"] == 1
    w.companion.note(health(State.LOST), w.now)
    assert w.companion._status(w.now) == TERMINATION, "which is worse"
    w.companion.alarm("setup", None)
    w.companion.alarm("setup", None)
    w.run(8.0)
    assert status(w) == ACTIVE
    assert texts(w).count("setup: well again") == 1
