"""What leaves and what is held back: rates, repeats, age, coasting, filling in, by pure time."""

import numpy as np
import pytest

from vio.filter.health import State
from vio.mavlink.send_policy import Rules, SendPolicy, Verdict

MS, S = 10**6, 10**9


def offers(policy, stamps_ns, latency_ns=60 * MS, state=State.TRACKING, captured=True):
    return [policy.decide(t, captured, state, t + latency_ns) for t in stamps_ns]


def frames(rate_hz, seconds=10.0, jitter_ms=0.0, seed=0):
    t = np.arange(0, seconds, 1.0 / rate_hz) * S
    t = t + np.random.default_rng(seed).uniform(-jitter_ms, jitter_ms, len(t)) * MS
    return np.sort(t).astype(np.int64).tolist()


@pytest.mark.parametrize(
    ("camera_hz", "sent_hz"),
    [(20, 20), (25, 25), (30, 30), (40, 30), (50, 30), (60, 30), (120, 30)],
)
@pytest.mark.parametrize("jitter_ms", [0.0, 3.0])
def test_every_camera_ends_at_no_more_than_the_rate_and_loses_nothing_below(
    camera_hz, sent_hz, jitter_ms
):
    got = offers(SendPolicy(Rules(rate_hz=30.0)), frames(camera_hz, jitter_ms=jitter_ms))
    assert got.count(Verdict.SEND) == pytest.approx(10 * sent_hz, rel=0.02)


@pytest.mark.parametrize("rate_hz", [20.0, 30.0, 40.0])
def test_states_of_now_leave_at_the_rate(rate_hz):
    policy = SendPolicy(Rules(rate_hz=rate_hz, at_capture=False))
    got = offers(policy, frames(200.0), 5 * MS, captured=False)
    assert got.count(Verdict.SEND) == pytest.approx(10 * rate_hz, rel=0.02)
    assert set(got) == {Verdict.SEND, Verdict.RATE}


def test_nothing_leaves_twice_or_backwards():
    policy = SendPolicy(Rules())
    got = offers(policy, [0, 40 * MS, 40 * MS, 20 * MS, 80 * MS])
    assert got == [Verdict.SEND, Verdict.SEND, Verdict.REPEAT, Verdict.REPEAT, Verdict.SEND]


def test_nothing_older_than_200_ms_leaves_nor_from_the_future():
    policy = SendPolicy(Rules())
    assert policy.decide(0, True, State.TRACKING, 200 * MS) is Verdict.SEND
    assert policy.decide(50 * MS, True, State.TRACKING, 250 * MS + 1) is Verdict.STALE
    assert policy.decide(400 * MS, True, State.TRACKING, 300 * MS) is Verdict.FUTURE
    assert policy.decide(301 * MS, True, State.TRACKING, 300 * MS) is Verdict.SEND  # no harm done


def test_two_within_20_ms_never_leave():
    """ArduPilot would drop the second, the newer one: it waits until 23 ms have passed."""
    policy = SendPolicy(Rules())
    assert policy.decide(0, True, State.TRACKING, 60 * MS) is Verdict.SEND
    assert policy.leaves_at(79 * MS) == 83 * MS
    assert policy.decide(33 * MS, True, State.TRACKING, 79 * MS) is Verdict.SEND
    assert policy.decide(66 * MS, True, State.TRACKING, 84 * MS) is Verdict.RATE  # a burst
    assert policy.leaves_at(100 * MS) == 106 * MS
    assert policy.decide(66 * MS, True, State.TRACKING, 100 * MS) is Verdict.SEND
    assert policy.leaves_at(150 * MS) == 150 * MS


def test_frames_with_20_ms_of_jitter_in_their_latency_all_leave():
    rng, policy, known, left = np.random.default_rng(0), SendPolicy(Rules()), 0, []
    for t in frames(30):
        known = max(known + MS, t + round(rng.uniform(60, 80) * MS))
        leaves = policy.leaves_at(known)
        if policy.decide(t, True, State.TRACKING, known) is Verdict.SEND:
            left.append(leaves)
    assert len(left) == 300
    assert np.diff(left).min() >= 23 * MS


