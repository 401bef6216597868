"""The other computer's clock: drift, jitter, queues, steps, restarts, outages, slewed stamps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vio.mavlink.clock import Asker, ClockTrack, Exchange, learn, stamp, to_ours, to_theirs

S, MS = 10**9, 10**6
START = 5_000 * S  # their clock is not ours


class Ends:
    """Two clocks and a way between them: theirs = START + (ours - t0) * (1 + drift) + step."""

    def __init__(self, seed=0, drift=0.0, queue_ms=(0.0, 0.0), way_ms=0.5):
        self.rng = np.random.default_rng(seed)
        self.drift, self.queue_ms, self.way_ms, self.step = drift, queue_ms, way_ms, 0

    def theirs(self, ours):
        return START + round(ours * (1.0 + self.drift)) + self.step

    def exchange(self, ours):
        """Asked at `ours`; the answer waits in their queue before its stamp is read."""
        wait = round((self.way_ms + self.rng.uniform(*self.queue_ms)) * MS)
        at = ours + wait
        return Exchange(ours, at + round(self.way_ms * MS), self.theirs(at))


def follow(ends, seconds, start=0, track=None, each_ms=100):
    for t in range(start, start + round(seconds * S), each_ms * MS):
        track = learn(track, ends.exchange(t))
    return track


def off_ms(track, ends, ours):
    """Error of a stamp that they take at `ours`."""
    return (to_ours(track, ends.theirs(ours)) - ours) * 1e-6


@pytest.mark.parametrize("drift", [0.0, 50e-6, -50e-6, -0.004])
def test_a_steady_clock_is_known_to_a_tenth_of_a_millisecond(drift):
    ends = Ends(drift=drift)
    track = follow(ends, 20)
    assert abs(off_ms(track, ends, 20 * S)) < 0.1
    assert abs(off_ms(track, ends, 21 * S)) < 0.3  # and a second on
    assert track.rate == pytest.approx(1.0 / (1.0 + drift) - 1.0, abs=2e-4)
    assert track.variance[0] < (0.4 * MS) ** 2
    assert track.epoch == 0


def test_queues_at_the_other_end_pull_it_less_than_their_mean():
    """Answers wait 0-6 ms, as ArduPilot's: midpoints are 1.5 ms off on average, the track less."""
    ends = Ends(seed=1, queue_ms=(0.0, 6.0), drift=20e-6)
    track, errors, plain = follow(ends, 20), [], []
    for t in range(20 * S, 60 * S, 100 * MS):
        e = ends.exchange(t)
        track = learn(track, e)
        errors.append(off_ms(track, ends, t))
        plain.append((ends.theirs(t) + e.offset_ns - t) * 1e-6)
    assert np.mean(plain) == pytest.approx(-1.5, abs=0.2)
    assert abs(np.mean(errors)) < 0.5 * abs(np.mean(plain))
    assert np.percentile(np.abs(errors), 95) < 1.5


def test_lone_answers_that_lie_by_20_ms_change_nothing():
    ends = Ends(seed=2)
    track, errors = follow(ends, 10), []
    for k, t in enumerate(range(10 * S, 30 * S, 100 * MS)):
        e = ends.exchange(t)
        lie = 20 * MS if k % 3 == 0 else 0
        track = learn(track, Exchange(e.sent_ns, e.heard_ns, e.their_ns - lie))
        errors.append(off_ms(track, ends, t))
    assert np.max(np.abs(errors)) < 1.0
    assert track.epoch == 0


