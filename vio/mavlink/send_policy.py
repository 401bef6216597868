"""Which states are sent, and which are held back and why: a state machine that reads no clock."""

from collections import Counter
from dataclasses import dataclass
from enum import StrEnum

from vio.filter.health import State


class Verdict(StrEnum):
    """What becomes of an offered state; all but SEND hold it back."""

    SEND = "sent"
    NOT_STARTED = "not_started"
    HELD = "held"  # the link is not ready for it
    LOST = "lost"
    COASTED = "coasted_too_long"
    REPEAT = "not_newer"
    STALE = "too_old"
    FUTURE = "in_the_future"
    RATE = "over_rate"
    SPARE = "spare"  # one between captures where those come often enough


@dataclass(frozen=True, slots=True)
class Rules:
    """rate_hz: of the messages; max_age_ns: no older one leaves; coast_ns: how long without tags;
    at_capture: states at captures are preferred, others only fill in where they stay away;
    lost_sigma_m, lost_sigma_deg: nothing less certain leaves, whatever its state is called."""

    rate_hz: float = 30.0
    max_age_ns: int = 200_000_000
    coast_ns: int = 500_000_000
    at_capture: bool = True
    lost_sigma_m: float = float("inf")
    lost_sigma_deg: float = float("inf")

    @property
    def fill_ns(self) -> int:
        """After so long a silence another state is sent in place of one at a capture."""
        return round(2.4e9 / self.rate_hz)


_AHEAD_NS = 50_000_000  # a stamp further ahead of now is wrong
_APART_NS = 23_000_000  # ArduPilot drops what comes within 20 ms; wires jitter
_WAITS_NS = 12_000_000  # one that comes close after another waits so long at most
_ENOUGH = 0.75  # credit that a message needs: a frame rate that jitters about the rate passes whole


class SendPolicy:
    """Decides about one offered state after another; `counters` says how it went."""

    def __init__(self, rules: Rules) -> None:
        self.rules = rules
        self.counters: Counter[str] = Counter()
        self._sent_t: int | None = None  # validity of the last one sent
        self._sent_at: int | None = None  # when it was sent, or will be
        self._credit = 1.0
        self._coasts_since: int | None = None

    def decide(
        self,
        t_ns: int,
        captured: bool,
        state: State,
        now_ns: int,
        held: bool = False,
        sigma: tuple[float, float] = (0.0, 0.0),
    ) -> Verdict:
        """About a state valid at t_ns, at the capture of a frame or not; counts its verdict.

        held: nothing can be sent now, whatever it is. sigma: of the pose itself, its largest axis
        [m], [deg].
        """
        halted = self._halted(t_ns, state)
        if halted in (None, Verdict.COASTED) and self._unsure(sigma):
            halted = Verdict.LOST
        if halted is None and held:
            halted = Verdict.HELD
        verdict = halted or self._verdict(t_ns, captured, now_ns)
        self.counters[verdict.value] += 1
        return verdict

    def _unsure(self, sigma: tuple[float, float]) -> bool:
        return sigma[0] > self.rules.lost_sigma_m or sigma[1] > self.rules.lost_sigma_deg

    def leaves_at(self, now_ns: int) -> int:
        """When the next one may leave: 23 ms after the one before; asked before `decide`."""
        return now_ns if self._sent_at is None else max(now_ns, self._sent_at + _APART_NS)

    def hungry(self, now_ns: int) -> bool:
        """Whether a state that is not at a capture might be sent: asked before one is made."""
        if not self.rules.at_capture:
            return self._credit_at(now_ns) >= _ENOUGH
        return self._sent_at is not None and now_ns - self._sent_at >= self.rules.fill_ns

    def _verdict(self, t_ns: int, captured: bool, now_ns: int) -> Verdict:
        if self._sent_t is not None and t_ns <= self._sent_t:
            return Verdict.REPEAT
        leaves = self.leaves_at(now_ns)
        if leaves - t_ns > self.rules.max_age_ns:
            return Verdict.STALE
        if t_ns - now_ns > _AHEAD_NS:
            return Verdict.FUTURE
        if captured != self.rules.at_capture and (captured or not self.hungry(now_ns)):
            return Verdict.SPARE
        if leaves - now_ns > _WAITS_NS or self._credit_at(t_ns) < _ENOUGH:
            return Verdict.RATE
        self._credit = self._credit_at(t_ns) - 1.0
        self._sent_t, self._sent_at = t_ns, leaves
        return Verdict.SEND

    def _halted(self, t_ns: int, state: State) -> Verdict | None:
        """Why nothing at all is sent in this state, or None."""
        if state is State.INIT:
            return Verdict.NOT_STARTED
        if state is State.TRACKING:
            self._coasts_since = None
            return None
        if self._coasts_since is None:
            self._coasts_since = t_ns
        if state is State.LOST:
            return Verdict.LOST
        return Verdict.COASTED if t_ns - self._coasts_since > self.rules.coast_ns else None

    def _credit_at(self, t_ns: int) -> float:
        if self._sent_t is None:
            return 1.0
        return min(1.5, self._credit + (t_ns - self._sent_t) * 1e-9 * self.rules.rate_hz)
