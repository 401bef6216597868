"""Fixed-lag buffer: IMU intervals, a snapshot at each, and the measurements among them.

A measurement that comes late is inserted where it belongs; everything after it is refiltered, and
its gates decided again, inside one compiled call. So the order of arrival leaves no trace in the
history. Times are integer nanoseconds of the IMU's clock, measurement stamps of the camera's.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with applications, 2001, out-of-sequence
measurements (here without approximation: the filter is run again).
"""

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.kernels.jit import bare, njit
from vio.filter import state as at
from vio.filter.adaptive_noise import NoisePolicy, remember, trust_now
from vio.filter.measurements import constraints, corners, kinds, pose
from vio.filter.noise_model import Model, pack_model, unpack_model
from vio.filter.propagation import propagate

_FAR = np.iinfo(np.int64).max
_RATE_NS = (15_000_000, 100_000_000)
_RATE_RAD_S = 0.02  # what the gyro's noise may leave in a mean rate


class Snapshots(NamedTuple):
    """The state at the end of each IMU interval.

    t (k,) [ns]; imu (k, 12): gyro, accel and noise scale of the interval that ends there; x
    (k, NOMINAL); P (k, n, n).
    """

    t: IntArray
    imu: Array
    x: Array
    P: Array


class Rows(NamedTuple):
    """Measurements in the order of their stamps.

    stamp (m,) [ns, camera]; due (m,) [ns, IMU]: when it was applied; verdict (m,); nis (m,); z
    (m, width): the measurement, see `measurements.kinds`.
    """

    stamp: IntArray
    due: IntArray
    verdict: IntArray
    nis: Array
    z: Array


@njit
def _apply(
    x: Array, P: Array, w: Array, z: Array, t_ns: int, policy: NoisePolicy, layout: at.Layout
) -> tuple[int, float]:
    """One measurement, whatever its kind: the verdict and its NIS."""
    kind, payload = int(z[0]), z[kinds.HEAD :]
    if kind == kinds.STILL:
        return constraints.update_still(x, P, payload, policy.gate, layout)
    if kind == kinds.ROTATION:
        return constraints.update_rotation(x, P, payload, layout)
    if kind == kinds.CLOCK:
        return constraints.update_clock(x, P, payload, layout)
    if kind == kinds.OPEN:
        constraints.update_opened(P, payload)
        return kinds.ACCEPTED, 0.0
    y, trust = np.zeros(6), trust_now(x, policy, layout.pose_bias != at.OFF)
    if kind == kinds.POSE:
        verdict, nis = pose.update(x, P, w, payload, trust, y, layout)
    else:
        verdict, nis = corners.update(x, P, w, z, trust, y, layout)
    if verdict == kinds.ACCEPTED:
        remember(x, y, t_ns * 1e-9)
    return verdict, nis


@bare
def _effective(stamp: int, x: Array) -> int:
    return int(stamp + round(x[at.X_TD] * 1e9))


@bare
def _rate_span(q: at.ProcessNoise) -> float:
    """Over how long to take the mean of the gyro [ns], by its noise."""
    return float(min(max(1e9 * q.gyro / _RATE_RAD_S**2, _RATE_NS[0]), _RATE_NS[1]))


@njit
def _mean_rate(t: IntArray, imu: Array, k: int, span_ns: float) -> Array:
    """Gyro (3,) over the last span_ns up to interval k.

    It scales the time offset's column. The noise of a single sample there passes for excitation,
    and the offset is pulled to where it began with a confidence that nothing supports. A mean over
    long lags what it stands for by half of that: a vehicle that wobbles at 5 Hz turns the other way
    by then, and the offset runs off. So it is as long as the gyro's noise asks for, no longer.
    """
    total, span = np.zeros(3), 0.0
    i = k
    while i >= 1 and (i == k or t[k] - t[i] < span_ns):
        dt = float(t[i] - t[i - 1])
        total += dt * imu[i, 0:3]
        span += dt
        i -= 1
    return total / span if span > 0.0 else imu[k, 0:3].copy()


