"""From raw IMU samples to intervals fit to integrate: faults are dropped, widened and counted."""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tagvo.geometry import Array
from vio.records import ImuSample

GAP_NS = 20_000_000  # a longer step is cut into sub-steps of the mean
DEGRADED_NS = 200_000_000
LOST_NS = 1_000_000_000
_SATURATED = 100.0  # process noise of an axis at its limit is multiplied by this
_SUB_STEP_NS = 10_000_000
_SCATTER_S = 0.5  # over which the accelerometer's scatter is judged


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Means of gyro and accel (3,) from t0_ns to t_ns, and the noise scale (6,) of their axes."""

    t0_ns: int
    t_ns: int
    gyro: Array
    accel: Array
    scale: Array


class ImuIntake:
    """Checks samples one by one; `lost` says that the last gap was too long to bridge."""

    def __init__(
        self, period_s: float, gyro_max: float, accel_max: float, vibration: float = 0.0
    ) -> None:
        """period_s: usual step; gyro_max [rad/s], accel_max [m/s^2]: limits of the axes.

        vibration: share of the accelerometer's scatter that stays in what it integrates to, over
        the accelerometer's density [1/(m/s^2/sqrt(Hz))].
        """
        self._vibration = vibration
        self._scatter, self._last_step = np.zeros(3), np.zeros(3)
        self._limit = 0.995 * np.repeat([gyro_max, accel_max], 3)
        self._period_ns = 1e9 * period_s
        self._before: ImuSample | None = None
        self._was_saturated = np.zeros(6, dtype=bool)
        self.degraded_at_ns: int | None = None
        self.counters: Counter[str] = Counter()

    def take(self, sample: ImuSample) -> tuple[list[Interval], bool]:
        """Intervals up to this sample, and whether the time before it is lost."""
        self.counters["imu"] += 1
        six = np.concatenate([sample.gyro_I, sample.accel_I])
        if not np.isfinite(six).all():
            self.counters["imu_not_finite"] += 1
            return [], False
        before = self._before
        if before is not None and sample.t_ns <= before.t_ns:
            return self._backward(sample, before)
        self._before = sample
        saturated = np.abs(six) >= self._limit
        if saturated.any():
            self.counters["imu_saturated"] += 1
        wide = saturated | self._was_saturated
        self._was_saturated = saturated
        if before is None:
            return [], False
        if sample.t_ns - before.t_ns > LOST_NS:
            self.counters["imu_lost"] += 1
            return [], True
        scale = np.where(wide, _SATURATED, 1.0)
        scale[3:] *= self._shaken(before, sample)
        return self._cut(before, sample, scale), False

    def _shaken(self, before: ImuSample, sample: ImuSample) -> Array:
        """What vibration multiplies the accelerometer's noise by; (3,).

        Second differences of white noise have six times its variance and no motion in them. A part
        of what scatters so fast stays in the integral: rectified, folded down by the sampling.
        """
        step = sample.accel_I - before.accel_I
        second, self._last_step = step - self._last_step, step
        dt = (sample.t_ns - before.t_ns) * 1e-9
        self._scatter += min(dt / _SCATTER_S, 1.0) * (second**2 / 6.0 - self._scatter)
        return np.asarray(
            1.0 + self._vibration**2 * self._scatter * min(dt, self._period_ns * 1e-9)
        )

    def _backward(self, sample: ImuSample, before: ImuSample) -> tuple[list[Interval], bool]:
        """A stamp that does not advance is dropped; after a long step back the clock restarted."""
        self.counters["imu_backward"] += 1
        if before.t_ns - sample.t_ns <= LOST_NS:
            return [], False
        self._before = sample
        return [], True

    def _cut(self, before: ImuSample, sample: ImuSample, scale: Array) -> list[Interval]:
        span = sample.t_ns - before.t_ns
        gyro, accel = sample.gyro_I, sample.accel_I
        if not sample.mean:
            gyro, accel = 0.5 * (gyro + before.gyro_I), 0.5 * (accel + before.accel_I)
        if span <= max(GAP_NS, 2.5 * self._period_ns):
            return [Interval(before.t_ns, sample.t_ns, gyro, accel, scale)]
        self.counters["imu_gap"] += 1
        if span > DEGRADED_NS:
            self.degraded_at_ns = sample.t_ns
        pieces = int(np.ceil(span / _SUB_STEP_NS))
        scale = scale * (span / self._period_ns) ** 2
        edges = [before.t_ns + span * i // pieces for i in range(pieces + 1)]
        return [Interval(a, b, gyro, accel, scale) for a, b in pairwise(edges)]
