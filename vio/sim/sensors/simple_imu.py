"""A simulated IMU: the true rates of a flight, then biases that walk and white noise."""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.records import ImuNoise, ImuTrack
from vio.sim.world.trajectory import GRAVITY, Flight

PIXHAWK = ImuNoise(5e-3, 5e-4, 3e-4, 2e-5, 200.0)
_HALF_STEP_S = 5e-4


@dataclass(frozen=True, slots=True, eq=False)
class Biases:
    """True biases at each sample: gyro (n, 3) [rad/s], accel (n, 3) [m/s^2]."""

    gyro: Array
    accel: Array


def true_rates(flight: Flight, t_s: Array, down_W: Array) -> tuple[Array, Array]:
    """Angular rate and specific force in I at times (n,); down_W (3,): unit vector of gravity."""
    now = flight(t_s)
    R_before, R_after = flight(t_s - _HALF_STEP_S).R_WI, flight(t_s + _HALF_STEP_S).R_WI
    gyro = geo.log(np.swapaxes(R_before, -1, -2) @ R_after) / (2.0 * _HALF_STEP_S)
    accel = np.einsum("nji,nj->ni", now.R_WI, now.a_WI - GRAVITY * down_W)
    return gyro, accel


def simulate_imu(
    flight: Flight,
    duration_s: float,
    noise: ImuNoise,
    rng: np.random.Generator,
    *,
    down_W: Array | None = None,
    turn_on: tuple[float, float] = (0.01, 0.1),
) -> tuple[ImuTrack, Biases]:
    """Samples at noise.rate_hz from 0 to duration_s, stamped from 0 ns, and their true biases.

    down_W (3,): gravity's direction in the map, None: -z; turn_on: sigmas of the first biases
    [rad/s, m/s^2].
    """
    rate = noise.rate_hz or 200.0
    t_s = np.arange(int(duration_s * rate) + 1) / rate
    down = np.array([0.0, 0.0, -1.0]) if down_W is None else down_W
    gyro, accel = true_rates(flight, t_s, down)
    gyro_bias = bias_walk(len(t_s), turn_on[0], noise.gyro_walk / np.sqrt(rate), rng)
    accel_bias = bias_walk(len(t_s), turn_on[1], noise.accel_walk / np.sqrt(rate), rng)
    gyro = gyro + gyro_bias + noise.gyro_density * np.sqrt(rate) * rng.normal(size=gyro.shape)
    accel = accel + accel_bias + noise.accel_density * np.sqrt(rate) * rng.normal(size=accel.shape)
    t_ns = np.round(t_s * 1e9).astype(np.int64)
    return ImuTrack(t_ns, gyro, accel, t_ns), Biases(gyro_bias, accel_bias)


def bias_walk(n: int, first: float, step: float, rng: np.random.Generator) -> Array:
    """A bias (n, 3) drawn with sigma `first` that then walks by sigma `step` a sample."""
    steps = step * rng.normal(size=(n, 3))
    steps[0] = first * rng.normal(size=3)
    return np.asarray(np.cumsum(steps, axis=0))
