"""Clocks of the sensors against true time: what a stamp says of the moment it stands for."""

from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray


@dataclass(frozen=True, slots=True)
class Clock:
    """A clock that shows zero_ns at true time 0 and gains `drift` seconds a second."""

    zero_ns: int = 0
    drift: float = 0.0

    def shows(self, t_s: Array) -> IntArray:
        """What it shows at true times (n,) [s] in whole nanoseconds; (n,)."""
        return self.zero_ns + np.rint(np.asarray(t_s) * (1.0 + self.drift) * 1e9).astype(np.int64)

    def true(self, t_ns: IntArray) -> Array:
        """True time [s] at which it shows t_ns (n,); (n,)."""
        return np.asarray((t_ns - self.zero_ns) * 1e-9 / (1.0 + self.drift))


def jittered(t_ns: IntArray, sigma_s: float, rng: np.random.Generator) -> IntArray:
    """Stamps with Gaussian jitter; those that jitter past a neighbour stay so, as on real buses."""
    return t_ns + np.rint(sigma_s * 1e9 * rng.standard_normal(len(t_ns))).astype(np.int64)


def kept(n: int, drop_share: float, rng: np.random.Generator) -> BoolArray:
    """Which of n samples are not lost, each lost by itself; (n,)."""
    return np.asarray(rng.random(n) >= drop_share)


def delays(
    n: int,
    between_s: tuple[float, float],
    slow_share: float,
    slow_s: float,
    rng: np.random.Generator,
) -> Array:
    """Delays (n,) [s]: uniform in a range; a share is slow by up to slow_s more."""
    delay = rng.uniform(*between_s, size=n)
    slow = rng.random(n) < slow_share
    return np.asarray(delay + slow * rng.uniform(0.0, 1.0, size=n) * slow_s)
