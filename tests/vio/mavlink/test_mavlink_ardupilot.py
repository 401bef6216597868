"""Every fault of ArduCopter's matrix that a bridge can cause: ours does not, a worse one does.

`sabotage` makes of our messages what other bridges send; the in-test autopilot then shows what a
real one was seen to do. So each test can fail.
"""

from dataclasses import replace

import numpy as np
import pytest
from fc_ardupilot import ArduPilot, JitterCorrection
from fc_autopilot import own_error
from fc_vehicle import Vehicle
from fc_world import EPOCH, MS, S, World, health, moments
from numpy import zeros

from vio.filter.health import State

VISION = "VISION_POSITION_ESTIMATE"


def world(seed=0, yaw_deg=0.0, heading_deg=0.0, latency_ms=(60.0, 60.0), config=None,
          sabotage=None, shift=None, say=None, rate_hz=30.0, delay_ms=None,
          last_s=1e9):  # fmt: skip
    rng = np.random.default_rng(seed)
    vehicle = Vehicle(np.radians(yaw_deg))
    copter = ArduPilot(vehicle, rng)
    copter.VISO_DELAY_MS = latency_ms[0] + 1 if delay_ms is None else delay_ms
    w = World(copter, rng, {"map_heading_deg": heading_deg, **(config or {})}, sabotage)
    states = moments(vehicle, rng, np.radians(heading_deg), shift=shift or (lambda t: zeros(3)),
                     say=say)  # fmt: skip
    w.see(states, rate_hz, latency_ms, last_s=last_s)
    if last_s > 1e8:
        w.feel(states)
    return w


def vision(message, **changes):
    """The message with other fields, where it is vision; as it is otherwise."""
    if message.name != VISION:
        return message
    return replace(message, fields={**message.fields, **changes})


def fly(w, target=(1.0, 0.5, -1.0), settle_s=3.0, until_s=14.0):
    """Arm, take off, step to the target; the greatest error of the estimate while it flies."""
    w.run(settle_s)
    assert w.fc.arm(w.t) is True
    w.fc.target = np.array([0.0, 0.0, -1.0])
    worst = 0.0
    for k in range(int((until_s - settle_s) * 10)):
        if k == 40:
            w.fc.target = np.array(target)
        w.run(settle_s + 0.1 * k)
        worst = max(worst, own_error(w.fc))
    return worst


def test_it_flies_where_it_is_told():
    w = world()
    worst = fly(w)
    assert worst < 0.06
    np.testing.assert_allclose(w.fc.vehicle.p, [1.0, 0.5, -1.0], atol=0.03)
    assert w.fc.rejected == []
    assert len(w.fc.resets) == 1, "the first vision, and no other"


# no origin


def test_it_arms_because_the_origin_came_before_vision_and_was_echoed():
    w = world()
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    first = next(t for t, _ in w.fc.heard[VISION])
    assert w.fc.origin_ns < first
    assert w.companion.origin.confirmed
    assert len(w.fc.heard["SET_GPS_GLOBAL_ORIGIN"]) == 1, "and not again once it was echoed"


def test_without_an_origin_it_is_refused_for_ever():
    w = world(config={"origin": None})
    w.run(5.0)
    assert w.fc.healthy(w.t)
    assert w.fc.arm(w.t) == "Arm: AHRS: waiting for home"
    assert "SET_GPS_GLOBAL_ORIGIN" not in w.fc.heard


def test_an_origin_that_gets_lost_is_sent_again_and_vision_waits():
    lost = {"SET_GPS_GLOBAL_ORIGIN": 2}

    def lossy(message, now):
        if lost.get(message.name, 0) > 0:
            lost[message.name] -= 1
            return None
        return message

    w = world(sabotage=lossy)
    w.run(4.0)
    assert w.fc.origin is not None
    assert w.fc.origin_ns > 2 * S
    assert w.fc.heard[VISION][0][0] > w.fc.origin_ns
    assert w.companion.counters["held_no_origin"] > 20


