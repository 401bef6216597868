"""Every fault of PX4's matrix that a bridge can cause: ours does not, a worse one does."""

from dataclasses import replace

import numpy as np
import pytest
from fc_autopilot import own_error
from fc_px4 import GOOD, Px4, Timesync
from fc_vehicle import Vehicle
from fc_world import EPOCH, MS, S, World, health, moments
from numpy import zeros

VISION = "VISION_POSITION_ESTIMATE"


def world(seed=0, config=None, sabotage=None, shift=None, say=None, rate_hz=30.0, delay=(0.1, 1.0),
          yaw_deg=0.0, latency_ms=(60.0, 80.0), tick_ns=4 * MS, **keys):  # fmt: skip
    rng = np.random.default_rng(seed)
    px4 = Px4(Vehicle(np.radians(yaw_deg)), rng, **keys)
    w = World(px4, rng, config, sabotage, delay, tick_ns=tick_ns)
    states = moments(px4.vehicle, rng, shift=shift or (lambda t: zeros(3)), say=say)
    w.see(states, rate_hz, latency_ms)
    w.feel(states, 100.0)
    return w


def of(name, **changes):
    """A sabotage: these fields otherwise, in messages of this name."""

    def change(message, now):
        if message.name != name:
            return message
        made = {k: v(message.fields, now) if callable(v) else v for k, v in changes.items()}
        return replace(message, fields={**message.fields, **made})

    return change


def fly(w, until_s=12.0):
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    worst = 0.0
    for k in range(int((until_s - 3.0) * 10)):
        w.fc.target = np.array([0.0, 0.0, -1.0] if k < 40 else [1.0, 0.5, -1.0])
        w.run(3.0 + 0.1 * k)
        worst = max(worst, own_error(w.fc))
    return worst


@pytest.mark.parametrize("yaw_deg", [0, 60, -135])
def test_it_flies_where_it_is_told(yaw_deg):
    w = world(yaw_deg=yaw_deg)
    fly(w)
    np.testing.assert_allclose(w.fc.vehicle.p, [1.0, 0.5, -1.0], atol=0.06)
    assert len(w.fc.resets) == 1
    assert w.fc.origin_ns < w.fc.heard[VISION][0][0]


# TIMESYNC: answered, at once, in the clock of the stamps


def test_past_convergence_vision_is_fused_at_its_capture_time():
    """The worst trap: it works for 50 s, and stops when TIMESYNC has converged."""
    w = world(drift=-50e-6)
    w.run(54.0)
    assert w.fc.timesync.converged
    late = [(t, when) for t, when, _ in w.fc.fused if t > 52 * S]
    assert len(late) >= 55
    stamps = {t: m.usec * 1000 - EPOCH for t, m in w.fc.heard[VISION]}
    errors = [(when - w.fc.clock(stamps[t])) * 1e-6 for t, when in late]
    assert np.percentile(np.abs(errors), 99) < 3.0
    assert np.percentile(w.fc.timesync.rtts, 99) < 10 * MS
    assert w.fc.arm(w.t) is True
    assert w.companion.delay_advice() == "EKF2_EV_DELAY 0"


