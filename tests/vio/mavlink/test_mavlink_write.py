"""Directly at the write: age, the stamp of sending, belief; without a socket or real time."""

import numpy as np
import pytest
from fc_world import EPOCH, MS, S, health
from pymavlink.dialects.v20 import ardupilotmega as m

from vio.config.mavlink import MavlinkConfig
from vio.filter.health import State
from vio.mavlink import bridge as edge
from vio.mavlink.belief import Belief
from vio.mavlink.bridge import Bridge
from vio.mavlink.codec import Codec
from vio.records import Moment, NavState

VISION = "VISION_POSITION_ESTIMATE"


class Wire:
    """A transport that keeps what is written; `before`, `after`: what a write stands between."""

    def __init__(self):
        self.frames, self.after, self.takes = [], (lambda: None), True

    def write(self, frame):
        if self.takes:
            self.frames.append(frame)
        self.after()
        return self.takes

    def close(self):
        pass

    def names(self):
        codec = Codec(1, 1)
        return [one.get_type() for frame in self.frames for one in codec.decode(frame)]


@pytest.fixture
def link(tmp_path, monkeypatch):
    """(bridge, wire, clock): a bridge that has met its vehicle; clock is a list of one time."""
    clock = [EPOCH]
    monkeypatch.setattr(edge, "now_ns", lambda: clock[0])
    config = {"url": "udpout:127.0.0.1:9", "state_file": str(tmp_path / "s.json"),
              "imu": {"message": "none"}, "origin": None, "speed": True}  # fmt: skip
    bridge = Bridge(MavlinkConfig.model_validate(config), np.eye(3), np.zeros(3))
    bridge._transport = wire = Wire()
    bridge._keep_on_disk()
    beat(bridge)
    yield bridge, wire, clock
    bridge.stop(farewell=False)


def beat(bridge):
    hear(bridge, m.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3), EPOCH)


def hear(bridge, message, now):
    (read,) = Codec(1, 1).decode(bytes(message.pack(m.MAVLink(None, 1, 1))))
    bridge.companion.heard(read, now)


def moment(t_ns, p=(0.0, 0.0, 1.0)):
    nav = NavState(t_ns, np.array(p), np.eye(3), np.zeros(3), np.eye(9) * 1e-4)
    return Moment(t_ns, nav, np.zeros(3), np.array([0.0, 0.0, -1.0]))


@pytest.mark.parametrize(("stopped_ms", "leaves"), [(149, True), (151, False)])
def test_a_process_that_is_stopped_before_the_write_sends_no_old_pose(
    link, monkeypatch, stopped_ms, leaves
):
    """Decided at 50 ms, SIGSTOP in between: it leaves up to max_age_s of 0.2 s, and not beyond."""
    bridge, wire, clock = link
    decided = bridge.companion.offer

    def stopped(*args):
        out = decided(*args)
        clock[0] += stopped_ms * MS
        return out

    monkeypatch.setattr(bridge.companion, "offer", stopped)
    sent = []
    bridge.watch(lambda message, at_ns: sent.append((message.name, at_ns)))
    clock[0] = EPOCH + 50 * MS
    bridge.offer(moment(EPOCH), health(), True)
    assert (VISION in wire.names()) is leaves
    assert bridge.counters["expired"] == 2 * (not leaves), "the speed is as old"
    assert bool(bridge.companion.belief._sent) is leaves
    assert {name for name, _ in sent} == ({VISION, "VISION_SPEED_ESTIMATE"} if leaves else set())


def test_the_time_of_sending_is_read_before_the_write(link):
    bridge, wire, clock = link
    wire.after = lambda: clock.__setitem__(0, clock[0] + 3 * S)  # stopped inside the write
    sent = []
    bridge.watch(lambda message, at_ns: sent.append(at_ns))
    clock[0] = EPOCH + 50 * MS
    bridge.offer(moment(EPOCH), health(), True)
    assert sent[0] == EPOCH + 50 * MS


def test_what_a_full_line_did_not_take_is_no_pose_that_the_autopilot_was_told(link):
    bridge, wire, clock = link
    wire.takes = False
    clock[0] = EPOCH + 50 * MS
    bridge.offer(moment(EPOCH), health(), True)
    assert bridge.counters["not_sent"] == 2
    assert not bridge.companion.belief._sent


def told(bridge, clock, seconds, z):
    """Poses 1 m up at 20 Hz for so long, the autopilot saying that its local z is this."""
    end = clock[0] + round(seconds * S)
    while clock[0] < end:
        clock[0] += 50 * MS
        bridge.offer(moment(clock[0] - 50 * MS), health(), True)
        told = m.MAVLink_local_position_ned_message(0, 0.0, 0.0, z, 0.0, 0.0, 0.0)
        hear(bridge, told, clock[0] - 60 * MS)


def test_belief_and_alarms_through_the_bridge(link):
    from vio.daemon.flight import _belief_figures

    bridge, _, clock = link
    assert bridge.asked(_belief_figures)[0]["state"] == "unknown"
    told(bridge, clock, 8.0, -1.0)
    assert bridge.companion.belief.state is Belief.AGREES
    told(bridge, clock, 3.0, -489.0)
    figures, alarms = bridge.asked(_belief_figures)
    assert figures == {"state": "differs", "position_m": 488.0, "yaw_deg": 0.0, "count": 1}
    assert alarms == {"belief": "autopilot differs: position by 488.00 m"}
    assert bridge.companion.counters["alarm_belief"] == 1
    bridge.alarm("setup", "set-up: camera turned")
    assert set(bridge.asked(_belief_figures)[1]) == {"belief", "setup"}
    beats = [o.fields["system_status"] for o in bridge.companion.due(clock[0] + 2 * S)
             if o.name == "HEARTBEAT"]  # fmt: skip
    assert beats == [5]
    bridge.alarm("setup", None)
    told(bridge, clock, 3.0, -1.0)
    assert bridge.asked(_belief_figures)[1] == {}


def test_no_belief_without_a_check_and_an_alarm_is_counted_once_while_it_lasts(link):
    from vio.daemon.flight import _belief_figures

    bridge, _, _ = link
    bridge.companion.belief = None
    for text in ("a", "a", "b"):
        bridge.alarm("x", text)
    figures, alarms = bridge.asked(_belief_figures)
    assert (figures["state"], alarms) == ("unknown", {"x": "b"})
    assert bridge.companion.counters["alarm_x"] == 1
    assert health().state is State.TRACKING
