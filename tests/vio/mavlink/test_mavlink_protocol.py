"""The companion's manners: who it talks to, what it asks for and says, resets, headings, holds."""

import logging

import numpy as np
import pytest
from fc_ardupilot import ArduPilot
from fc_px4 import Px4
from fc_vehicle import Vehicle
from fc_world import EPOCH, MS, S, World, health, moments
from pymavlink.dialects.v20 import ardupilotmega as m
from scipy.spatial.transform import Rotation

from vio.config.mavlink import MavlinkConfig
from vio.filter.health import State
from vio.mavlink.codec import MESSAGE_IDS, Codec
from vio.mavlink.protocol import Companion
from vio.mavlink.resets import ResetCounter
from vio.records import Moment, NavState


def companion(**config):
    made = MavlinkConfig.model_validate({"imu": {"message": "none"}, **config})
    return Companion(made, np.eye(3), np.zeros(3), 7, MESSAGE_IDS)


def from_fc(message, system=1, component=1):
    """A message as it is heard from an autopilot."""
    frame = message.pack(m.MAVLink(None, srcSystem=system, srcComponent=component))
    return Codec(1, 197).decode(bytes(frame))[0]


def beat(autopilot=3, system=1, component=1, armed=0):
    return from_fc(m.MAVLink_heartbeat_message(2, autopilot, armed, 0, 4, 3), system, component)


def world(kind=Px4, seed=0, yaw_deg=0.0, **keys):
    rng = np.random.default_rng(seed)
    fc = kind(Vehicle(np.radians(yaw_deg)), rng)
    w = World(fc, rng, **keys)
    w.see(moments(fc.vehicle, rng))
    return w


# heartbeat, vehicle


def test_it_beats_once_a_second_from_the_start_as_an_onboard_controller():
    w = world(ArduPilot)
    w.run(5.0)
    beats = [t for t, message in w.sent if message.name == "HEARTBEAT"]
    assert np.diff(beats) == pytest.approx([S] * (len(beats) - 1), abs=0.11 * S)
    status = [message.fields["system_status"] for _, message in w.sent
              if message.name == "HEARTBEAT"]  # fmt: skip
    assert status[0] == 1
    assert status[-1] == 4
    received = w.fc.heard["HEARTBEAT"][-1][1]
    assert (received.get_srcSystem(), received.get_srcComponent()) == (1, 197)


def test_a_filter_that_says_nothing_any_more_is_critical():
    c = companion()
    c.heard(beat(), 0)
    c.note(health(), S)
    assert c._status(S + 500 * MS) == 4
    assert c._status(3 * S) == 5


def test_only_the_first_autopilot_counts_and_no_other_component():
    c = companion()
    assert c.vehicle.heartbeat(beat(8, component=197), 0) is False
    assert c.vehicle.heartbeat(beat(3, system=9, component=190), 0) is False
    c.heard(beat(12, system=3), 0)
    c.heard(beat(3, system=4), 0)
    assert (c.vehicle.system, c.vehicle.autopilot) == (3, 12)
    assert c.heard(from_fc(m.MAVLink_timesync_message(0, 5), 4), 0) == []
    assert len(c.heard(from_fc(m.MAVLink_timesync_message(0, 5), 3), 0)) == 1


def test_a_system_that_is_named_is_waited_for():
    c = companion(system_id=4)
    c.heard(beat(12, system=3), 0)
    assert c.vehicle.system is None
    c.heard(beat(3, system=4), 0)
    assert c.vehicle.system == 4


def test_an_unknown_autopilot_is_a_fault_unless_it_is_named():
    c = companion()
    c.heard(beat(autopilot=5), 0)
    assert c.vehicle.system is None
    assert "5" in str(c.vehicle.fault)
    assert "mavlink.autopilot" in str(c.vehicle.fault)
    named = companion(autopilot="px4")
    named.heard(beat(autopilot=5), 0)
    assert (named.vehicle.system, named.vehicle.autopilot) == (1, 12)


def test_armed_is_known():
    c = companion()
    c.heard(beat(armed=128), 0)
    assert c.vehicle.armed
    c.heard(beat(armed=0), S)
    assert not c.vehicle.armed


def test_nothing_goes_out_before_an_autopilot_is_heard():
    c = companion()
    state = moments(Vehicle(), np.random.default_rng(0))
    for k in range(40):
        assert c.offer(*state(k * 33 * MS), True, EPOCH + k * 33 * MS + 60 * MS) == []
    assert c.counters["held_no_autopilot"] == 40
    assert [one.name for one in c.due(EPOCH + 2 * S)] == ["HEARTBEAT"]


# TIMESYNC