def test_an_echo_that_gets_lost_is_asked_for():
    """The second SET_GPS_GLOBAL_ORIGIN is refused without a word; a question is answered."""
    w = world()
    echo = w.fc.echo_origin
    calls = []
    w.fc.echo_origin = lambda: calls.append(w.t) if len(calls) < 2 else echo()
    calls_needed = 3
    w.run(4.0)
    assert w.companion.origin.confirmed
    assert len(calls) == calls_needed - 1


# jumps


def jump(at_s, north_m):
    return lambda t: np.array([north_m if t >= at_s * S else 0.0, 0.0, 0.0])


def flagged(at_s):
    """The filter counts its reset in the very state that has jumped."""
    return lambda t: health(resets=int(t >= at_s * S))


@pytest.mark.parametrize("north_m", [0.5, 2.0])
def test_a_jump_comes_with_the_counter_in_the_same_message(north_m):
    w = world(shift=jump(6.0, north_m), say=flagged(6.0))
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    w.fc.target = np.array([0.0, 0.0, -1.0])
    w.run(6.0)
    speed = 0.0
    for k in range(60):
        w.run(6.0 + 0.1 * k)
        speed = max(speed, abs(w.fc.vehicle.v[0]))
        assert abs(w.fc.ekf.v[0] - w.fc.vehicle.v[0]) < 0.05, "no velocity comes of a jump"
    assert [c for _, c in w.fc.resets] == [7, 8]
    assert "gate" not in [why for _, why in w.fc.rejected]
    stamps = [(f["usec"] * 1000 - EPOCH, f["reset_counter"]) for _, f in w.poses()]
    assert all((t >= 6 * S) == (c == 8) for t, c in stamps), "the first that jumped, not the next"
    assert w.fc.vehicle.p[0] == pytest.approx(-north_m, abs=0.05)  # flown back, in the new frame


def test_the_same_jump_without_the_counter_corrupts_its_velocity():
    w = world(shift=jump(6.0, 0.5), say=flagged(6.0),
              sabotage=lambda message, now: vision(message, reset_counter=7))  # fmt: skip
    w.run(3.0)
    w.fc.arm(w.t)
    w.fc.target = np.array([0.0, 0.0, -1.0])
    worst = 0.0
    for k in range(60):
        w.run(6.0 + 0.1 * k)
        worst = max(worst, abs(w.fc.ekf.v[0] - w.fc.vehicle.v[0]))
    assert worst > 0.2


# clocks


def stamp_error_ms(w, after_s=5.0):
    """FC's time of each fused pose against its true capture, in the FC's clock [ms]."""
    taken = {t: when for t, when, _ in w.fc.fused}
    errors = []
    for t, message in w.fc.heard[VISION]:
        if t in taken and t > after_s * S:
            captured = message.usec * 1000 - EPOCH
            errors.append((taken[t] - w.fc.clock(captured)) * 1e-6)
    return np.array(errors)


def test_jitter_of_60_ms_is_taken_away_by_stamps_of_capture():
    w = world(latency_ms=(20.0, 80.0), delay_ms=21)
    assert fly(w) < 0.06
    errors = stamp_error_ms(w)
    assert len(errors) > 150
    assert np.std(errors) < 4.0  # what is left is how seldom the least latency is met in order


