"""What is known without an image: rest on the ground, and the calibration file's own values.

still:    0 = v_WI, on the ground alone (a zero-velocity update)
rotation: q_IC is the file's to some sigma, once the flight has confirmed it (`calibration_check`)
clock:    t_d likewise
opened:   a confirmation is withdrawn: the block's variance is given back
"""

import math

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import cholesky
from tagvo.kernels.so3 import turn_quat
from vio.filter import state as at
from vio.filter.measurements import kinds
from vio.filter.update import GATE_3, distance, downdate

NUMBERS = 5  # the longest payload: a quaternion and a variance


def still(sigma_m_s: float) -> Array:
    """Row of a velocity of zero; sigma of each axis."""
    return np.array([kinds.STILL, 1.0, 0.0, sigma_m_s**2])


def rotation(q_IC: Array, sigma_rad: float) -> Array:
    """Row of the extrinsic rotation as calibrated, wxyz (4,); sigma of each axis."""
    return np.concatenate([[kinds.ROTATION, 1.0, 0.0], q_IC, [sigma_rad**2]])


def clock(offset_s: float, sigma_s: float) -> Array:
    """Row of the time offset as calibrated."""
    return np.array([kinds.CLOCK, 1.0, 0.0, offset_s, sigma_s**2])


def opened(variance: float, first: int, count: int) -> Array:
    """Row that adds a variance to `count` errors from `first` on."""
    return np.array([kinds.OPEN, 1.0, 0.0, variance, first, count])


@njit
def update_still(x: Array, P: Array, z: Array, gate: float, layout: at.Layout) -> tuple[int, float]:
    """Correct by a velocity of zero; z: variance [m^2/s^2] an axis."""
    S, r = P[at.V : at.V + 3, at.V : at.V + 3].copy(), -x[at.X_V : at.X_V + 3]
    for i in range(len(r)):
        S[i, i] += z[0]
    nis = distance(S, r, 0, len(r))
    if not nis <= GATE_3 * gate:
        return kinds.REJECTED, nis
    good = cholesky(S) and downdate(x, P, S, P[at.V : at.V + 3].copy(), r, layout)
    return (kinds.ACCEPTED if good else kinds.SINGULAR), nis


@njit
def update_rotation(x: Array, P: Array, z: Array, layout: at.Layout) -> tuple[int, float]:
    """Correct by the extrinsic rotation as calibrated; z (5,): q_IC and an axis's variance."""
    S, r = P[at.EX : at.EX + 3, at.EX : at.EX + 3].copy(), np.empty(3)
    q = x[at.X_QIC : at.X_QIC + 4].copy()
    q[1:] = -q[1:]
    turn_quat(q, 0, (z[0], z[1], z[2], z[3]))
    r[:] = 2.0 * q[1:] if q[0] > 0.0 else -2.0 * q[1:]
    variance = z[4]
    for i in range(len(r)):
        S[i, i] += variance
    nis = distance(S, r, 0, len(r))
    good = cholesky(S) and downdate(x, P, S, P[at.EX : at.EX + 3].copy(), r, layout)
    return (kinds.ACCEPTED if good else kinds.SINGULAR), nis


@njit
def update_clock(x: Array, P: Array, z: Array, layout: at.Layout) -> tuple[int, float]:
    """Correct by the time offset as calibrated; z (2,): seconds and variance."""
    L, r = np.empty((1, 1)), np.empty(1)
    L[0, 0] = math.sqrt(P[at.TD, at.TD] + z[1])
    r[0] = z[0] - x[at.X_TD]
    nis = (r[0] / L[0, 0]) ** 2
    good = downdate(x, P, L, P[at.TD : at.TD + 1].copy(), r, layout)
    return (kinds.ACCEPTED if good else kinds.SINGULAR), nis


@bare
def update_opened(P: Array, z: Array) -> None:
    """Give a block's variance back; z (3,): variance, first, count."""
    for i in range(int(z[1]), int(z[1] + z[2])):
        P[i, i] += z[0]
