"""From the link's IMU to what is sent, in simulated time: spikes, and a wrong set-up's alarm."""

import numpy as np
import pytest
from fc_world import EPOCH, MS
from flights import CAMERA, events, fly
from numpy import eye, zeros
from pymavlink.dialects.v20 import ardupilotmega as m
from simulated import grid_map

from tagvo.records import Frame
from vio.config import Config
from vio.config.mavlink import MavlinkConfig
from vio.daemon.preflight import Parts
from vio.daemon.publisher import Publisher
from vio.daemon.setup_guard import SetupGuard
from vio.daemon.time_base import FlightClock
from vio.filter.health import State
from vio.mavlink.codec import MESSAGE_IDS, Codec
from vio.mavlink.protocol import Companion
from vio.records import ImuSample
from vio.setup_check.findings import Finding
from vio.sim.sensors.simple_imu import PIXHAWK
from vio.sources.live.imu import MavlinkImu

VISION = "VISION_POSITION_ESTIMATE"


class Path:
    """MavlinkImu, Publisher and Companion in a row; its clock is what `now` says."""

    def __init__(self, blame=tuple, armed=False):
        made = {"imu": {"message": "HIGHRES_IMU"}, "origin": None, "map_heading_deg": 0.0}
        config = MavlinkConfig.model_validate(made)
        self.companion = Companion(config, eye(3), zeros(3), 7, MESSAGE_IDS)
        self.companion.resets.saved(7)
        parts = Parts(Config(), grid_map(), CAMERA, PIXHAWK, {})
        self.localizer = Publisher(parts, self, FlightClock(), blame=blame)
        self.estimator = self.localizer.filter
        self.imu = MavlinkImu(self.companion, eye(3), self.localizer.process)
        self.codec, self.out = Codec(1, 1), m.MAVLink(None, 1, 1)
        self.now, self.sent = EPOCH, []
        self.beat(armed)
        for k in range(5):
            self.now = EPOCH + 100 * MS * k
            for ask in self.companion.due(self.now):
                if ask.name == "TIMESYNC":
                    answer = m.MAVLink_timesync_message(self.now - EPOCH, ask.fields["ts1"])
                    self.hear(answer, self.now)
        self.now = EPOCH

    def beat(self, armed):
        self.hear(m.MAVLink_heartbeat_message(2, 3, 128 * armed, 0, 4, 3), self.now)

    def hear(self, message, now):
        (read,) = self.codec.decode(bytes(message.pack(self.out)))
        self.companion.heard(read, now)
        self.imu.heard(read, now)

    def wanted(self):
        return self.companion.wanted(self.now)

    def offer(self, moment, health, captured):
        if moment is None:
            self.companion.note(health, self.now)
            return
        out = self.companion.offer(moment, health, captured, self.now)
        self.companion.resets.saved(self.companion.resets.value)
        self.sent += [(one.t_ns, one.fields) for one in [*out, *self.companion.due(self.now)]
                      if one.name == VISION]  # fmt: skip

    def take(self, what, six=None):
        """An event of a simulated flight; six: what the link says instead of its six values."""
        if isinstance(what, ImuSample):
            self.now = what.arrival_ns + EPOCH
            gyro, force = np.split(np.r_[what.gyro_I, what.accel_I] if six is None else six, 2)
            flip = np.array([1.0, -1.0, -1.0])
            sample = (what.t_ns // 1000, *(flip * force), *(flip * gyro), *[0] * 7, 63)
            self.hear(m.MAVLink_highres_imu_message(*sample), self.now)
        else:
            t_ns = what.t_ns + EPOCH
            moved = type(what)(t_ns, what.p_WC, what.R_WC, what.cov, what.tag_ids)
            self.localizer.fuse(Frame(t_ns, arrival_ns=self.now), moved)


@pytest.mark.parametrize("size", [1e2, 1e4, 1e30])
def test_spikes_over_the_link_move_nothing_that_is_sent(size):
    """Each axis, one alone and three in a row at 200 Hz, half a second apart."""
    flown, path = fly("T3", 2, seconds=9.5), Path(armed=True)
    spiked = {k + j: axis for axis in range(6) for n, at in ((1, 600), (3, 700))
              for k in [at + 200 * axis] for j in range(n)}  # fmt: skip
    count = 0
    for what in events(flown):
        six = None
        if isinstance(what, ImuSample):
            six = np.r_[what.gyro_I, what.accel_I]
            if count in spiked:
                six[spiked[count]] = size
            count += 1
        path.take(what, six)
    t_s = np.array([t - EPOCH for t, _ in path.sent]) * 1e-9
    assert t_s[-1] > 9.2
    assert len(t_s) > 120
    true_p = flown.flight(t_s).p_WI * [1.0, -1.0, -1.0]
    sent_p = np.array([[f["x"], f["y"], f["z"]] for _, f in path.sent])
    assert np.linalg.norm(sent_p - true_p, axis=1).max() < 0.2
    assert "relocated" not in path.companion.resets.causes  # levelled it is without spikes, too
    assert path.estimator.health().resets == 0
    counters = path.estimator.counters
    assert counters.get("imu_beyond_range", 0) + counters.get("imu_spikes", 0) == len(spiked)


def finding(certain, code="cam_imu_rotation"):
    return Finding(code, "the camera is turned by 90 deg", 90.0, certain)


def guard(armed):
    alarms, said = [], []
    made = SetupGuard(lambda *a: alarms.append(a), lambda *a: said.append(a), lambda: armed[0])
    return made, alarms, said


def test_a_certain_finding_is_an_alarm_and_lost_only_while_disarmed():
    armed = [False]
    one, alarms, said = guard(armed)
    assert one.blame() == ()
    one.found([finding(True)])
    ((name, text),) = alarms
    assert (name, text.startswith("set-up: "), said) == ("setup", True, [])
    assert one.blame() == ("setup_cam_imu_rotation",)
    armed[0] = True
    assert one.blame() == ()
    assert one.status() == [finding(True).plain()]
    one.found([])
    assert alarms[-1] == ("setup", None)
    armed[0] = False
    assert one.blame() == ()


def test_a_finding_that_is_in_doubt_is_said_once_and_withholds_nothing():
    one, alarms, said = guard([False])
    for _ in range(3):
        one.found([finding(False)])
    assert [bad for _, bad in said] == [True]
    assert {text for _, text in alarms} == {None}
    assert one.blame() == ()


def test_blamed_the_arm_is_lost_and_sends_nothing_until_armed_is_heard():
    armed = [False]
    one, _, _ = guard(armed)
    flown, path = fly("T3", 2, seconds=3.0), Path(one.blame)
    one.found([finding(True)])
    states = set()
    for what in events(flown):
        armed[0] = path.now > EPOCH + 2_000 * MS
        path.take(what)
        states.add((armed[0], path.localizer.health.state, path.localizer.health.reasons))
    lost = {reasons for flying, state, reasons in states if state is State.LOST}
    assert {reasons[0] for reasons in lost} == {"setup_cam_imu_rotation"}
    assert State.TRACKING not in {state for flying, state, _ in states if not flying}
    assert path.localizer.health.state is State.TRACKING
    assert path.sent
    assert min(t for t, _ in path.sent) > EPOCH + 1_900 * MS
