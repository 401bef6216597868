"""The filter's state, declared once: offsets, prior, injection, reset and docs come from BLOCKS.

The error state is local (right): R = R_hat Exp(dtheta). L_hat is the filter's estimate of a level
frame of the map: gravity falls along its -z; its two errors are the x and y of a right rotation of
R_WL_hat. (L without the hat is what leaves towards a vehicle, frozen at a levelling: `vio.frames`.)
A block with a switch may be off: then it has no row in P. `layout` says where each active one
stands. Source: Sola, 1711.02508, sections 5 and 6.
"""

from collections.abc import Collection, Iterable
from typing import NamedTuple

import numpy as np

from tagvo.geometry import IntArray


class Block(NamedTuple):
    """A part of the state: numbers in the error and in the nominal state, and what they mean.

    A rotation has four nominal numbers (a quaternion wxyz) for its two or three errors. prior: the
    key of `vio.prior` with its sigma, or the sigma itself; switch: the key of `vio` that turns the
    block on; "": it is always there.
    """

    name: str
    error: int
    nominal: int
    unit: str
    sense: str
    prior: str | float
    switch: str = ""


BLOCKS = (
    Block("p_WI", 3, 3, "m", "position of the IMU in the map", "position_m"),
    Block("v_WI", 3, 3, "m/s", "its velocity", "velocity_m_s"),
    Block("q_WI", 3, 4, "rad", "its attitude; right error in I", "attitude_deg"),
    Block("b_g", 3, 3, "rad/s", "gyro bias in I", "gyro_bias_rad_s"),
    Block("b_a", 3, 3, "m/s^2", "accelerometer bias in I", "accel_bias_m_s2"),
    Block("q_IC", 3, 4, "rad", "camera in the IMU; right error in C", "extrinsic_rotation_deg"),
    Block("t_d", 1, 1, "s", "time offset: t_imu = t_cam + t_d", "time_offset_s"),
    Block("q_WL_hat", 2, 4, "rad", "level frame in the map; x and y of a right error",
          "gravity_deg"),
    Block("pose_bias", 6, 6, "sigma", "slowly varying error of the poses, in units of each frame's"
          " own sigma (its covariance's Cholesky factor)", 1.0, "pose_bias"),
    Block("p_IC", 3, 3, "m", "place of the camera in the IMU", "lever_arm_m", "lever_arm"),
)  # fmt: skip


def _offsets(sizes: Iterable[int]) -> list[int]:
    return [0, *np.cumsum(list(sizes)).tolist()]


# nominal state x: where each block begins, switched off or not; plain integers are constants to
# the kernels
X_P, X_V, X_Q, X_BG, X_BA, X_QIC, X_TD, X_QWL, X_BIAS, X_PIC, X_RECENT = _offsets(
    b.nominal for b in BLOCKS
)
# what the filter remembers of its innovations (`adaptive_noise`), newest first
LAGS = 5
X_SUMS = X_RECENT + 6 * LAGS  # their products at lags 0 to LAGS
X_LAST = X_SUMS + LAGS + 1  # [s], when the newest was
NOMINAL = X_LAST + 1
MEMORY = NOMINAL - X_RECENT

# error state: the blocks without a switch come first, and so stand where they always stand
P, V, TH, BG, BA, EX, TD, LEVEL, BASE = _offsets(b.error for b in BLOCKS if not b.switch)
OFF = -1  # a block that has no row


class Layout(NamedTuple):
    """Where the active blocks stand: n, the error's dimension, and the offsets of the switched.

    rows (k, 4): of each active block its offset and size in the error, its offset in the nominal
    state, and whether it is a rotation.
    """

    n: int
    pose_bias: int
    p_IC: int
    rows: IntArray


def layout(on: Collection[str] = ()) -> Layout:
    """The layout with these switches on (keys of `vio`, as pose_bias, lever_arm)."""
    rows, n, at = [], 0, dict.fromkeys((b.name for b in BLOCKS), OFF)
    for block, nominal in zip(BLOCKS, _offsets(b.nominal for b in BLOCKS), strict=False):
        if not block.switch or block.switch in on:
            at[block.name] = n
            rows.append((n, block.error, nominal, int(block.nominal == 4)))
            n += block.error
    return Layout(n, at["pose_bias"], at["p_IC"], np.array(rows, dtype=np.int64))


class ProcessNoise(NamedTuple):
    """Squared densities of the white noises that drive the state, and two figures beside them.

    gyro [rad^2/s], accel [m^2/s^3], gyro_walk [rad^2/s^3], accel_walk [m^2/s^5], extrinsic_walk
    [rad^2/s], time_offset_walk [s^2/s]; pose_bias_rate: 1 / its correlation time [1/s]; gravity:
    its magnitude [m/s^2].
    """

    gyro: float
    accel: float
    gyro_walk: float
    accel_walk: float
    extrinsic_walk: float
    time_offset_walk: float
    pose_bias_rate: float
    gravity: float

    def quiet(self) -> "ProcessNoise":
        """The same without noise, as for a step back in time."""
        return ProcessNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, self.pose_bias_rate, self.gravity)
