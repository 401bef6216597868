"""Smooth flights with exact derivatives: the paper's T1, T2 and T3, and what hovers or stands."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d

from tagvo.geometry import Array

GRAVITY = 9.81
_KNOTS_HZ = 20.0
_SMOOTH_S = 0.25  # commanded corners are rounded by a Gaussian of this width
_T3 = np.array(
    [
        [0.6, 0.8, 0.8], [2.3, 2.0, 1.5], [0.8, 3.2, 1.0], [2.2, 4.3, 1.6], [0.7, 4.0, 0.9],
        [1.6, 1.2, 1.4], [2.4, 3.4, 0.8], [0.6, 2.4, 1.7], [1.9, 0.9, 1.0], [1.2, 4.2, 1.5],
        [2.3, 1.6, 1.2], [0.9, 2.8, 0.9], [2.2, 4.0, 1.4], [1.8, 1.0, 1.7], [0.8, 2.2, 1.0],
    ]
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """True motion of I (n samples): t_s (n,), p_WI, v_WI, a_WI (n, 3), R_WI (n, 3, 3)."""

    t_s: Array
    p_WI: Array
    v_WI: Array
    a_WI: Array
    R_WI: Array


Flight = Callable[[Array], Motion]


def flight(t_s: Array, p_W: Array, yaw: Array, R_WG: Array | None = None) -> Flight:
    """A vehicle that follows commanded points (k, 3) and yaw (k,) [rad] at times (k,), smoothed.

    It tilts as a multirotor must: its z along the specific force. R_WG (3, 3): a level frame in the
    map, whose z is up; None: the map's z is up (points and yaw are then those of the map).
    """
    grid = np.arange(t_s[0] - 2.0, t_s[-1] + 2.0, 1.0 / _KNOTS_HZ)
    command = np.column_stack([np.interp(grid, t_s, c) for c in (*p_W.T, yaw)])
    smooth = gaussian_filter1d(command, _SMOOTH_S * _KNOTS_HZ, axis=0, mode="nearest")
    spline = make_interp_spline(grid, smooth, k=5)
    first, second = spline.derivative(1), spline.derivative(2)
    turn = np.eye(3) if R_WG is None else R_WG

    def at(t: Array) -> Motion:
        s, a = spline(t), second(t)[..., :3]
        z = a + np.array([0.0, 0.0, GRAVITY])
        z /= np.linalg.norm(z, axis=-1, keepdims=True)
        x = np.stack([np.cos(s[..., 3]), np.sin(s[..., 3]), np.zeros(len(t))], axis=-1)
        y = np.cross(z, x)
        y /= np.linalg.norm(y, axis=-1, keepdims=True)
        R = np.stack([np.cross(y, z), y, z], axis=-1)
        return Motion(t, s[..., :3] @ turn.T, first(t)[..., :3] @ turn.T, a @ turn.T, turn @ R)

    return at


def t1(R_WG: Array | None = None) -> tuple[Flight, float]:
    """A square of 1.8 m at 0.8 m and 0.5 m/s, 2 s of hover at each corner; flight, duration [s]."""
    corners = np.array([[2.4, 3.4], [2.4, 1.6], [0.6, 1.6], [0.6, 3.4], [2.4, 3.4]])
    t, p = [0.0, 2.0], [corners[0], corners[0]]
    for corner in corners[1:]:
        t += [t[-1] + 3.6, t[-1] + 5.6]
        p += [corner, corner]
    points = np.column_stack([np.array(p), np.full(len(p), 0.8)])
    return flight(np.array(t), points, np.full(len(t), np.radians(30.0)), R_WG), t[-1]


def t2(R_WG: Array | None = None) -> tuple[Flight, float]:
    """Steps of 0.3 m up and down over one place, 4 s each."""
    heights = [0.7, 1.0, 1.3, 1.6, 1.3, 1.0, 0.7]
    t = np.repeat(np.arange(len(heights)) * 4.0, 2) + np.tile([0.0, 3.4], len(heights))
    points = np.column_stack([np.full((len(t), 2), [1.5, 2.5]), np.repeat(heights, 2)])
    return flight(t, points, np.full(len(t), np.radians(30.0)), R_WG), float(t[-1])


def t3(R_WG: Array | None = None) -> tuple[Flight, float]:
    """A spline through fifteen points, the yaw swinging over 250 degrees three times."""
    legs = np.sqrt(np.linalg.norm(np.diff(_T3, axis=0), axis=1))
    knots = np.concatenate([[0.0], np.cumsum(legs)])
    t_knots = knots / knots[-1] * 41.0 + 2.0
    curve = make_interp_spline(t_knots, _T3, k=3, bc_type="clamped")
    t = np.arange(0.0, 45.0, 0.1)
    swing = 1.0 - np.cos(6.0 * np.pi * np.clip((t - 2.0) / 41.0, 0.0, 1.0))
    yaw = np.radians(30.0 + 125.0 * swing)
    return flight(t, curve(np.clip(t, 2.0, 43.0)), yaw, R_WG), 45.0


FLIGHTS = {"T1": t1, "T2": t2, "T3": t3}