@njit
def refilter(
    span: IntArray, t: IntArray, imu: Array, x: Array, P: Array, rows: IntArray, z: Array, m: Array
) -> None:
    """Fill snapshots anew from one that stands, and apply the measurements where they fall due.

    span (4,): snapshot that stands, last one; first row, row after the last. t, imu, x, P:
    `Snapshots`; rows (3, m): stamp, due, verdict of `Rows`; z (m, 1 + width): NIS, measurement; m:
    a packed `Model`.
    """
    first, last, j, count = span[0], span[1], span[2], span[-1]
    stamp, due, verdict = rows[0], rows[1], rows[2]
    q, policy, layout = unpack_model(m)
    rate_ns = _rate_span(q)
    for k in range(first, last):
        x_k, P_k, imu_k = x[k + 1], P[k + 1], imu[k + 1]
        x_k[:] = x[k]
        P_k[:] = P[k]
        now, end = t[k], t[k + 1]
        while j < count:
            at_ns = _effective(stamp[j], x_k)
            if at_ns > end:
                break
            if at_ns > now:
                propagate(x_k, P_k, imu_k, (at_ns - now) * 1e-9, q, layout)
                now = at_ns
            due[j] = now
            w = _mean_rate(t, imu, k + 1, rate_ns)
            verdict[j], z[j, 0] = _apply(x_k, P_k, w, z[j, 1:], now, policy, layout)
            j += 1
        if end > now:
            propagate(x_k, P_k, imu_k, (end - now) * 1e-9, q, layout)
    while j < count:
        due[j] = _FAR
        verdict[j] = kinds.PENDING
        j += 1


@bare
def snapshot_before(t: IntArray, X: Array, last: int, stamp: int) -> int:
    """The last snapshot that cannot hold a measurement of this stamp; -1: none is left."""
    for k in range(last + 1):
        if _effective(stamp, X[k]) <= t[k]:
            return k - 1
    return last


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """Camera measurements that were decided, in the order of their stamps; gates as last decided.

    stamp_ns [camera], due_ns [IMU], verdict, nis: (m,).
    """

    stamp_ns: IntArray
    due_ns: IntArray
    verdict: IntArray
    nis: Array

    def with_verdict(self, *verdicts: int) -> BoolArray:
        """Which of them have one of these verdicts; (m,). (np.isin takes ten times as long.)"""
        found = self.verdict == verdicts[0]
        for verdict in verdicts[1:]:
            found |= self.verdict == verdict
        return np.asarray(found)

    def last(self, *verdicts: int) -> int:
        """Index of the newest with one of these verdicts; -1: none."""
        found = np.flatnonzero(self.with_verdict(*verdicts))
        return int(found[-1]) if found.size else -1


