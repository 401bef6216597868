"""The doctor in simulated time: what it gathers of in-test autopilots, good, broken and silent."""

import numpy as np
import pytest
from fc_ardupilot import ArduPilot
from fc_px4 import Px4
from fc_vehicle import Vehicle
from fc_world import EPOCH, World, moments
from pymavlink.dialects.v20 import ardupilotmega as m

from vio.doctor.checks import check
from vio.doctor.collect import Examiner
from vio.doctor.hand_test_samples import FC, SENT, HandTestSamples

S = 1_000_000_000


class Clinic(World):
    """A world with an examiner beside the companion, and other talkers on the wire."""

    def __init__(self, kind, seconds=6.0, origin=None, tick_ns=2_000_000, **keys):
        rng = np.random.default_rng(5)
        config = {"origin": origin, **keys.pop("config", {})}
        with_imu = "imu" not in config
        super().__init__(kind(Vehicle(), rng, **keys), rng, config, with_imu=with_imu,
                         tick_ns=tick_ns)  # fmt: skip
        self.seconds, self.examiner, self.talkers = seconds, None, []
        self.at(0, self._ask)

    def _ask(self):
        if self.examiner is None and self.companion.vehicle.system is not None:
            self.examiner = Examiner(self.companion, self.config, self.seconds, self.now)
        if self.examiner is not None:
            self.send(self.examiner.due(self.now))
        self.at(self.t + 5_000_000, self._ask)

    def _to_companion(self, data):
        for message in self.codec.decode(data):
            self.send(self.companion.heard(message, self.now))
            if self.examiner is not None:
                self.examiner.heard(message, self.now)

    def talk(self, message, component=191, every_s=0.05):
        """Another sender on the same link; message(now_ns of our clock) -> message."""
        mav = m.MAVLink(None, srcSystem=1, srcComponent=component)

        def say():
            self._to_companion(bytes(message(self.now).pack(mav)))
            self.at(self.t + round(every_s * S), say)

        self.at(S, say)

    def examined(self, limit_s=100.0):
        while self.examiner is None or not self.examiner.done(self.now):
            assert self.t < limit_s * S
            self.run(self.t / S + 0.25)
        return self.examiner.facts(self.now)

    def found(self):
        return {f.code: f for f in check(self.examined())}


def vision(now, age_ns=60_000_000, p=(0, 0, 0), yaw=0.0):
    return m.MAVLink_vision_position_estimate_message(
        max(0, now - age_ns) // 1000, *p, 0, 0, yaw, [0.01] * 21, 0
    )


@pytest.mark.parametrize("kind", [ArduPilot, Px4])
def test_a_good_vehicle_has_no_error_and_all_is_measured(kind):
    world = Clinic(kind, drift=1e-3, tick_ns=1_000_000, config={"timesync_hz": 20})
    facts = world.examined()
    assert {f.code for f in check(facts) if f.severity == "error"} <= {"no_origin"}
    assert facts.complete
    assert facts.autopilot == kind.kind
    assert facts.seconds == pytest.approx(6.0, abs=0.5)
    assert facts.imu_hz > 180.0
    assert 0.4 < min(facts.rtts_ms) < 9.0
    assert len(facts.rtts_ms) > 40
    expected = 1 if kind is ArduPilot else 60
    assert facts.timesync_asked == pytest.approx(expected, abs=3)
    assert facts.ekf_flags == (129 if kind is ArduPilot else 1)
    assert facts.vision is None


def test_vision_that_flows_gives_rate_age_and_advice():
    world = Clinic(ArduPilot)
    world.fc.params["VISO_DELAY_MS"] = (20, 4)
    world.talk(vision)
    found = world.found()
    facts = world.examiner.facts(world.now)
    assert facts.vision.name == "VISION_POSITION_ESTIMATE"
    assert facts.vision.rate_hz == pytest.approx(20.0, abs=0.5)
    assert min(facts.vision.ages_ms) == pytest.approx(60.0, abs=0.01)
    assert found["VISO_DELAY_MS"].change.new == pytest.approx(60, abs=6)
    assert "1/191" not in facts.responders


