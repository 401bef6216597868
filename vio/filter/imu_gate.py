"""IMU samples that cannot be true are kept out: beyond the sensor's range, or spikes within it.

A corrupt sample of right checksum, integrated once, moves the filter by metres: it is dropped,
never clamped, and the last good value of its axis held. Within the range one sample cannot tell a
spike from a blow; the next ones can, and it waits for them.
"""

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from tagvo.geometry import Array, BoolArray
from vio.records import ImuSample

_BEYOND = 1.01  # of the range: parts show up to it (2000 deg/s is 34.907), nothing above
_TIMES = 10.0  # the last second's largest deviation: no vehicle multiplies it from sample to sample
_LEAST = np.repeat([5.0, 60.0], 3)  # [rad/s, m/s^2] landings (30), hand shakes stay below it
_MOST_DROPPED = 3  # suspects in a row that are spikes; more are motion
_HOLD_NS = 15_000_000  # how long a suspect waits at most: three samples at 200 Hz
_BUCKET_NS, _BUCKETS = 100_000_000, 10  # the last second
_KNOWN = 20  # samples from which a second's spread is known


NOTHING_HELD = np.zeros(6, dtype=bool)


@dataclass(frozen=True, slots=True, eq=False)
class Gated:
    """A sample fit to integrate; held (6,): axes whose value is the last good one, gyro first.

    since_ns: of each axis (6,), the stamp of that last good value.
    """

    sample: ImuSample
    held: BoolArray
    since_ns: "np.ndarray[tuple[int, ...], np.dtype[np.int64]]"


class _Spread:
    """Mean and largest deviation of six axes over the last second, in buckets of 0.1 s."""

    def __init__(self) -> None:
        self._low = np.full((_BUCKETS, 6), np.inf)
        self._high = np.full((_BUCKETS, 6), -np.inf)
        self._sum, self._count = np.zeros((_BUCKETS, 6)), np.zeros(_BUCKETS)
        self._bucket = -1

    def add(self, t_ns: int, six: Array) -> None:
        """Take good values of all axes (6,)."""
        bucket = t_ns // _BUCKET_NS
        for stale in range(max(self._bucket + 1, bucket - _BUCKETS + 1), bucket + 1):
            k = stale % _BUCKETS
            self._low[k], self._high[k], self._sum[k], self._count[k] = np.inf, -np.inf, 0.0, 0
        self._bucket = bucket
        k = bucket % _BUCKETS
        np.minimum(self._low[k], six, out=self._low[k])
        np.maximum(self._high[k], six, out=self._high[k])
        self._sum[k] += six
        self._count[k] += 1

    def suspicious(self, six: Array) -> BoolArray:
        """Which axes (6,) lie ten times further from the mean than anything in the last second."""
        n = float(self._count.sum())
        if n < _KNOWN:
            return np.zeros(6, dtype=bool)
        mean = self._sum.sum(axis=0) / n
        peak = np.maximum(self._high.max(axis=0) - mean, mean - self._low.min(axis=0))
        return np.asarray(np.abs(six - mean) > _TIMES * peak)


class SampleGate:
    """Takes finite samples in order of their stamps; what comes out may be up to 15 ms late."""

    def __init__(self, gyro_max: float, accel_max: float, counters: Counter[str]) -> None:
        """gyro_max [rad/s], accel_max [m/s^2]: the sensor's range; counters: where it counts."""
        self._range = _BEYOND * np.repeat([gyro_max, accel_max], 3)
        self._counters = counters
        self.clear()

    def clear(self) -> None:
        """Forget all: the time before is lost."""
        self._spread = _Spread()
        self._waiting: list[tuple[ImuSample, Array, BoolArray]] = []
        self._good: Array = np.full(6, np.nan)
        self._known = False  # whether every axis has had a good value
        self._good_ns = np.zeros(6, dtype=np.int64)

    def take(self, sample: ImuSample, six: Array) -> list[Gated]:
        """The samples to integrate now, in order; six (6,): its gyro and specific force."""
        large = np.abs(six) > _LEAST
        if not self._waiting and self._known and not large.any():  # as nearly all samples are
            self._good, self._good_ns = six, np.full(6, sample.t_ns)
            self._spread.add(sample.t_ns, six)
            return [Gated(sample, NOTHING_HELD, self._good_ns)]
        beyond = np.abs(six) > self._range
        if beyond.any():
            self._counters["imu_beyond_range"] += 1
        suspect = ~beyond & large
        if suspect.any():
            suspect &= self._spread.suspicious(six)
        if not suspect.any():
            out = [self._let_in(*one, spike=True) for one in self._waiting]
            self._waiting = []
            return [*_known(out), *_known([self._let_in(sample, six, beyond, spike=False)])]
        self._waiting.append((sample, six, beyond | suspect))
        long = sample.t_ns - self._waiting[0][0].t_ns > _HOLD_NS
        if len(self._waiting) <= _MOST_DROPPED and not long:
            return []
        waiting, self._waiting = self._waiting, []
        self._counters["imu_late_suspects"] += len(waiting)
        return _known(
            [self._let_in(s, v, np.abs(v) > self._range, spike=False) for s, v, _ in waiting]
        )

    def _let_in(
        self, sample: ImuSample, six: Array, bad: BoolArray, *, spike: bool
    ) -> Gated | None:
        """A sample with its bad axes held; None while such an axis has no good value yet."""
        if spike:
            self._counters["imu_spikes"] += 1
        self._good = np.where(bad, self._good, six)
        self._good_ns = np.where(bad, self._good_ns, sample.t_ns)
        self._known = not np.isnan(self._good).any()
        if not self._known:
            return None
        if not bad.any():
            self._spread.add(sample.t_ns, six)
            return Gated(sample, NOTHING_HELD, self._good_ns)
        held = replace(sample, gyro_I=self._good[:3], accel_I=self._good[3:])
        return Gated(held, bad, self._good_ns)


def _known(samples: list[Gated | None]) -> list[Gated]:
    return [one for one in samples if one is not None]
