"""What the filter is told of its world: process noise, measurement noise, which blocks are on."""

from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import njit
from vio.config.filter import VioConfig
from vio.filter import state as at
from vio.filter.adaptive_noise import NoisePolicy
from vio.records import ImuNoise

# a Pixhawk's over MAVLink: where a log has no imu.yaml
USUAL_NOISE = ImuNoise(5e-3, 5e-4, 3e-4, 2e-5)


class Model(NamedTuple):
    """Process noise, what is known of the measurements' noise, where the state's blocks stand."""

    q: at.ProcessNoise
    policy: NoisePolicy
    layout: at.Layout


# Python hands a kernel an array in a tenth of the time of a named tuple of eight numbers
_Q, _POLICY = len(at.ProcessNoise._fields), len(NoisePolicy._fields)


def pack_model(model: Model) -> Array:
    """The model as one row of numbers."""
    layout = model.layout
    places = [layout.n, layout.pose_bias, layout.p_IC]
    return np.concatenate([model.q, model.policy, places, layout.rows.ravel()]).astype(np.float64)


@njit
def unpack_model(m: Array) -> tuple[at.ProcessNoise, NoisePolicy, at.Layout]:
    """The parts of a packed model."""
    q = at.ProcessNoise(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7])
    p, places = m[_Q:], m[_Q + _POLICY :]
    policy = NoisePolicy(p[0], p[1] != 0.0, p[2] != 0.0, p[3], p[4])
    rows = places[3:].astype(np.int64).reshape((-1, 4))
    return q, policy, at.Layout(int(places[0]), int(places[1]), int(places[2]), rows)


def model_of(noise: ImuNoise, config: VioConfig) -> Model:
    """The model of an IMU and a configuration."""
    return Model(process_noise(noise, config), noise_policy(config), at.layout(switched_on(config)))


def process_noise(noise: ImuNoise, config: VioConfig) -> at.ProcessNoise:
    """The filter's process noise from an IMU's densities and the configuration."""
    return at.ProcessNoise(
        noise.gyro_density**2,
        noise.accel_density**2,
        noise.gyro_walk**2,
        noise.accel_walk**2,
        config.extrinsic_walk_rad**2,
        config.time_offset_walk_s**2,
        1.0 / config.pose_bias_time_s,
        config.gravity_m_s2,
    )


def noise_policy(config: VioConfig) -> NoisePolicy:
    """What the configuration says of the measurements' noise."""
    share = config.pose_bias_share
    return NoisePolicy(
        config.r_inflation, config.r_adapt, share is not None, share or 0.0, config.gate
    )


def switched_on(config: VioConfig) -> set[str]:
    """The switches of the state's blocks that a configuration turns on."""
    return {b.switch for b in at.BLOCKS if b.switch and getattr(config, b.switch)}