def test_stamps_of_another_clock_and_repeats_are_seen():
    world = Clinic(Px4)
    world.talk(lambda now: vision(now + 10**18))
    found = world.found()
    assert found["vision_clock"].severity == "error"
    world = Clinic(Px4)
    world.talk(lambda now: vision(now - now % (10 * S // 100)))
    assert world.found()["vision_repeats"]


def test_other_companions_and_other_answers_are_seen():
    world = Clinic(Px4)
    world.talk(lambda now: m.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), every_s=1.0)
    world.talk(lambda now: m.MAVLink_timesync_message(now + 5, 77), component=240)
    world.talk(lambda now: m.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3), component=190)
    found = world.found()
    assert "1/191" in found["others"].what
    assert "190" not in found["others"].what, "a ground station is no companion"
    assert "1/240" in found["two_responders"].what


def test_odometry_in_the_trap_frame():
    world = Clinic(Px4)
    nan = [float("nan")] * 21
    rest = [0, 0, 0, 0, 0, 0, nan, nan, 0, 3, 80]
    world.talk(lambda now: m.MAVLink_odometry_message(
        now // 1000, 20, 12, 0, 0, 0, [1, 0, 0, 0], *rest))  # fmt: skip
    assert "LOCAL_FRD" in world.found()["odometry_frame"].what


def test_px4_on_a_port_in_mode_normal():
    class Normal(Px4):
        ASKS = False

    assert "timesync_not_asked" in Clinic(Normal).found()


def test_the_words_and_a_range_finder():
    world = Clinic(Px4)
    world.fc.params["EKF2_RNG_CTRL"] = (1, 6)
    world.talk(lambda now: m.MAVLink_statustext_message(
        3, b"Preflight Fail: heading estimate not stable"), component=1)  # fmt: skip
    world.talk(lambda now: m.MAVLink_distance_sensor_message(0, 1, 100, 50, 0, 0, 25, 0),
               component=1)  # fmt: skip
    found = world.found()
    assert found["says"].severity == "error"
    assert found["EKF2_RNG_CTRL"].severity == "error"


def test_mavlink_1_is_seen():
    from pymavlink.dialects.v10 import ardupilotmega as v1

    world = Clinic(ArduPilot)
    old = v1.MAVLink(None, srcSystem=1, srcComponent=1)

    def send(message):
        plain = getattr(v1, f"MAVLink_{message.get_type().lower()}_message", None)
        names = plain.fieldnames if plain else ()
        values = [getattr(message, name) for name in names]
        values = [v.encode() if isinstance(v, str) else v for v in values]
        world.fc.out.append(bytes(plain(*values).pack(old)))

    world.fc.send = send
    assert world.found()["mavlink_1"].severity == "error"


def test_an_origin_and_fused_vision_are_read_from_the_autopilot():
    world = Clinic(ArduPilot, origin={})
    vehicle, rng = world.fc.vehicle, np.random.default_rng(2)
    world.see(moments(vehicle, rng), first_s=2.0)
    world.run(8.0)
    world.examiner = Examiner(world.companion, world.config, 3.0, world.now)
    facts = world.examined()
    assert facts.origin
    assert facts.ekf_flags & (8 | 16)
    codes = {f.code for f in check(facts)}
    assert not codes & {"no_origin", "ekf_waits", "ekf_no_vision"}


def test_an_autopilot_that_falls_silent_ends_it():
    world = Clinic(ArduPilot, seconds=30.0)
    world.run(4.0)
    world.up = False
    found = world.found()
    assert world.t < 12 * S
    assert found["silent"].severity == "error"


def test_a_hand_test_with_the_estimate_and_the_poses_sent():
    """The in-test PX4 flies on nothing here: its estimate is told by hand; poses have yaw wrong."""
    world = Clinic(Px4)
    world.run(3.0)
    samples = HandTestSamples(world.companion.vehicle)
    assert len(samples.questions(1)) == 2
    heading, p, t = np.radians(60.0), np.array([0.0, 0.0, -0.1]), 0
    fc = m.MAVLink(None, srcSystem=1, srcComponent=1)
    other = m.MAVLink(None, srcSystem=1, srcComponent=197)

    def settle():
        nonlocal t
        since = t + 1
        for _ in range(20):
            t += 50_000_000
            said = (
                (fc, m.MAVLink_local_position_ned_message(0, *p, 0, 0, 0)),
                (fc, m.MAVLink_attitude_message(0, 0, 0, heading, 0, 0, 0)),
                (other, vision(t + EPOCH, p=p, yaw=-heading)),
            )
            for mav, message in said:
                for decoded in world.codec.decode(bytes(message.pack(mav))):
                    samples.heard(decoded, t)
        samples.rested(since)

    settle()
    p = p + np.array([0, 0, -0.4])
    settle()
    for turn in (np.radians(85.0), 0.0):
        p = p + 0.5 * np.array([np.cos(heading), np.sin(heading), 0])
        settle()
        heading += turn
        if turn:
            settle()
    assert set(samples.rests) == {FC, SENT}
    (only,) = samples.judge()
    assert only.code == "axis_yaw"
    assert only.what.startswith(SENT)


def test_our_own_daemon_is_no_second_answerer():
    clinic = Clinic(Px4)
    clinic.talk(lambda now: m.MAVLink_timesync_message(now, 5), component=197)
    clinic.talk(lambda now: m.MAVLink_timesync_message(now, 5), component=240)
    assert clinic.examined().responders == ("1/240",)


@pytest.mark.parametrize(("yaw", "p", "differs"), [(0.0, (0, 0, 0), False), (1.6, (0, 0, 0), True),
                                                   (0.0, (0, 0, 9), True)])  # fmt: skip
def test_it_finds_that_the_autopilot_does_not_believe_the_poses(yaw, p, differs):
    clinic = Clinic(Px4, seconds=9.0)
    clinic.fc.local = lambda: np.zeros(3)
    clinic.fc.COMPASS = True
    clinic.talk(lambda now: vision(now, p=p, yaw=yaw), component=197)
    assert ("belief" in clinic.found()) is differs
