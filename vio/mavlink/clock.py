"""Another computer's clock in ours, by round trips: what its stamps mean on this side.

A small Kalman filter over offset and drift: a round trip counts the less the longer it took than
the shortest of late. A clock that runs 0.4 % slow and jerks by milliseconds is followed; answers
that disagree with it are believed once four agree among themselves; one that lies in the past says
that the other side has started again.
"""

from dataclasses import dataclass, replace

import numpy as np

_WALK = 1e6  # [ns/sqrt(s)] how the offset wanders
_DRIFT = 5e-3  # of the rate, at the start
_DRIFT_WALK = 2e-4  # [1/sqrt(s)]
_FLOOR = 3e5  # [ns] sigma of the shortest round trips
_GATE = 8e6  # [ns] a misfit below this is never a step
_AGREE = 4  # answers that make a step
_WINDOW = 100  # round trips among which the shortest is sought
_PAST_NS = 500_000_000  # an answer this far in the past: the other clock has started again
_LONGEST_NS = 1_000_000_000  # round trips beyond it say nothing


@dataclass(frozen=True, slots=True)
class Exchange:
    """A question and its answer: sent and heard in our clock, their_ns in the other's."""

    sent_ns: int
    heard_ns: int
    their_ns: int

    @property
    def rtt_ns(self) -> int:
        """How long the round trip took."""
        return self.heard_ns - self.sent_ns

    @property
    def offset_ns(self) -> int:
        """Ours minus theirs, had both ways taken equally long."""
        return (self.sent_ns + self.heard_ns) // 2 - self.their_ns


@dataclass(frozen=True, slots=True)
class ClockTrack:
    """What is known of the other clock at their_ns: ours = theirs + offset_ns, drifting by rate.

    variance: of offset [ns^2], both, and rate; rtts_ns: the last round trips; doubted: answers that
    disagree (their_ns, offset_ns); epoch: how often the clock has stepped or begun anew.
    """

    their_ns: int
    offset_ns: int
    rate: float
    variance: tuple[float, float, float]
    rtts_ns: tuple[int, ...]
    doubted: tuple[tuple[int, int], ...] = ()
    epoch: int = 0


def to_ours(track: ClockTrack, their_ns: int) -> int:
    """A stamp of the other clock in ours."""
    return their_ns + track.offset_ns + round(track.rate * (their_ns - track.their_ns))


def to_theirs(track: ClockTrack, our_ns: int) -> int:
    """A stamp of ours in the other clock."""
    since = our_ns - track.offset_ns - track.their_ns
    return track.their_ns + round(since / (1.0 + track.rate))


def _begin(e: Exchange, rtts_ns: tuple[int, ...], rate: float, epoch: int) -> ClockTrack:
    spread = (_FLOOR + (e.rtt_ns - min(rtts_ns))) ** 2
    return ClockTrack(e.their_ns, e.offset_ns, rate, (spread, 0.0, _DRIFT**2), rtts_ns, (), epoch)


def learn(track: ClockTrack | None, e: Exchange) -> ClockTrack | None:
    """The track after one more exchange; an exchange that cannot be is passed over."""
    if not 0 <= e.rtt_ns <= _LONGEST_NS:
        return track
    if track is None:
        return _begin(e, (e.rtt_ns,), 0.0, 0)
    if e.their_ns < track.their_ns - _PAST_NS:
        return _begin(e, (e.rtt_ns,), 0.0, track.epoch + 1)
    rtts = (*track.rtts_ns[1 - _WINDOW :], e.rtt_ns)
    dt = max(0, e.their_ns - track.their_ns) * 1e-9
    a, b, c = track.variance
    a += 2e9 * dt * b + (1e9 * dt) ** 2 * c + _WALK**2 * dt
    b += 1e9 * dt * c
    c += _DRIFT_WALK**2 * dt
    noise = (_FLOOR + (e.rtt_ns - min(rtts))) ** 2
    expected = track.offset_ns + round(track.rate * (e.their_ns - track.their_ns))
    misfit = e.offset_ns - expected
    if abs(misfit) > max(_GATE, 5.0 * np.sqrt(a + noise)):
        return _doubt(track, e, rtts)
    ka, kb = a / (a + noise), b / (a + noise)
    return ClockTrack(
        e.their_ns,
        expected + round(ka * misfit),
        track.rate + kb * misfit,
        (a * (1.0 - ka), b * (1.0 - ka), c - kb * b),
        rtts,
        (),
        track.epoch,
    )


def _doubt(track: ClockTrack, e: Exchange, rtts: tuple[int, ...]) -> ClockTrack:
    """Keep an answer that disagrees; once enough of them agree, begin anew there."""
    doubted = (*track.doubted[1 - _AGREE :], (e.their_ns, e.offset_ns))
    offsets = [offset for _, offset in doubted]
    if len(doubted) == _AGREE and max(offsets) - min(offsets) < _GATE:
        return _begin(e, rtts, track.rate, track.epoch + 1)
    return replace(track, doubted=doubted, rtts_ns=rtts)


class Asker:
    """Remembers what was asked when, so that an answer becomes an exchange exactly once."""

    def __init__(self, keep: int = 64) -> None:
        self._open: dict[int, int] = {}
        self._keep = keep

    def ask(self, now_ns: int) -> int:
        """The stamp to put into a request."""
        self._open[now_ns] = now_ns
        while len(self._open) > self._keep:
            self._open.pop(next(iter(self._open)))
        return now_ns

    def answered(self, asked: int, their_ns: int, now_ns: int) -> Exchange | None:
        """The exchange that an answer ends; None where it answers nothing of ours."""
        sent = self._open.pop(asked, None)
        return None if sent is None else Exchange(sent, now_ns, their_ns)


_SLEW = 0.1  # a stamp may be moved by this share of the time since the one before
_JUMP_NS = 50_000_000  # beyond, it is moved at once


@dataclass(frozen=True, slots=True)
class Stamped:
    """A stamp of the other clock and what it became in ours; epoch of the track that did it."""

    their_ns: int
    our_ns: int
    epoch: int


def stamp(before: Stamped | None, track: ClockTrack, their_ns: int) -> Stamped:
    """A stamp of a stream in our clock, slewed: spacing of samples stays theirs to a tenth.

    Slewed stamps ascend as theirs do. A misfit beyond 50 ms, a gap, or a new epoch is no slewing.
    """
    target = to_ours(track, their_ns)
    if before is None or track.epoch != before.epoch:
        return Stamped(their_ns, target, track.epoch)
    step = their_ns - before.their_ns
    if not 0 < step <= 2 * _JUMP_NS:
        return Stamped(their_ns, target, track.epoch)
    kept = before.our_ns + step
    misfit = target - kept
    most = int(_SLEW * step)
    if abs(misfit) <= _JUMP_NS:
        target = kept + min(max(misfit, -most), most)
    return Stamped(their_ns, target, track.epoch)
