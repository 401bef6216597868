"""FIR, the paper's filter over the last five fused poses: for VO output, never for a filter."""

from collections.abc import Callable

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array

LENGTH = 5  # the paper: the last five pose estimates


def paper_taps(count: int) -> Array:
    """Uniform taps over `count` poses, oldest first: the paper gives none; lags two frames."""
    return np.full(count, 1.0 / count)


def endpoint_taps(count: int) -> Array:
    """Value at the newest pose of the line fitted through `count`: no lag at constant velocity."""
    t = np.arange(count) - 0.5 * (count - 1)
    spread = float(t @ t)
    slope = t * t[-1] / spread if spread else np.zeros(count)
    return np.asarray(1.0 / count + slope)


TAPS: dict[str, Callable[[int], Array]] = {"paper": paper_taps, "endpoint": endpoint_taps}


class Fir:
    """Owns the last poses of one VO; restarts after a gap or where time runs backwards."""

    def __init__(self, taps: str, gap_s: float) -> None:
        self._taps = TAPS[taps]
        self._gap_ns = round(gap_s * 1e9)
        self._t_ns: list[int] = []
        self._p: list[Array] = []
        self._q: list[Array] = []

    def __call__(self, t_ns: int, p: Array, R: Array) -> tuple[Array, Array]:
        """Smoothed pose at the newest stamp; p (3,), R (3, 3) -> p (3,), R (3, 3)."""
        if self._t_ns and not 0 < t_ns - self._t_ns[-1] <= self._gap_ns:
            self._t_ns, self._p, self._q = [], [], []
        self._t_ns = [*self._t_ns, t_ns][-LENGTH:]
        self._p = [*self._p, p][-LENGTH:]
        self._q = [*self._q, geo.quat_from_matrix(R)][-LENGTH:]
        taps = self._taps(len(self._p))
        q = np.array(self._q)
        q = np.where((q @ q[-1] < 0.0)[:, None], -q, q)  # signs as the newest
        return taps @ np.array(self._p), geo.matrix_from_quat(taps @ q)