@pytest.mark.parametrize("state", [State.COASTING, State.RELOCATING])
def test_coasting_is_sent_for_half_a_second_and_then_silence(state):
    policy = SendPolicy(Rules())
    offers(policy, frames(30, 1.0))
    stamps = [S + t for t in frames(30, 2.0)]
    got = offers(policy, stamps, state=state)
    allowed = [t - stamps[0] <= 500 * MS for t in stamps]
    assert [v is Verdict.SEND for v in got] == allowed
    assert got[-1] is Verdict.COASTED
    assert policy.decide(4 * S, True, State.TRACKING, 4 * S + 60 * MS) is Verdict.SEND
    assert policy.decide(4 * S + 40 * MS, True, state, 4 * S + 100 * MS) is Verdict.SEND  # anew


def test_going_from_coasting_to_relocating_and_lost_does_not_begin_another_half_second():
    policy = SendPolicy(Rules())
    states = [State.COASTING] * 10 + [State.LOST] * 2 + [State.RELOCATING] * 30
    got = [policy.decide(k * 33 * MS, True, s, k * 33 * MS + MS) for k, s in enumerate(states)]
    assert got.count(Verdict.SEND) == 14 - 2 + 2  # 0 to 495 ms are 16 frames, two of them lost
    assert got[-1] is Verdict.COASTED
    assert got[10] is Verdict.LOST


def test_lost_and_not_started_are_silent():
    policy = SendPolicy(Rules())
    assert set(offers(policy, frames(30, 1.0), state=State.LOST)) == {Verdict.LOST}
    assert set(offers(policy, frames(30, 1.0), state=State.INIT)) == {Verdict.NOT_STARTED}


def test_without_a_single_capture_nothing_fills_in():
    policy = SendPolicy(Rules())
    assert not any(policy.hungry(now) for now in frames(200))


@pytest.mark.parametrize("camera_hz", [0.5, 3, 5, 8, 15])
def test_slow_cameras_are_filled_in_to_more_than_10_hz(camera_hz):
    """PX4 wants less than 200 ms, ArduPilot 300 ms: states of now come between the captures."""
    policy, sent = SendPolicy(Rules()), []
    captures = frames(camera_hz, 10.0)
    events = [(t + 60 * MS, t, True) for t in captures]
    events += [(t + 60 * MS, t, False) for t in frames(200)]  # as old as the captures
    for now, t, captured in sorted(events):
        asked = captured or policy.hungry(now)
        if asked and policy.decide(t, captured, State.TRACKING, now) is Verdict.SEND:
            sent.append((now, t))
    gaps = np.diff([now for now, _ in sent]) / MS
    assert gaps.max() < 100.0
    assert np.all(np.diff([t for _, t in sent]) > 0)


def test_a_camera_of_30_hz_is_never_filled_in():
    policy = SendPolicy(Rules())
    events = [(t + 60 * MS, t, True) for t in frames(30)]
    events += [(t + 60 * MS, t + MS, False) for t in frames(200)]
    for now, t, captured in sorted(events):
        verdict = policy.decide(t, captured, State.TRACKING, now)
        assert captured or verdict is Verdict.SPARE or now < 200 * MS


def test_held_states_leave_no_trace_but_coasting_goes_on():
    policy = SendPolicy(Rules())
    for k in range(20):
        t = k * 33 * MS
        assert policy.decide(t, True, State.COASTING, t + MS, held=True) in (
            Verdict.HELD, Verdict.COASTED,
        )  # fmt: skip
    assert policy.decide(700 * MS, True, State.COASTING, 701 * MS) is Verdict.COASTED
    assert policy.decide(700 * MS, True, State.TRACKING, 701 * MS) is Verdict.SEND
    assert policy.counters["held"] == 16


@pytest.mark.parametrize(("age_ms", "verdict"), [(187, Verdict.SEND), (193, Verdict.STALE)])
def test_the_age_is_that_at_which_it_will_leave_after_its_wait(age_ms, verdict):
    """It waits 12 ms of its 23: within 0.2 s when it is decided on is too old when it leaves."""
    policy = SendPolicy(Rules())
    now = 300 * MS
    assert policy.decide(now - 11 * MS - 199 * MS, True, State.TRACKING, now - 11 * MS) is (
        Verdict.SEND
    )
    assert policy.leaves_at(now) == now + 12 * MS
    policy._credit = 1.5
    assert policy.decide(now - age_ms * MS, True, State.TRACKING, now) is verdict