class History:
    """About one second of the filter that can be computed again; see `refilter`."""

    def __init__(
        self,
        sizes: tuple[int, int, int],
        model: Model,
    ) -> None:
        """sizes: snapshots and measurements that are kept at least, numbers of a measurement."""
        ticks, slots, width = sizes
        self.model, self._packed = model, pack_model(model)
        self._keep_ticks, self._keep_slots = ticks, slots
        self._span = np.zeros(4, dtype=np.int64)
        n = model.layout.n
        self.snapshots = Snapshots(
            np.zeros(2 * ticks, dtype=np.int64),
            np.zeros((2 * ticks, 12)),
            np.zeros((2 * ticks, at.NOMINAL)),
            np.zeros((2 * ticks, n, n)),
        )
        self._times = np.zeros((3, 2 * slots), dtype=np.int64)
        self._z = np.zeros((2 * slots, 1 + width))
        stamp, due, verdict = self._times
        self.rows = Rows(stamp, due, verdict, self._z[:, 0], self._z[:, 1:])
        self.rows.due[:] = _FAR
        self.last = self.count = 0  # newest snapshot; how many measurements
        self._archived: Counter[int] = Counter()
        self._floor_ns = 0  # effective time of the newest measurement that is archived

    def start(self, t_ns: int, x: Array, P: Array, again: Collection[int] = ()) -> None:
        """Forget everything and begin with this state; again: stamps that will be inserted anew."""
        twice = np.isin(self.rows.stamp[: self.count], list(again))
        anew = self.rows.verdict[: self.count][twice & self._from_camera(self.count)]
        self.archive(self.count)
        self._archived -= Counter(anew.tolist())
        self.last = self.count = 0
        self._floor_ns = t_ns
        s = self.snapshots
        s.t[0], s.x[0], s.P[0] = t_ns, x, P

    @property
    def now_ns(self) -> int:
        """Time of the newest snapshot."""
        return self.snapshots.t.item(self.last)

    @property
    def x(self) -> Array:
        """Nominal state of the newest snapshot (NOMINAL,); a view."""
        x: Array = self.snapshots.x[self.last]
        return x

    @property
    def P(self) -> Array:
        """Its covariance (n, n); a view."""
        P: Array = self.snapshots.P[self.last]
        return P

    @property
    def time_offset_ns(self) -> int:
        """t_d as the newest state has it."""
        return round(self.snapshots.x.item(self.last, at.X_TD) * 1e9)

    @property
    def waits(self) -> bool:
        """Whether a measurement lies ahead of the newest snapshot."""
        return self.count > 0 and bool(self.rows.verdict[self.count - 1] == kinds.PENDING)

    def add_interval(self, t_ns: int, w: Array, f: Array, scale: Array) -> None:
        """One IMU interval from the newest snapshot to t_ns, and what was waiting for it."""
        if self.last + 1 == len(self.snapshots.t):
            self._drop_ticks()
        k, s = self.last + 1, self.snapshots
        s.t[k] = t_ns
        s.imu[k, 0:3], s.imu[k, 3:6], s.imu[k, 6:12] = w, f, scale
        self._refilter(self.last, k, self._first_after(self.last))
        self.last = k

    def intervals_after(self, k: int) -> list[tuple[int, Array]]:
        """End [ns] and imu (12,) of each interval after snapshot k; copies."""
        s = self.snapshots
        return [(int(s.t[i]), s.imu[i].copy()) for i in range(k + 1, self.last + 1)]

    def insert(self, stamp_ns: int, z: Array) -> str:
        """Put a measurement where it belongs and refilter; why not, or an empty text."""
        rows, s = self.rows, self.snapshots
        if self.count == len(rows.stamp):
            self.archive(self.count - self._keep_slots)
        j = int(np.searchsorted(rows.stamp[: self.count], stamp_ns))
        kind, camera = z[kinds.KIND], z[kinds.CAMERA]
        while j < self.count and rows.stamp[j] == stamp_ns and rows.z[j, kinds.KIND] >= kind:
            if rows.z[j, kinds.KIND] == kind and rows.z[j, kinds.CAMERA] >= camera:
                if rows.z[j, kinds.CAMERA] == camera:
                    return "duplicate"
                break
            j += 1  # of one stamp they lie by kind and camera, however they come
        first = int(snapshot_before(s.t, s.x, self.last, stamp_ns))
        while first >= 0 and j < self.count and rows.due[j] <= s.t[first]:
            first -= 1
        if first < 0 or s.t[first] < self._floor_ns:
            return "too_old"
        for a in rows:
            a[j + 1 : self.count + 1] = a[j : self.count].copy()
        rows.stamp[j], rows.due[j], rows.verdict[j] = stamp_ns, _FAR, kinds.PENDING
        rows.z[j, : len(z)] = z
        self.count += 1
        if first < self.last:
            self._refilter(first, self.last, min(j, self._first_after(first)))
        return ""

    def _first_after(self, k: int) -> int:
        """First measurement that snapshot k does not hold."""
        due = self.rows.due[: self.count]
        return int(np.searchsorted(due, self.snapshots.t[k], side="right"))

    def _refilter(self, first: int, last: int, j: int) -> None:
        span, s = self._span, self.snapshots
        span[0], span[1], span[2], span[3] = (
            first,
            last,
            j,
            self.count,
        )  # an array, as a whole, is slow
        refilter(span, s.t, s.imu, s.x, s.P, self._times, self._z, self._packed)

    def _drop_ticks(self) -> None:
        gone = self.last + 1 - self._keep_ticks
        for a in self.snapshots:
            a[: self._keep_ticks] = a[gone : self.last + 1].copy()
        self.last -= gone

    def archive(self, number: int) -> None:
        """Forget the oldest measurements, but not what became of them."""
        self._archived += self._tally(number)
        left = self.count - number
        if number:
            self._floor_ns = max(self._floor_ns, int(self.rows.due[number - 1]))
        for a in self.rows:
            a[:left] = a[number : self.count].copy()
        self.count = left

    def verdicts(self) -> Counter[int]:
        """How many camera measurements got each verdict, gates as last decided."""
        return self._archived + self._tally(self.count)

    def judged(self) -> Judged:
        """The camera measurements in reach that were decided."""
        verdict = self.rows.verdict[: self.count]
        which = np.flatnonzero(self._from_camera(self.count) & (verdict != kinds.PENDING))
        r = self.rows
        return Judged(r.stamp[which], r.due[which], r.verdict[which], r.nis[which])

    def _from_camera(self, number: int) -> BoolArray:
        return np.asarray(self.rows.z[:number, 0] <= kinds.LAST_VISION)

    def _tally(self, number: int) -> Counter[int]:
        return Counter(self.rows.verdict[:number][self._from_camera(number)].tolist())

    def at_or_before(self, t_ns: int) -> int:
        """Index of the newest snapshot not after t_ns; -1: none."""
        return int(np.searchsorted(self.snapshots.t[: self.last + 1], t_ns, side="right")) - 1
