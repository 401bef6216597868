"""The filter's memory: IMU intervals, a snapshot at each, and the measurements among them.

A measurement that comes late is put where it belongs; everything after it is computed again, and
its gates decided again, inside one compiled call. So the order of arrival leaves no trace in the
history. Times are integer nanoseconds of the IMU's clock, measurement stamps of the camera's.
"""

from collections import Counter
from collections.abc import Collection

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.kernels.jit import bare, njit
from vio.filter import state as at
from vio.filter.adaptive_noise import inflation, remember, slow_share
from vio.filter.measurements.corners import correct_corners
from vio.filter.propagation import propagate
from vio.filter.update import correct_clock, correct_pose, correct_rig, correct_still

_FAR = np.iinfo(np.int64).max
_RATE_NS = (15_000_000, 100_000_000)
_RATE_RAD_S = 0.02  # what the gyro's noise may leave in a mean rate


@njit
def _apply(x: Array, P: Array, w: Array, z: Array, par: Array, t_ns: int) -> tuple[int, float]:
    """One measurement, whatever its kind: the verdict and its NIS."""
    kind = int(z[0])
    if kind == at.M_STILL:
        return correct_still(x, P, z[2], par[1])
    if kind == at.M_RIG:
        return correct_rig(x, P, z[2:])
    if kind == at.M_CLOCK:
        return correct_clock(x, P, z[2], z[3])
    if kind == at.M_OPEN:
        for i in range(int(z[3]), int(z[3] + z[4])):
            P[i, i] += z[2]
        return at.ACCEPTED, 0.0
    n, y = P.shape[0], np.zeros(6)
    trust = inflation(x, par, n), *slow_share(x, par, n)
    if kind == at.M_POSE:
        verdict, nis = correct_pose(x, P, w, z[2:], trust, par[1], y)
    else:
        k = int(z[1])
        tags = z[2 : 2 + k * at.TAG_NUMBERS].reshape((k, at.TAG_NUMBERS))
        verdict, nis = correct_corners(x, P, w, tags, trust, par[1], y)
    if verdict == at.ACCEPTED:
        remember(x, y, t_ns * 1e-9)
    return verdict, nis


@bare
def _effective(stamp: int, x: Array) -> int:
    return int(stamp + round(x[at.X_TD] * 1e9))


@bare
def _rate_span(q: Array) -> float:
    """Over how long to take the mean of the gyro [ns], by its noise in q (NOISE,)."""
    return float(min(max(1e9 * q[at.N_GYRO] / _RATE_RAD_S**2, _RATE_NS[0]), _RATE_NS[1]))


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
def walk(
    first: int, last: int, j: int, count: int, t: IntArray, imu: Array, X: Array, P: Array,
    m_t: IntArray, m_at: IntArray, m_state: IntArray, m_nis: Array, m_z: Array,
    q: Array, par: Array,
) -> None:  # fmt: skip
    """Fill the snapshots first+1..last from snapshot `first`, applying measurements from j on.

    t (k,), imu (k, 12): end of each interval, its gyro, accel and noise scale; X, P snapshots;
    m_*: stamps in order, effective times, verdicts, NIS and payloads; par: see
    `vio.memory.inflation`.
    """
    span_ns = _rate_span(q)
    for k in range(first, last):
        x, C = X[k + 1], P[k + 1]
        x[:] = X[k]
        C[:] = P[k]
        now, end = t[k], t[k + 1]
        rates = imu[k + 1]
        while j < count:
            due = _effective(m_t[j], x)
            if due > end:
                break
            if due > now:
                propagate(x, C, rates, (due - now) * 1e-9, q)
                now = due
            m_at[j] = now
            m_state[j], m_nis[j] = _apply(
                x, C, _mean_rate(t, imu, k + 1, span_ns), m_z[j], par, now
            )
            j += 1
        if end > now:
            propagate(x, C, rates, (end - now) * 1e-9, q)
    while j < count:
        m_at[j] = _FAR
        m_state[j] = at.PENDING
        j += 1


@bare
def snapshot_before(t: IntArray, X: Array, last: int, stamp: int) -> int:
    """The last snapshot that cannot hold a measurement of this stamp; -1: none is left."""
    for k in range(last + 1):
        if _effective(stamp, X[k]) <= t[k]:
            return k - 1
    return last


