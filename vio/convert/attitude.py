"""Attitudes between the few that a log has, carried from one to the next by the gyro."""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray


def between(
    t_ns: IntArray, anchor_ns: IntArray, q_WB: Array, gyro_ns: IntArray, gyro_B: Array
) -> Array:
    """Attitudes (n, 4) wxyz at t_ns (n,) from anchors (m,), (m, 4) and a gyro (k,), (k, 3).

    From each anchor the gyro [rad/s], straight between its samples, is integrated to the next; what
    is missing there is spread over the time between, so that every anchor is met. Before the first
    and after the last anchor the attitude stays.
    """
    t_ns = np.clip(t_ns, anchor_ns[0], anchor_ns[-1])
    inside = gyro_ns[(gyro_ns > anchor_ns[0]) & (gyro_ns < anchor_ns[-1])]
    grid = np.unique(np.concatenate([t_ns, anchor_ns, inside]))
    turns = _turns(grid, gyro_ns, gyro_B)
    first = np.searchsorted(grid, anchor_ns)
    place = np.searchsorted(anchor_ns, grid, side="right") - 1  # the anchor before each point
    carried = _carried(turns, first, q_WB, len(grid))
    missing = np.zeros((len(anchor_ns), 3))
    arrived = geo.multiply_quat(carried[first[1:] - 1], geo.exp_quat(turns[first[1:] - 1]))
    missing[:-1] = geo.log_quat(geo.multiply_quat(geo.conjugate_quat(arrived), q_WB[1:]))
    span = np.append(np.diff(anchor_ns), 1)[place]
    share = (grid - anchor_ns[place]) / span
    whole = geo.multiply_quat(carried, geo.exp_quat(missing[place] * share[:, None]))
    return np.asarray(whole[np.searchsorted(grid, t_ns)])


def _turns(grid: IntArray, gyro_ns: IntArray, gyro_B: Array) -> Array:
    """Rotation vector from each point of the grid to the next; (n - 1, 3)."""
    middle = 0.5 * (grid[:-1] - grid[0] + (grid[1:] - grid[0]))
    at = (gyro_ns - grid[0]).astype(float)
    rate = np.stack([np.interp(middle, at, gyro_B[:, k]) for k in range(3)], axis=-1)
    return np.asarray(rate * (np.diff(grid) * 1e-9)[:, None])


def _carried(turns: Array, first: IntArray, q_WB: Array, n: int) -> Array:
    """Attitude at each of n points from the anchor before it: all intervals step at once."""
    out = np.empty((n, 4))
    last = np.append(first[1:], n)
    out[first] = q_WB
    for step in range(1, int((last - first).max())):
        at = (first + step)[first + step < last]
        out[at] = geo.multiply_quat(out[at - 1], geo.exp_quat(turns[at - 1]))
    return out
