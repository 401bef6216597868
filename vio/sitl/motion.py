"""The logged IMU at an autopilot's own rate, with the reference motion, in FRD and NED."""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray
from vio.errors import LogError
from vio.evaluate.truth import TruthTrack, interpolate
from vio.frames import FLIP, levelled, ned_from_level
from vio.records import ImuTrack
from vio.sitl.records import SimState

_GAP_NS = 10**18  # reference motion is for the simulator's record alone: any gap is filled
_STILL_S, _STILL_GYRO, _STILL_ACCEL = 0.5, 0.1, 0.3
_GYRO_NOISE, _ACCEL_NOISE = 5e-4, 5e-3  # at rest: a sensor that never changes counts as stuck


class ImuMeans:
    """Means of the IMU over any interval: the integral of its linear interpolation is kept exactly,
    so that the autopilot's velocity and attitude integrals are the log's at whatever rate."""

    def __init__(self, t_ns: IntArray, values: Array) -> None:
        """t_ns (n,) strictly ascending; values (n, k). Beyond both ends the last value is held."""
        self._t_ns, self._values = t_ns, values
        self._h = np.diff(t_ns) * 1e-9
        steps = 0.5 * (values[:-1] + values[1:]) * self._h[:, None]
        self._sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(steps, axis=0)])

    def integral(self, t_ns: IntArray) -> Array:
        """From the first stamp to these (m,); (m, k)."""
        last = len(self._t_ns) - 1
        i = np.clip(np.searchsorted(self._t_ns, t_ns, side="right") - 1, 0, max(last - 1, 0))
        dt = ((t_ns - self._t_ns[i]) * 1e-9)[:, None]
        before, after = t_ns < self._t_ns[0], t_ns > self._t_ns[last]
        f0, f1 = self._values[i], self._values[np.minimum(i + 1, last)]
        h = np.append(self._h, 1.0)[i][:, None]
        inside = self._sums[i] + dt * (f0 + 0.5 * dt * (f1 - f0) / h)
        early = dt * self._values[0]
        beyond = ((t_ns - self._t_ns[last]) * 1e-9)[:, None] * self._values[last]
        later = np.where(after[:, None], self._sums[last] + beyond, inside)
        return np.asarray(np.where(before[:, None], early, later))

    def mean(self, start_ns: IntArray, end_ns: IntArray) -> Array:
        """Over [start, end] each; (m,), (m,) -> (m, k)."""
        span = ((end_ns - start_ns) * 1e-9)[:, None]
        return np.asarray((self.integral(end_ns) - self.integral(start_ns)) / span)


@dataclass(frozen=True, slots=True, eq=False)
class Placed:
    """How W and I lie for the autopilot: R_NW (3, 3), R_BI (3, 3). Its body is put at I itself."""

    R_NW: Array
    R_BI: Array


def placed(track: ImuTrack, truth: TruthTrack, heading_rad: float, R_BI: Array) -> Placed:
    """N by the compass heading of the map's levelled x; level by the log itself.

    Averaged over a flight, specific force turned into W is what velocity gained, minus gravity.
    """
    order = np.argsort(track.t_ns, kind="stable")
    t_ns = track.t_ns[order]
    at = interpolate(truth, t_ns, _GAP_NS)
    within = (t_ns >= truth.t_ns[0]) & (t_ns <= truth.t_ns[-1])
    rows = np.flatnonzero(within & np.isfinite(at.v_WI).all(axis=1))
    if len(rows) < 2 or t_ns[rows[0]] == t_ns[rows[-1]]:
        raise LogError("IMU and reference motion do not overlap in time")
    a, b = rows[0], rows[-1]
    force_W = np.einsum("nij,nj->ni", at.R_WI[a:b], track.accel_I[order][a:b]).mean(axis=0)
    gained_W = (at.v_WI[b] - at.v_WI[a]) / ((t_ns[b] - t_ns[a]) * 1e-9)
    levelling = levelled(gained_W - force_W)
    return Placed(ned_from_level(heading_rad) @ levelling.R_LW, R_BI)


class Motion:
    """States of a logged flight at any times: at rest before its IMU begins, then the IMU."""

    def __init__(
        self, track: ImuTrack, truth: TruthTrack, place: Placed, rng: np.random.Generator
    ) -> None:
        """truth: reference motion of I in W; rng: noise while at rest."""
        t_ns, first = np.unique(track.t_ns, return_index=True)
        both = np.hstack([track.gyro_I[first], track.accel_I[first]])
        self.begin_ns, self.end_ns = int(t_ns[0]), int(t_ns[-1])
        self._means, self._truth, self._place, self._rng = ImuMeans(t_ns, both), truth, place, rng
        self._resting = self._at_rest(t_ns, both)

    def _at_rest(self, t_ns: IntArray, both: Array) -> Array:
        """What the IMU says before the log (6,): its own first mean where that is at rest, biases
        included; else no rotation, and gravity by the reference attitude."""
        early = both[t_ns <= t_ns[0] + round(_STILL_S * 1e9)]
        mean, spread = early.mean(axis=0), early.std(axis=0)
        slow = np.abs(mean[:3]).max() < _STILL_GYRO and spread[:3].max() < _STILL_GYRO
        if slow and spread[3:].max() < _STILL_ACCEL:
            return np.asarray(mean)
        R_WI = interpolate(self._truth, t_ns[:1], _GAP_NS).R_WI[0]
        up_W = -self._place.R_NW.T @ np.array([0.0, 0.0, 9.81])
        return np.concatenate([np.zeros(3), R_WI.T @ up_W])

    def states(self, t_ns: IntArray, period_ns: int, zero_ns: int) -> list[SimState]:
        """At stamps of the log's clock (m,), each over the period before; times from zero_ns on."""
        imu = self._means.mean(t_ns - period_ns, t_ns)
        resting = t_ns <= self.begin_ns
        sigma = np.repeat([_GYRO_NOISE, _ACCEL_NOISE], 3)
        quiet = self._resting + sigma * self._rng.normal(size=(int(resting.sum()), 6))
        imu[resting] = quiet
        inside = np.clip(t_ns, max(self.begin_ns, int(self._truth.t_ns[0])), self._truth.t_ns[-1])
        at = interpolate(self._truth, inside, _GAP_NS)
        R_NW, R_BI = self._place.R_NW, self._place.R_BI
        R_FI = FLIP[:, None] * R_BI
        q_NF = geo.quat_from_matrix((R_NW @ at.R_WI @ R_BI.T) * FLIP)
        v_N = np.where((resting[:, None]) | ~np.isfinite(at.v_WI), 0.0, at.v_WI) @ R_NW.T
        p_N, gyro_F, accel_F = at.p_WI @ R_NW.T, imu[:, :3] @ R_FI.T, imu[:, 3:] @ R_FI.T
        return [
            SimState(int(t) - zero_ns, gyro_F[k], accel_F[k], p_N[k], v_N[k], q_NF[k])
            for k, t in enumerate(t_ns)
        ]