class Window:
    """About one second of history that can be computed again; see `walk`."""

    def __init__(self, n: int, ticks: int, slots: int, width: int, q: Array, par: Array) -> None:
        self.q, self.par = q, par
        self._keep_ticks, self._keep_slots = ticks, slots
        self.t = np.zeros(2 * ticks, dtype=np.int64)
        self.imu = np.zeros((2 * ticks, 12))
        self.X = np.zeros((2 * ticks, at.NOMINAL))
        self.P = np.zeros((2 * ticks, n, n))
        self.m_t = np.zeros(2 * slots, dtype=np.int64)
        self.m_at = np.full(2 * slots, _FAR, dtype=np.int64)
        self.m_state = np.zeros(2 * slots, dtype=np.int64)
        self.m_nis = np.zeros(2 * slots)
        self.m_z = np.zeros((2 * slots, width))
        self.last = self.count = 0
        self.archived: Counter[int] = Counter()
        self._floor_ns = 0  # effective time of the newest measurement that is archived

    def start(self, t_ns: int, x: Array, P: Array, again: Collection[int] = ()) -> None:
        """Forget everything and begin with this state; again: stamps that will be inserted anew."""
        twice = np.isin(self.m_t[: self.count], list(again))
        rows = self.m_state[: self.count][twice & (self.m_z[: self.count, 0] <= at.M_CORNERS)]
        self.archive(self.count)
        self.archived -= Counter(rows.tolist())
        self.last = self.count = 0
        self._floor_ns = t_ns
        self.t[0], self.X[0], self.P[0] = t_ns, x, P

    @property
    def now_ns(self) -> int:
        """Time of the newest snapshot."""
        return int(self.t[self.last])

    def add_interval(self, t_ns: int, w: Array, f: Array, scale: Array) -> None:
        """One IMU interval from the newest snapshot to t_ns, and what was waiting for it."""
        if self.last + 1 == len(self.t):
            self._drop_ticks()
        k = self.last + 1
        self.t[k] = t_ns
        self.imu[k, 0:3], self.imu[k, 3:6], self.imu[k, 6:12] = w, f, scale
        self._walk(self.last, k, self._first_after(self.last))
        self.last = k

    def insert(self, stamp_ns: int, z: Array) -> str:
        """Put a measurement where it belongs and compute again; why not, or an empty text."""
        if self.count == len(self.m_t):
            self.archive(self.count - self._keep_slots)
        j = int(np.searchsorted(self.m_t[: self.count], stamp_ns))
        if j < self.count and self.m_t[j] == stamp_ns and self.m_z[j, 0] == z[0]:
            return "duplicate"
        first = int(snapshot_before(self.t, self.X, self.last, stamp_ns))
        while first >= 0 and j < self.count and self.m_at[j] <= self.t[first]:
            first -= 1
        if first < 0 or self.t[first] < self._floor_ns:
            return "too_old"
        for a in (self.m_t, self.m_at, self.m_state, self.m_nis, self.m_z):
            a[j + 1 : self.count + 1] = a[j : self.count].copy()
        self.m_t[j], self.m_at[j], self.m_state[j] = stamp_ns, _FAR, at.PENDING
        self.m_z[j, : len(z)] = z
        self.count += 1
        if first < self.last:
            self._walk(first, self.last, min(j, self._first_after(first)))
        return ""

    def _first_after(self, k: int) -> int:
        """First measurement that snapshot k does not hold."""
        return int(np.searchsorted(self.m_at[: self.count], self.t[k], side="right"))

    def _walk(self, first: int, last: int, j: int) -> None:
        walk(
            first, last, j, self.count, self.t, self.imu, self.X, self.P, self.m_t, self.m_at,
            self.m_state, self.m_nis, self.m_z, self.q, self.par,
        )  # fmt: skip

    def _drop_ticks(self) -> None:
        gone = self.last + 1 - self._keep_ticks
        for a in (self.t, self.imu, self.X, self.P):
            a[: self._keep_ticks] = a[gone : self.last + 1].copy()
        self.last -= gone

    def archive(self, number: int) -> None:
        """Forget the oldest measurements, but not what became of them."""
        self.archived += self._tally(number)
        left = self.count - number
        if number:
            self._floor_ns = max(self._floor_ns, int(self.m_at[number - 1]))
        for a in (self.m_t, self.m_at, self.m_state, self.m_nis, self.m_z):
            a[:left] = a[number : self.count].copy()
        self.count = left

    def verdicts(self) -> Counter[int]:
        """How many camera measurements got each verdict, gates as last decided."""
        return self.archived + self._tally(self.count)

    def _tally(self, number: int) -> Counter[int]:
        rows = self.m_state[:number][self.m_z[:number, 0] <= at.M_CORNERS]
        return Counter(rows.tolist())

    def at_or_before(self, t_ns: int) -> int:
        """Index of the newest snapshot not after t_ns; -1: none."""
        return int(np.searchsorted(self.t[: self.last + 1], t_ns, side="right")) - 1
