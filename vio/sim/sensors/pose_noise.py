"""Simulated camera poses with all that goes wrong with real ones, without drawing an image."""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import PoseMeasurement
from vio.sim.world.trajectory import Flight


@dataclass(frozen=True, slots=True)
class PoseNoise:
    """Nuisances of the poses; sigmas per axis.

    white, slow: [m, deg]; slow_s: correlation time of the slow error; outliers: share; dropouts:
    number, of 0.5-3 s; delay_s: range of arrival after capture; stamp_s: how much the camera's
    clock is behind (t_imu = t_cam + stamp_s); rate_hz.
    """

    white: tuple[float, float] = (0.025, 1.0)
    slow: tuple[float, float] = (0.015, 0.7)
    slow_s: float = 5.0
    outliers: float = 0.03
    dropouts: int = 3
    delay_s: tuple[float, float] = (0.06, 0.12)
    stamp_s: float = 0.03
    rate_hz: float = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class PoseStream:
    """Poses in order of capture; arrival_ns (n,) in the IMU's clock; outlier (n,)."""

    poses: list[PoseMeasurement]
    arrival_ns: IntArray
    outlier: BoolArray


def wrong_rig(camera: Camera, deg: float, metres: float, rng: np.random.Generator) -> Camera:
    """The camera's calibration file with an extrinsic rotation and lever arm this far off."""
    turn = geo.exp(np.radians(deg) * _unit(rng))
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
    R_CI, p_CI = geo.invert(R_IC @ turn, p_IC + metres * _unit(rng))
    return Camera(
        camera.model, camera.intrinsics, camera.coeffs, camera.resolution, R_CI, p_CI,
        camera.timeshift_s, camera.source,
    )  # fmt: skip


def simulate_poses(
    flight: Flight, duration_s: float, camera: Camera, noise: PoseNoise, rng: np.random.Generator
) -> PoseStream:
    """Poses of a camera with this (true) rig along a flight whose IMU starts at 0 ns."""
    t = np.arange(0.05, duration_s, 1.0 / noise.rate_hz)
    n = len(t)
    truth = flight(t)
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
    R_WC, p_WC = geo.compose(truth.R_WI, truth.p_WI, R_IC, p_IC)
    sigma = np.repeat([[noise.white[0], np.radians(noise.white[1])]], 3, axis=1)
    slow_sigma = np.repeat([[noise.slow[0], np.radians(noise.slow[1])]], 3, axis=1)
    keep = np.exp(-1.0 / (noise.rate_hz * noise.slow_s))
    slow = _gauss_markov(n, keep, rng) * slow_sigma
    error = slow + sigma * rng.normal(size=(n, 6))
    outlier = rng.random(n) < noise.outliers
    wild = rng.normal(size=(n, 6)) * np.repeat([[0.5, 0.5]], 3, axis=1)
    error = np.where(outlier[:, None], wild, error)
    cov = np.diag((sigma**2 + slow_sigma**2)[0])
    stamp = np.round((t - noise.stamp_s) * 1e9).astype(np.int64)
    arrival = np.round((t + rng.uniform(*noise.delay_s, size=n)) * 1e9).astype(np.int64)
    poses = [
        PoseMeasurement(
            int(stamp[i]), p_WC[i] + error[i, :3], R_WC[i] @ geo.exp(error[i, 3:]), cov, (0,)
        )
        for i in range(n)
    ]
    seen = np.flatnonzero(visible(t, duration_s, noise.dropouts, rng))
    return PoseStream([poses[i] for i in seen], arrival[seen], outlier[seen])


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _gauss_markov(n: int, keep: float, rng: np.random.Generator) -> Array:
    """Unit variance, correlation `keep` a step; (n, 6)."""
    out = rng.normal(size=(n, 6))
    for i in range(1, n):
        out[i] = keep * out[i - 1] + np.sqrt(1.0 - keep * keep) * out[i]
    return out


def visible(
    t: Array,
    duration_s: float,
    dropouts: int,
    rng: np.random.Generator,
    *,
    length_s: tuple[float, float] = (0.5, 3.0),
    after_s: float = 5.0,
) -> BoolArray:
    """False inside dropouts that last length_s [s], none of which begins in the first after_s."""
    seen = np.ones(len(t), dtype=bool)
    for _ in range(dropouts):
        start = rng.uniform(after_s, max(duration_s - length_s[1], after_s + 0.1))
        seen &= ~((t >= start) & (t < start + rng.uniform(*length_s)))
    return seen