@pytest.mark.parametrize("other_ns", [1_795_000_000 * S, -400 * S])
def test_stamps_in_another_clock_stop_at_convergence(other_ns):
    w = world(sabotage=of(VISION, usec=lambda f, now: f["usec"] + other_ns // 1000))
    w.fc.timesync.good = GOOD - 50  # it has run for 45 s before
    w.fc.timesync.offset = None
    w.run(3.0)
    assert w.fc.arm(w.t) is True, "all is well at first"
    w.run(9.0)
    assert w.fc.timesync.converged
    assert w.fc.fused[-1][0] < 7 * S
    assert w.fc.arm(w.t) == "Preflight Fail: no valid local position estimate"


def test_answers_that_come_late_are_thrown_away():
    """Answered from a scheduler 15 ms later: it never converges."""
    one = Timesync()
    for k in range(700):
        one.answered(k * 100 * MS, k * 100 * MS + 7 * MS, k * 100 * MS + 15 * MS)
    assert not one.converged


def test_unanswered_it_fuses_at_arrival():
    w = world(sabotage=lambda m, now: None if m.name == "TIMESYNC" and m.fields["tc1"] else m)
    w.run(5.0)
    assert w.fc.timesync.good == 0
    t, when, _ = w.fc.fused[-1]
    assert when == w.fc.clock(t)


def test_send_time_stamps_are_late_by_the_whole_latency():
    captured = {}

    def at_send(fields, now):
        captured[now // 1000] = fields["usec"] * 1000 - EPOCH
        return now // 1000

    w = world(sabotage=of(VISION, usec=at_send))
    w.fc.timesync.good = GOOD - 20
    w.run(8.0)
    when = {t: stamp for t, stamp, _ in w.fc.fused}
    errors = [when[t] - w.fc.clock(captured[m.usec]) for t, m in w.fc.heard[VISION] if t in when]
    assert np.median(errors[-60:]) > 55 * MS


# messages, frames, quality


def test_quality_is_asked_of_the_message_that_has_one():
    w = world(config={"message": "ODOMETRY"})
    w.fc.EV_QMIN = 50
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    other = world()
    other.fc.EV_QMIN = 50
    other.run(3.0)
    assert other.fc.fused == []
    assert other.fc.arm(other.t) is not True


def test_odometry_arms_in_ned_and_would_not_in_frd():
    w = world(config={"message": "ODOMETRY"}, yaw_deg=60)
    fly(w, 11.0)
    np.testing.assert_allclose(w.fc.vehicle.p, [1.0, 0.5, -1.0], atol=0.06)
    assert {m.frame_id for _, m in w.fc.heard["ODOMETRY"]} == {1}
    assert "q" not in [why for _, why in w.fc.rejected]
    trap = world(config={"message": "ODOMETRY"}, sabotage=of("ODOMETRY", frame_id=20))
    trap.run(3.0)
    assert len(trap.fc.fused) > 50
    assert trap.fc.arm(trap.t) == "Preflight Fail: heading estimate not stable"


@pytest.mark.parametrize(
    "covariance", [[float("nan")] * 21, [float("nan"), *[0.01] * 20], [0.0] * 21]
)
def test_covariances_that_say_nothing_take_its_own_floor(covariance):
    w = world(sabotage=of(VISION, covariance=covariance))
    w.run(3.0)
    assert w.fc.arm(w.t) is True
    assert {sigma for _, _, sigma in w.fc.fused} == {w.fc.EVP_NOISE}


def test_our_covariance_is_used_where_it_is_above_the_floor():
    w = world()
    w.fc.EVP_NOISE = 0.01
    w.run(3.0)
    assert w.fc.fused[-1][2] == pytest.approx(0.05, rel=1e-3)


# rates


@pytest.mark.parametrize("camera_hz", [4.0, 10.0, 30.0, 90.0])
def test_intervals_stay_within_what_it_takes(camera_hz):
    """4 Hz alone would not start: 250 ms is over its 200 ms."""
    w = world(rate_hz=camera_hz)
    w.run(5.0)
    times = np.array([t for t, _ in w.fc.heard[VISION]])
    gaps = np.diff(times) / MS
    assert gaps.min() > 20.0
    assert gaps.max() < 200.0
    assert w.fc.arm(w.t) is True
    assert not {"interval", "too fast"} & {why for _, why in w.fc.rejected}


def test_4_hz_without_filling_in_is_not_fused():
    w = world(rate_hz=4.0)
    w.companion.policy.hungry = lambda now: False
    w.run(5.0)
    assert w.fc.fused == []


# jumps and losses


def test_a_jump_with_the_counter_resets_at_once():
    north = lambda t: np.array([0.5 if t >= 5 * S else 0.0, 0.0, 0.0])  # noqa: E731
    w = world(shift=north, say=lambda t: health(resets=int(t >= 5 * S)))
    w.run(3.0)
    w.fc.arm(w.t)
    w.fc.target = np.array([0.0, 0.0, -1.0])
    w.run(12.0)
    assert [c for _, c in w.fc.resets] == [7, 8]
    assert w.fc.resets[1][0] < 5.2 * S
    assert w.fc.vehicle.p[0] == pytest.approx(-0.5, abs=0.05)
    unflagged = world(shift=north, say=lambda t: health(resets=int(t >= 5 * S)),
                      sabotage=of(VISION, reset_counter=7))  # fmt: skip
    unflagged.run(3.0)
    unflagged.fc.arm(unflagged.t)
    unflagged.run(12.0)
    assert unflagged.fc.resets[1][1] == "fusion failing"
    assert unflagged.fc.resets[1][0] > 6.0 * S


def test_its_clock_may_be_slow_and_wander():
    """0.4 % slow, as its simulator: stamps are fused within its convergence's own lag."""
    w = world(drift=-0.004)
    w.fc.timesync.good = GOOD - 100
    w.run(20.0)
    assert w.fc.timesync.converged
    assert len([t for t, _, _ in w.fc.fused if t > 15 * S]) == pytest.approx(150, abs=2)
