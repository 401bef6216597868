"""From raw IMU samples to intervals fit to integrate: faults are dropped, widened and counted."""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray
from vio.filter.imu_gate import NOTHING_HELD, Gated, SampleGate
from vio.filter.imu_noise import NoiseMeter
from vio.records import ImuSample

GAP_NS = 20_000_000  # a longer step is cut into sub-steps of the mean
DEGRADED_NS = 200_000_000
LOST_NS = 1_000_000_000
_SATURATED = 100.0  # process noise of an axis at its limit, or held, is multiplied by this
# A stamp further ahead waits for the next one: believed, a corrupt one of 0.99 s costs all samples
# of that time and 0.4 m; one of 0.1 s costs what a gap of 0.1 s does.
_LEAP_NS, _LEAP_PERIODS = 100_000_000, 5
_SUB_STEP_NS = 10_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Interval:
    """Means of gyro and accel (3,) from t0_ns to t_ns, and the noise scale (6,) of their axes."""

    t0_ns: int
    t_ns: int
    gyro: Array
    accel: Array
    scale: Array


class ImuIntake:
    """Checks samples one by one; `lost` says that the last gap was too long to bridge.

    meter: the IMU's noise as its samples show it.
    """

    def __init__(
        self, period_s: float, gyro_max: float, accel_max: float, meter: NoiseMeter
    ) -> None:
        """period_s: usual step; gyro_max [rad/s], accel_max [m/s^2]: limits of the axes."""
        self._limit = 0.995 * np.repeat([gyro_max, accel_max], 3)
        self._period_ns = 1e9 * period_s
        self.meter = meter
        self.degraded_at_ns: int | None = None
        self.counters: Counter[str] = Counter()
        self._gate = SampleGate(gyro_max, accel_max, self.counters)
        self._newest_ns: int | None = None  # stamp of the newest sample taken, held or not
        self._newest_arrival_ns = 0
        self._odd_ns: int | None = None  # stamp of one that came far from it
        self._ahead: ImuSample | None = None  # one whose stamp leaps: the next tells
        self._before: ImuSample | None = None
        self._was_wide: BoolArray | None = None  # axes of the sample before that were doubtful

    def take(self, sample: ImuSample) -> tuple[list[Interval], bool]:
        """Intervals that this sample completes, and whether the time before it is lost."""
        self.counters["imu"] += 1
        if not np.isfinite(_six(sample)).all():
            self.counters["imu_not_finite"] += 1
            return [], False
        out: list[Interval] = []
        doubtful = self._settled(sample)
        if doubtful is not None:
            self._newest_ns, self._newest_arrival_ns = doubtful.t_ns, doubtful.arrival_ns
            out, gone = self._integrated(doubtful)
            if gone:
                return out, True
        newest, lost = self._newest_ns, False
        if newest is not None and sample.t_ns <= newest:
            self.counters["imu_backward"] += 1
            if newest - sample.t_ns <= LOST_NS:
                return out, False
        if newest is not None and abs(sample.t_ns - newest) > LOST_NS:
            odd, self._odd_ns = self._odd_ns, sample.t_ns
            if odd is None or abs(sample.t_ns - odd) > LOST_NS:
                self.counters["imu_stamp_jump"] += 1  # one alone may be a corrupt stamp
                return out, False
            self.counters["imu_lost"] += 1  # a pause, or the clock has started anew
            lost = True
            self._forget()
        elif newest is not None and self._leaps(sample, newest):
            self._ahead = sample
            return out, False
        self._odd_ns = None
        self._newest_ns, self._newest_arrival_ns = sample.t_ns, sample.arrival_ns
        more, gone = self._integrated(sample)
        return (more if lost or gone else out + more), lost or gone

    def _leaps(self, sample: ImuSample, newest: int) -> bool:
        """Whether a stamp is ahead by more than its arrival can explain: a gap, or corrupt."""
        ahead = sample.t_ns - newest
        if ahead <= max(_LEAP_NS, _LEAP_PERIODS * self._period_ns):
            return False
        known = sample.arrival_ns != sample.t_ns  # else nobody noted when it came
        return not (known and 2 * (sample.arrival_ns - self._newest_arrival_ns) > ahead)

    def _settled(self, sample: ImuSample) -> ImuSample | None:
        """The sample that waited for what its stamp means, where this one shows it was right.

        One that falls before it shows that its stamp was corrupt: it is dropped and counted.
        """
        held, newest = self._ahead, self._newest_ns
        if held is None or newest is None or sample.t_ns <= newest:
            return None
        if sample.t_ns - held.t_ns > LOST_NS:
            return None  # this one's own stamp is no better
        self._ahead = None
        if sample.t_ns <= held.t_ns:
            self.counters["imu_stamp_jump"] += 1
            return None
        return held

    def _integrated(self, sample: ImuSample) -> tuple[list[Interval], bool]:
        """Intervals that a sample of a stamp that is believed completes; lost as in `take`."""
        out: list[Interval] = []
        for one in self._gate.take(sample, _six(sample)):
            if one.held is NOTHING_HELD:
                out += self._advance(one, None)
                continue
            held_ns = one.sample.t_ns - one.since_ns
            if held_ns.max() > LOST_NS:  # an axis has had no good value for so long
                self.counters["imu_lost"] += 1
                self._forget()
                return [], True
            out += self._advance(one, held_ns)
        return out, False

    def _forget(self) -> None:
        self._gate.clear()
        self._ahead = None
        self.meter.reset()
        self._before, self._was_wide = None, None

    def _advance(self, one: Gated, held_ns: IntArray | None) -> list[Interval]:
        """Intervals from the sample before to this one, the noise of doubtful axes widened.

        held_ns (6,): for how long each axis is held; None: none is.
        """
        before, sample = self._before, one.sample
        six = _six(sample)
        self._before = sample
        wide = np.abs(six) >= self._limit
        doubtful = bool(wide.any())
        if doubtful:
            self.counters["imu_saturated"] += 1
        if held_ns is not None:
            doubtful, wide = True, wide | one.held
        if before is None:
            self._was_wide = wide if doubtful else None
            return []
        span = sample.t_ns - before.t_ns
        if doubtful or span > 2.5 * self._period_ns:
            self.meter.reset()
        scale = self.meter.scale(six, span * 1e-9)
        if doubtful or self._was_wide is not None:
            missing = np.ones(6)
            if held_ns is not None:
                missing = (held_ns / self._period_ns) ** 2  # as of a gap so long
                if held_ns.max() > DEGRADED_NS:
                    self.degraded_at_ns = sample.t_ns
            now = wide if self._was_wide is None else wide | self._was_wide
            scale *= np.where(now, np.maximum(_SATURATED, missing), 1.0)
        self._was_wide = wide if doubtful else None
        return self._cut(before, sample, scale)

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


def _six(sample: ImuSample) -> Array:
    return np.concatenate([sample.gyro_I, sample.accel_I])
