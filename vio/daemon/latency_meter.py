"""Measures a flight at its edges: when each frame came, when its pose left, and its stamp."""

import threading
from collections import deque
from dataclasses import dataclass

import numpy as np

from vio.mavlink.messages import Outgoing

_POSES = {"VISION_POSITION_ESTIMATE": "usec", "ODOMETRY": "time_usec"}
_KEEP = 4096
_OPEN = 256  # frames whose poses may still come


@dataclass(frozen=True, slots=True)
class Figures:
    """messages: poses sent; of_frames: those at a capture; rate_hz; p50, p99: frame to message, and
    error of the stamp against the true capture [ms], None before the first."""

    messages: int
    of_frames: int
    rate_hz: float | None
    latency_ms: tuple[float, float] | None
    stamp_error_ms: tuple[float, float] | None


class Meter:
    """`frame` and `sent` from any thread; the last few thousand count for the quantiles."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open: dict[int, tuple[int, int]] = {}  # by stamp [us]: handed over, true capture
        self._latency: deque[int] = deque(maxlen=_KEEP)
        self._error: deque[int] = deque(maxlen=_KEEP)
        self._first_ns = self._last_ns = 0
        self._messages = self._of_frames = 0

    def frame(self, stamp_ns: int, handed_ns: int, capture_ns: int) -> None:
        """A frame: its stamp, when it was handed over, and when it was really captured."""
        with self._lock:
            self._open[stamp_ns // 1000] = (handed_ns, capture_ns)
            while len(self._open) > _OPEN:
                self._open.pop(next(iter(self._open)))

    def sent(self, message: Outgoing, now_ns: int) -> None:
        """A message has left."""
        field = _POSES.get(message.name)
        if field is None:
            return
        with self._lock:
            self._messages += 1
            self._first_ns = self._first_ns or now_ns
            self._last_ns = now_ns
            known = self._open.pop(message.fields[field], None)
            if known is None:
                return
            self._of_frames += 1
            self._latency.append(now_ns - known[0])
            self._error.append(abs(message.fields[field] * 1000 - known[1]))

    def figures(self) -> Figures:
        """What there is so far."""
        with self._lock:
            span, n = (self._last_ns - self._first_ns) * 1e-9, self._messages
            latency, error = list(self._latency), list(self._error)
            of_frames = self._of_frames
        rate = (n - 1) / span if span > 0.0 else None
        return Figures(n, of_frames, rate, _quantiles(latency), _quantiles(error))


def _quantiles(ns: list[int]) -> tuple[float, float] | None:
    if not ns:
        return None
    p50, p99 = np.percentile(np.array(ns) * 1e-6, [50, 99])
    return round(float(p50), 3), round(float(p99), 3)
