"""How old poses are when they leave, and the delay parameter that follows for the autopilot."""

from collections import deque
from dataclasses import dataclass

from vio.mavlink.messages import ARDUPILOT

_KEEP = 1000


@dataclass(frozen=True, slots=True)
class Ages:
    """Capture to departure of the last poses [ms]."""

    n: int
    least: float
    p50: float
    p95: float
    p99: float


class AgeMeter:
    """Collects the ages of the poses that left."""

    def __init__(self) -> None:
        self._ns: deque[int] = deque(maxlen=_KEEP)

    def add(self, age_ns: int) -> None:
        """One more pose has left."""
        self._ns.append(age_ns)

    @property
    def least_ns(self) -> int | None:
        """The least age, None before the first pose."""
        return min(self._ns, default=None)

    def ages(self) -> Ages | None:
        """The figures, None before the first pose."""
        if not self._ns:
            return None
        ms = sorted(ns * 1e-6 for ns in self._ns)
        at = [ms[min(len(ms) - 1, int(q * len(ms)))] for q in (0.5, 0.95, 0.99)]
        return Ages(len(ms), ms[0], *at)


def delay_advice(ages: Ages, one_way_ms: float, autopilot: int, synced: bool) -> str:
    """The parameter to set. ArduPilot takes the shortest latency for zero and must be told it;
    PX4 knows capture times once its TIMESYNC has converged."""
    if autopilot == ARDUPILOT:
        return f"VISO_DELAY_MS {min(250, max(0, round(ages.least + one_way_ms)))}"
    return f"EKF2_EV_DELAY {0 if synced else round(ages.p50 + one_way_ms)}"