@pytest.mark.parametrize("step_s", [5, -5, 0.07])
def test_a_step_is_believed_within_half_a_second(step_s):
    ends = Ends(seed=3)
    track = follow(ends, 20)
    ends.step = round(step_s * S)
    track = follow(ends, 0.5, 20 * S, track)
    assert abs(off_ms(track, ends, 20 * S + S // 2)) < 0.2
    assert track.epoch == 1


def test_one_answer_after_a_restart_is_enough():
    ends = Ends(drift=30e-6)
    track = follow(ends, 20)
    ends.step = -START - 20 * S + 300 * MS  # its clock begins anew
    track = learn(track, ends.exchange(21 * S))
    assert abs(off_ms(track, ends, 21 * S)) < 0.1
    assert track.epoch == 1
    track = follow(ends, 5, 21 * S, track)
    assert abs(off_ms(track, ends, 26 * S)) < 0.1


def test_ten_seconds_of_silence_are_bridged_by_the_drift():
    ends = Ends(drift=-0.004)
    track = follow(ends, 30)
    assert abs(off_ms(track, ends, 40 * S)) < 3.0  # 40 ms without
    track = follow(ends, 0.3, 40 * S, track)
    assert abs(off_ms(track, ends, 40 * S + 300 * MS)) < 0.3
    assert track.epoch == 0


def test_steps_of_4_ms_a_second_are_followed():
    """PX4's simulator: its clock stalls by 4 ms every 1.1 s."""
    ends, track, errors = Ends(), None, []
    for k, t in enumerate(range(0, 60 * S, 100 * MS)):
        ends.step -= 4 * MS if k % 11 == 0 else 0
        track = learn(track, ends.exchange(t))
        errors.append(off_ms(track, ends, t + 50 * MS))
    assert np.percentile(np.abs(errors[200:]), 95) < 2.0
    assert track.epoch == 0


def test_nonsense_is_passed_over():
    ends = Ends()
    track = follow(ends, 5)
    assert learn(track, Exchange(9 * S, 8 * S, START)) is track  # heard before it was sent
    assert learn(track, Exchange(5 * S, 7 * S, START)) is track  # two seconds on the way
    assert learn(None, Exchange(5 * S, 7 * S, START)) is None


def test_both_directions_agree():
    track = follow(Ends(drift=-0.004), 20)
    for their in range(START, START + 40 * S, 7 * S):
        assert abs(to_theirs(track, to_ours(track, their)) - their) <= 2


def test_an_answer_counts_once_and_only_to_its_own_question():
    asker = Asker(keep=3)
    asked = [asker.ask(t) for t in (10, 20, 30, 40)]
    assert asker.answered(asked[0], 5, 50) is None  # forgotten: only three are kept
    assert asker.answered(99, 5, 50) is None
    assert asker.answered(20, 5, 50) == Exchange(20, 50, 5)
    assert asker.answered(20, 5, 60) is None


@given(st.lists(st.tuples(st.integers(1, 30), st.integers(-6, 6)), min_size=2, max_size=60))
def test_slewed_stamps_ascend_and_keep_their_spacing_to_a_tenth(steps):
    """Whatever the track does within 50 ms."""
    track = ClockTrack(0, 0, 0.0, (1.0, 0.0, 1.0), (0,))
    before, their, offset = None, 0, 0
    for gap_ms, jump_ms in steps:
        their += gap_ms * MS
        offset = max(-45 * MS, min(45 * MS, offset + jump_ms * MS))
        track = ClockTrack(their, offset, 0.0, track.variance, (0,))
        made = stamp(before, track, their)
        if before is not None:
            spacing = made.our_ns - before.our_ns
            misfit = abs(to_ours(track, before.their_ns) - before.our_ns)
            assert spacing > 0
            if misfit <= 50 * MS:
                assert abs(spacing - gap_ms * MS) <= 0.1 * gap_ms * MS + 1
        before = made


def test_a_stamp_after_a_gap_a_jump_or_a_new_epoch_is_not_slewed():
    calm = ClockTrack(0, 0, 0.0, (1.0, 0.0, 1.0), (0,))
    far = ClockTrack(0, 60 * MS, 0.0, (1.0, 0.0, 1.0), (0,))
    new = ClockTrack(0, 20 * MS, 0.0, (1.0, 0.0, 1.0), (0,), (), 1)
    near = ClockTrack(0, 20 * MS, 0.0, (1.0, 0.0, 1.0), (0,))
    first = stamp(None, calm, 100 * MS)
    assert stamp(first, far, 105 * MS).our_ns == 165 * MS
    assert stamp(first, new, 105 * MS).our_ns == 125 * MS
    assert stamp(first, near, 300 * MS).our_ns == 320 * MS
    assert stamp(first, near, 105 * MS).our_ns == 105 * MS + 500_000