def test_timesync_is_answered_with_the_arrival_and_never_by_mistake():
    c = companion()
    c.heard(beat(12), 0)
    (answer,) = c.heard(from_fc(m.MAVLink_timesync_message(0, 1234)), 5678)
    assert answer.fields == {"tc1": 5678, "ts1": 1234}
    assert c.heard(from_fc(m.MAVLink_timesync_message(99, 42)), 5678) == []  # nobody asked
    assert c.clock is None
    assert c.counters["timesync_of_others"] == 1


def test_it_asks_at_its_rate_and_learns_the_clock():
    w = world(ArduPilot)
    w.run(6.0)
    asked = [t for t, message in w.sent if message.name == "TIMESYNC" and not message.fields["tc1"]]
    assert len(asked) == pytest.approx(60, abs=3)
    from vio.mavlink.clock import to_ours

    for t in (5 * S, 6 * S):
        assert to_ours(w.companion.clock, w.fc.clock(t)) - EPOCH == pytest.approx(t, abs=2 * MS)


# streams


def rate_of(w, since_s):
    return sum(sample.t_ns - EPOCH > since_s * S for sample in w.samples) / (w.t / S - since_s)


def test_px4_is_asked_for_400_hz_so_that_250_come():
    w = world(Px4, with_imu=True)
    w.run(5.0)
    asked = [f for _, f in w.fc.heard["COMMAND_LONG"] if f.command == 511 and f.param1 == 105]
    assert (asked[0].param1, asked[0].param2) == (105, 2500)
    assert len(asked) == 1
    assert rate_of(w, 2.0) == pytest.approx(250, rel=0.05)