def test_stamps_of_sending_leave_the_jitter_in():
    captured = {}

    def at_send(message, now):
        if message.name == VISION:
            captured[now // 1000] = message.fields["usec"] * 1000 - EPOCH
        return vision(message, usec=now // 1000)

    w = world(latency_ms=(20.0, 80.0), delay_ms=21, sabotage=at_send)
    fly(w)
    heard = dict(w.fc.heard[VISION])
    errors = [(when - w.fc.clock(captured[heard[t].usec])) * 1e-6
              for t, when, _ in w.fc.fused if t > 5 * S]  # fmt: skip
    assert np.std(errors) > 10.0


def test_a_step_of_the_wall_clock_is_none_of_ours(monkeypatch):
    """The bridge's core reads no clock at all: a stepping one would not even be asked."""
    import time

    def broken():
        raise AssertionError("a clock was read")

    w = world()
    for name in ("time", "time_ns", "monotonic", "monotonic_ns", "perf_counter"):
        monkeypatch.setattr(time, name, broken)
    w.run(3.0)
    assert len(w.poses()) > 80


@pytest.mark.parametrize("latency_ms", [20.0, 100.0])
def test_the_delay_to_set_is_measured(latency_ms):
    w = world(latency_ms=(latency_ms, latency_ms + 30.0))
    w.run(8.0)
    name, value = w.companion.delay_advice().split()
    assert name == "VISO_DELAY_MS"
    assert int(value) == pytest.approx(latency_ms, abs=3)


def test_with_that_delay_it_flies_better_than_with_none():
    right = fly(world(latency_ms=(100.0, 100.0), delay_ms=101), (2.0, 1.0, -1.0))
    wrong = fly(world(latency_ms=(100.0, 100.0), delay_ms=20), (2.0, 1.0, -1.0))
    assert wrong > 2.0 * right


# yaw


@pytest.mark.parametrize("heading_deg", [0, 60, 90, 180, 270])
@pytest.mark.parametrize("yaw_deg", [60, -135])
def test_it_flies_at_every_heading_of_map_and_vehicle(heading_deg, yaw_deg):
    w = world(yaw_deg=yaw_deg, heading_deg=heading_deg)
    assert fly(w, until_s=11.0) < 0.06
    np.testing.assert_allclose(w.fc.vehicle.p, [1.0, 0.5, -1.0], atol=0.06)
    assert w.fc.ekf.yaw % (2 * np.pi) == pytest.approx(np.radians(yaw_deg) % (2 * np.pi), abs=0.02)


@pytest.mark.parametrize(("yaw_deg", "away"), [(60, True), (0, False)])
def test_a_yaw_of_the_wrong_sign_flies_away_but_not_at_heading_0(yaw_deg, away):
    def negated(message, now):
        return vision(message, yaw=-message.fields["yaw"]) if message.name == VISION else message

    w = world(yaw_deg=yaw_deg, sabotage=negated)
    fly(w)
    far = np.linalg.norm(w.fc.vehicle.p - [1.0, 0.5, -1.0])
    assert far > 3.0 if away else far < 0.1


def test_a_map_turned_against_north_is_no_matter():
    """The heading in the configuration is wrong by 90 degrees: position and yaw turn together."""
    w = world(yaw_deg=30.0, heading_deg=0.0, config={"map_heading_deg": 90.0})
    fly(w)
    np.testing.assert_allclose(w.fc.ekf.p, [1.0, 0.5, -1.0], atol=0.05)  # in its own frame
    np.testing.assert_allclose(w.fc.vehicle.p, [0.5, -1.0, -1.0], atol=0.05)  # in the world


# rates, repeats, losses


@pytest.mark.parametrize("camera_hz", [3.0, 5.0, 30.0, 60.0])
def test_rates_stay_where_it_is_healthy(camera_hz):
    w = world(rate_hz=camera_hz)
    w.run(8.0)
    times = np.array([t for t, _ in w.fc.heard[VISION]])
    gaps = np.diff(times[times > 2 * S]) / MS
    assert gaps.max() < 250.0
    assert 10.0 < 1000.0 / gaps.mean() < 40.0
    assert "rate" not in [why for _, why in w.fc.rejected]


def test_a_camera_that_stalls_repeats_no_pose():
    """Peers send their last pose again at 30 Hz; ours fills in states of now, each new."""
    w = world(last_s=4.0)
    w.run(6.0)
    stamps = [f["usec"] for _, f in w.poses()]
    assert len(stamps) == len(set(stamps))
    assert np.all(np.diff(stamps) > 0)
    assert max(t for t, _ in w.poses()) < 4.2 * S, "no state, no message"


def blind(first_s, last_s):
    def say(t):
        gone = t * 1e-9 - first_s
        if gone < 0.3 or t > last_s * S:
            return health()
        return health(State.COASTING if gone < 5.0 else State.LOST)

    return say


@pytest.mark.parametrize("lost_s", [2.0, 8.0])
def test_without_tags_it_coasts_goes_silent_says_so_and_comes_back(lost_s):
    w = world(say=blind(6.0, 6.0 + lost_s))
    w.run(6.0 + lost_s + 2.0)
    times = np.array([f["usec"] * 1000 - EPOCH for _, f in w.poses()])
    quiet = times[(times > 6 * S) & (times < (6.0 + lost_s) * S)]
    first = times[times >= 6.3 * S].min()  # that coasts
    assert 0.46 * S < quiet.max() - first <= 0.5 * S
    back = times[times > (6.0 + lost_s) * S].min()
    assert back < (6.0 + lost_s + 0.1) * S
    words = [bytes(m.fields["text"]).decode() for _, m in w.sent if m.name == "STATUSTEXT"]
    assert any("coasting" in one for one in words)
    assert any("withheld" in one for one in words)
    assert words[-1] == "tagvio: tracking"


def test_coasting_is_sent_with_its_growing_covariance():
    rng = np.random.default_rng(0)
    copter = ArduPilot(Vehicle(), rng)
    w = World(copter, rng)

    def growing(t):
        coasting = max(0.0, t * 1e-9 - 3.0)
        word = health(State.COASTING if coasting else State.TRACKING)
        return moments(copter.vehicle, rng, sigma=0.05 + 0.8 * coasting, say=lambda t: word)(t)

    w.see(growing)
    w.run(4.0)
    sent = [(f["usec"] * 1000 - EPOCH, f["covariance"][0]) for _, f in w.poses()]
    late = [c for t, c in sent if t > 3 * S]
    assert len(late) == pytest.approx(15, abs=2)
    assert np.all(np.diff(late) > 0)
    assert late[-1] == pytest.approx(0.45**2, rel=0.2)


# covariance


def test_its_own_reading_of_the_covariance_is_what_we_mean():
    """sigma s on all axes comes out as 1.44 s^(4/3), by the cube root of summed squares."""
    w = world()
    w.run(2.0)
    s = 0.05
    cov = w.poses()[0][1]["covariance"]
    w.fc.VISO_POS_M_NSE = w.fc.VISO_YAW_M_NSE = 0.0
    assert w.fc.errors(cov)[0] == pytest.approx(1.44 * s ** (4 / 3), rel=0.01)
    assert w.fc.errors(cov)[1] == pytest.approx(1.44 * 0.02 ** (4 / 3), rel=0.01)
    nan = [float("nan")] * 21
    assert w.fc.errors(nan) == (0.0, 0.0)  # skipped


def test_unknown_covariance_flies_all_the_same():
    def unknown(message, now):
        return vision(message, covariance=[float("nan")] * 21)

    assert fly(world(sabotage=unknown)) < 0.06


# odometry


def test_odometry_is_taken_with_its_frame():
    w = world(config={"message": "ODOMETRY"}, yaw_deg=60.0)
    assert fly(w, until_s=11.0) < 0.06
    assert {m.frame_id for _, m in w.fc.heard["ODOMETRY"]} == {20}
    assert len(w.fc.fused) > 200


def test_odometry_in_ned_would_be_dropped_silently():
    def ned(message, now):
        wrong = message.name == "ODOMETRY"
        return replace(message, fields={**message.fields, "frame_id": 1}) if wrong else message

    w = world(config={"message": "ODOMETRY"}, sabotage=ned)
    w.run(4.0)
    assert w.fc.fused == []


def test_speed_goes_beside_the_pose():
    w = world(config={"speed": True}, yaw_deg=60.0)
    w.run(3.0)
    poses, speeds = w.poses(), w.poses("VISION_SPEED_ESTIMATE")
    assert [f["usec"] for _, f in poses] == [f["usec"] for _, f in speeds]
    assert [f["reset_counter"] for _, f in poses] == [f["reset_counter"] for _, f in speeds]


def test_the_jitter_correction_is_the_documents():
    """500 ms clamp, smallest offset, replaced every 100 messages."""
    one = JitterCorrection()
    assert one.correct(1000 * MS, 1050 * MS) == 1050 * MS
    assert one.correct(1033 * MS, 1063 * MS) == 1063 * MS  # a smaller offset: 30 ms
    assert one.correct(1066 * MS, 1186 * MS) == 1096 * MS
    assert one.correct(1000 * MS, 9000 * MS) == 8500 * MS
    for k in range(200):
        got = one.correct(k * 33 * MS, k * 33 * MS + 80 * MS)
    assert got == 199 * 33 * MS + 80 * MS, "drift: the old smallest is forgotten"
