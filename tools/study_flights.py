"""Flights and noisy poses without scenario or image, for studies and for tests of the filter."""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import PoseMeasurement
from vio.sim.sensors.camera_stream import visible
from vio.sim.world.trajectory import (
    KNOTS_HZ,
    SMOOTH_S,
    T3_SECONDS,
    Flight,
    along,
    smoothed,
    t1_command,
    t2_command,
    t3_command,
)


def flight(t_s: Array, p_W: Array, yaw: Array, R_WL: Array | None = None) -> Flight:
    """A vehicle that follows commanded points (k, 3) and yaw (k,) [rad] at times (k,), smoothed."""
    return along(smoothed(t_s, p_W, yaw), R_WL)


def t1(R_WL: Array | None = None) -> tuple[Flight, float]:
    """The flight of `t1_command` and its duration [s]."""
    command = t1_command()
    return flight(*command, R_WL), float(command[0][-1])


def t2(R_WL: Array | None = None) -> tuple[Flight, float]:
    """The flight of `t2_command` and its duration [s]."""
    command = t2_command()
    return flight(*command, R_WL), float(command[0][-1])


def t3(R_WL: Array | None = None) -> tuple[Flight, float]:
    """The flight of `t3_command` and its duration [s]."""
    return flight(*t3_command(), R_WL), T3_SECONDS


def circle(speed_m_s: float, rng: np.random.Generator) -> tuple[Flight, float]:
    """In full flight from the first moment: a circle of 0.7-1.4 m at this speed, turning, 10 s.

    The height swings by 0.2 m; the heading turns by up to 0.6 rad/s, whichever way.
    """
    radius, phase = rng.uniform(0.7, 1.4), rng.uniform(0.0, 2.0 * np.pi)
    side, spin = rng.choice([-1.0, 1.0]), rng.uniform(-0.6, 0.6)
    rate = speed_m_s / radius
    t = np.arange(-5.0, 15.0, 1.0 / KNOTS_HZ)
    angle = side * rate * t + phase
    wide = radius * np.exp(0.5 * (rate * SMOOTH_S) ** 2)  # what the smoothing will take off
    height = 1.2 + 0.2 * np.sin(0.8 * t + phase)
    points = np.column_stack([1.5 + wide * np.cos(angle), 2.5 + wide * np.sin(angle), height])
    return flight(t, points, phase + spin * t), 10.0


def hover(
    speed_m_s: float, yaw_rad_s: float, rng: np.random.Generator, duration_s: float = 14.0
) -> tuple[Flight, float]:
    """Hovering that is none: it drifts at this speed some way and yaws at this rate, steadily.

    To the IMU alone it looks like rest with a gyro bias.
    """
    way, phase, lean = rng.uniform(0.0, 2.0 * np.pi, 3)
    t = np.arange(-5.0, duration_s + 5.0, 1.0 / KNOTS_HZ)
    ahead = speed_m_s * t
    points = np.column_stack(
        [
            1.5 + np.cos(way) * ahead,
            2.5 + np.sin(way) * ahead,
            1.2 + 0.1 * np.sin(lean) * ahead,
        ]
    )
    return flight(t, points, phase + yaw_rad_s * t), duration_s


FLIGHTS = {"T1": t1, "T2": t2, "T3": t3}


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


def _gauss_markov(n: int, keep: float, rng: np.random.Generator) -> Array:
    """Unit variance, correlation `keep` a step; (n, 6)."""
    out = rng.normal(size=(n, 6))
    for i in range(1, n):
        out[i] = keep * out[i - 1] + np.sqrt(1.0 - keep * keep) * out[i]
    return out