def test_arducopter_is_asked_for_200_hz_and_sends_them():
    w = world(ArduPilot, with_imu=True, tick_ns=5 * MS // 2)
    w.run(4.0)
    asked = [f for _, f in w.fc.heard["COMMAND_LONG"] if f.command == 511 and f.param1 == 105]
    assert [(f.param1, f.param2) for f in asked] == [(105, 5000)]
    assert rate_of(w, 2.0) == pytest.approx(200, rel=0.02)


def test_a_rate_that_is_denied_is_named_and_asked_again_seldom(caplog):
    w = world(ArduPilot, config={"imu": {"rate_hz": 400.0}})
    w.run(20.0)
    asked = [t for t, f in w.fc.heard["COMMAND_LONG"] if f.command == 511 and f.param1 == 105]
    assert 3 <= len(asked) <= 7
    words = [r.message for r in caplog.records if "HIGHRES_IMU" in r.message]
    assert any("denied" in one for one in words)
    assert len(words) <= 4


def test_too_slow_a_stream_is_named_with_what_to_do(caplog):
    w = world(Px4, with_imu=True)
    w.fc.IMU_NS = 8_000_000  # 125 Hz is all that comes
    w.run(8.0)
    (word,) = {r.message for r in caplog.records if "comes at" in r.message}
    assert "125 Hz" in word
    assert "200 Hz are needed" in word
    assert "MAV_x_RATE" in word


# words


def words(w):
    return [bytes(message.fields["text"]).decode() for _, message in w.sent
            if message.name == "STATUSTEXT"]  # fmt: skip


def test_changes_of_state_are_said_once_and_at_most_one_a_second():
    w = world(ArduPilot)
    rng = np.random.default_rng(0)
    flicker = lambda t: health(State.COASTING if t // (40 * MS) % 2 else State.TRACKING)  # noqa: E731
    w.see(moments(w.fc.vehicle, rng, say=flicker), first_s=2.0, last_s=6.0)
    w.run(12.0)
    times = [t for t, message in w.sent if message.name == "STATUSTEXT"]
    assert np.diff(times).min() >= 0.99 * S
    assert len(times) <= 8
    assert words(w)[-1] == "tagvio: tracking"
    assert words(w)[0] == "tagvio connected to ArduPilot"


# resets


def moment(down=(0.0, 0.0, -1.0), p=(0.0, 0.0, 1.0)):
    nav = NavState(0, np.array(p), np.eye(3), np.zeros(3), np.eye(9) * 1e-4)
    return Moment(0, nav, np.zeros(3), np.array(down))


def test_the_counter_moves_with_each_kind_of_jump_and_wraps():
    one = ResetCounter(254)
    assert not one.look(moment(), State.INIT, 0)
    assert one.levelling is None
    assert not one.look(moment(), State.TRACKING, 0)
    assert not one.look(moment(), State.COASTING, 0)
    assert one.value == 254
    assert one.look(moment(), State.TRACKING, 1)  # the filter moved
    assert one.value == 255
    assert not one.look(moment(), State.TRACKING, 1)
    tilted = Rotation.from_euler("x", 0.6, degrees=True).apply([0.0, 0.0, -1.0])
    assert one.look(moment(tilted), State.TRACKING, 1)  # gravity moved by 0.6 deg
    assert one.value == 0
    assert one.causes == ["relocated", "levelled anew"]
    little = Rotation.from_euler("x", 0.9, degrees=True).apply([0.0, 0.0, -1.0])
    assert not one.look(moment(little), State.TRACKING, 1)  # 0.3 deg more
    assert one.look(moment(little), State.TRACKING, 2)  # started anew: levelled anew, one count
    assert one.value == 1
    np.testing.assert_allclose(one.levelling.R_LW @ little, [0, 0, -1], atol=1e-12)


def test_a_new_counter_waits_until_it_is_on_disk():
    c = companion(origin=None)
    c.heard(beat(), EPOCH)
    state = moments(Vehicle(), np.random.default_rng(0))

    def offer(k, resets=0):
        made, _ = state(k * 40 * MS)
        return c.offer(made, health(resets=resets), True, EPOCH + k * 40 * MS + 60 * MS)

    assert offer(0) == []
    assert c.resets.unsaved
    c.resets.saved(c.resets.value)
    assert offer(1)[0].fields["reset_counter"] == 7
    assert offer(2, resets=1) == []
    assert offer(3, resets=1) == []
    assert c.counters["held_unsaved_reset"] == 3
    c.resets.saved(8)
    assert offer(4, resets=1)[0].fields["reset_counter"] == 8


# what is not finite, what is held


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_state_that_is_not_finite_never_leaves(bad):
    c = companion(origin=None)
    c.heard(beat(), EPOCH)
    c.offer(moment(), health(), True, 60 * MS)
    c.resets.saved(7)
    assert c.offer(moment(p=(bad, 0.0, 1.0)), health(), True, 60 * MS) == []
    assert c.counters["held_not_finite"] == 1
    assert len(c.offer(moment(), health(), True, 60 * MS)) == 1


def test_without_an_echo_poses_go_after_five_seconds(caplog):
    w = world(ArduPilot)
    w.fc.on_set_gps_global_origin = lambda message, t: None
    w.run(8.0)
    assert w.poses()[0][0] == pytest.approx(5.1 * S, abs=0.3 * S)
    assert len(w.fc.heard["SET_GPS_GLOBAL_ORIGIN"]) >= 7
    assert any("refuses to arm" in r.message for r in caplog.records)


@pytest.mark.parametrize("kind", [ArduPilot, Px4])
def test_a_companion_that_starts_again_in_flight_moves_no_origin(kind):
    w = world(kind)
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    w.run(5.0)
    before, count = w.fc.origin_ns, len(w.fc.heard["SET_GPS_GLOBAL_ORIGIN"])
    w.companion = Companion(w.config, np.eye(3), np.zeros(3), 8, MESSAGE_IDS)
    w.due_t = 1 << 62
    w._wake()
    w.run(8.0)
    assert w.fc.origin_ns == before
    assert len(w.fc.heard["SET_GPS_GLOBAL_ORIGIN"]) == count
    assert w.companion.origin.confirmed
    assert w.fc.fused[-1][0] > 7.9 * S
    assert [c for _, c in w.fc.resets] == [7, 8], "and its restart is a reset"


# heading from the autopilot


@pytest.mark.parametrize("yaw_deg", [0.0, 75.0, 179.0, -120.0])
def test_the_heading_of_the_map_by_the_autopilots_yaw(yaw_deg):
    """It sees the map at an angle that nobody configured; its own yaw is taken for true."""
    rng = np.random.default_rng(0)
    fc = ArduPilot(Vehicle(np.radians(yaw_deg)), rng)
    w = World(fc, rng, {"map_heading_deg": "fc"})
    w.see(moments(fc.vehicle, rng, heading=np.radians(33.0)))
    w.run(6.0)
    assert w.companion.heading.rad == pytest.approx(np.radians(33.0), abs=0.02)
    assert len(w.poses()) > 60
    sent = w.poses()[-1][1]["yaw"]
    assert np.cos(sent - np.radians(yaw_deg)) > 0.999
    assert w.companion.counters["held_no_heading"] > 20


def test_an_autopilots_yaw_that_wanders_is_not_taken():
    rng = np.random.default_rng(0)
    fc = ArduPilot(Vehicle(), rng)
    fc.compass = lambda: rng.uniform(-1.0, 1.0)
    w = World(fc, rng, {"map_heading_deg": "fc"})
    w.see(moments(fc.vehicle, rng))
    w.run(5.0)
    assert w.companion.heading.rad is None
    assert w.poses() == []


def test_levels_of_log_are_for_reading(caplog):
    caplog.set_level(logging.INFO)
    w = world(ArduPilot)
    w.run(2.0)
    text = " ".join(r.message for r in caplog.records)
    assert "ArduPilot, system 1, is there" in text
    assert "origin 47.3977420, 8.5455940 confirmed" in text
