"""Smooth flights with exact derivatives: the paper's T1, T2 and T3, and what hovers or stands."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from tagvo.geometry import Array

GRAVITY = 9.81
KNOTS_HZ = 20.0
SMOOTH_S = 0.25  # commanded corners are rounded by a Gaussian of this width
_T3_SEED = 3
_T3_WAYPOINTS, _T3_TURN_RAD = 24, np.radians(40.0)
T3_SECONDS = 40.0  # the paper's T3 takes 35-45 s
_HOVER_S = 2.0  # at rest at either end


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """True motion of I (n samples): t_s (n,), p_WI, v_WI, a_WI (n, 3), R_WI (n, 3, 3)."""

    t_s: Array
    p_WI: Array
    v_WI: Array
    a_WI: Array
    R_WI: Array


Flight = Callable[[Array], Motion]
Command = tuple[Array, Array, Array]  # times (k,) [s], points (k, 3) [m], yaw (k,) [rad]


def smoothed(t_s: Array, p_W: Array, yaw: Array) -> BSpline:
    """Spline of fifth degree in time through a command whose corners are rounded: x y z yaw."""
    grid = np.arange(t_s[0] - 2.0, t_s[-1] + 2.0, 1.0 / KNOTS_HZ)
    command = np.column_stack([np.interp(grid, t_s, c) for c in (*p_W.T, yaw)])
    smooth = gaussian_filter1d(command, SMOOTH_S * KNOTS_HZ, axis=0, mode="nearest")
    return make_interp_spline(grid, smooth, k=5)


def along(spline: BSpline, R_WL: Array | None = None) -> Flight:
    """A vehicle that follows a spline of x, y, z [m] and yaw [rad].

    It tilts as a multirotor must: its z along the specific force. R_WL (3, 3): a level frame in the
    map, whose z is up; None: the map's z is up (points and yaw are then those of the map).
    """
    first, second = spline.derivative(1), spline.derivative(2)
    turn = np.eye(3) if R_WL is None else R_WL

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


def t1_command() -> Command:
    """A square of 1.8 m at 0.8 m and 0.5 m/s, 2 s of hover at each corner."""
    corners = np.array([[2.4, 3.4], [2.4, 1.6], [0.6, 1.6], [0.6, 3.4], [2.4, 3.4]])
    t, p = [0.0, 2.0], [corners[0], corners[0]]
    for corner in corners[1:]:
        t += [t[-1] + 3.6, t[-1] + 5.6]
        p += [corner, corner]
    points = np.column_stack([np.array(p), np.full(len(p), 0.8)])
    return np.array(t), points, np.full(len(t), np.radians(30.0))


def t2_command(place: tuple[float, float] = (1.5, 2.5)) -> Command:
    """Steps of 0.3 m up and down over one place x, y [m], 4 s each."""
    heights = [0.7, 1.0, 1.3, 1.6, 1.3, 1.0, 0.7]
    t = np.repeat(np.arange(len(heights)) * 4.0, 2) + np.tile([0.0, 3.4], len(heights))
    points = np.column_stack([np.full((len(t), 2), place), np.repeat(heights, 2)])
    return t, points, np.full(len(t), np.radians(30.0))


def t3_waypoints() -> Array:
    """The places x y z [m] and headings [rad] of T3 as they were drawn, once for all; (24, 4)."""
    rng = np.random.default_rng(_T3_SEED)
    places = rng.uniform([0.5, 0.7, 0.7], [2.5, 4.3, 1.8], size=(_T3_WAYPOINTS, 3))
    yaw = np.cumsum(rng.uniform(-_T3_TURN_RAD, _T3_TURN_RAD, size=_T3_WAYPOINTS))
    return np.column_stack([places, yaw])


def t3_command() -> Command:
    """A clamped cubic spline through 24 waypoints and headings drawn at random, once.

    Places uniform in the room above the map, each heading within 40 degrees of the one before, time
    in proportion to distance (but to no less than a metre), at rest for 2 s at either end. Number
    and heading were picked so that a pose behind the paper's FIR filter, held until the next, errs
    about as in the study that the nuisances of `PoseNoise` come from: 45.6 cm and 7.9 deg there,
    39.7 cm and 8.4 deg here (6 seeds). A slower T3, 18.9 cm, came before, and the filter missed
    its bars on it.
    """
    waypoints = t3_waypoints()
    legs = np.maximum(np.linalg.norm(np.diff(waypoints[:, :3], axis=0), axis=1), 1.0)
    end = T3_SECONDS - _HOVER_S
    knots = np.concatenate([[0.0], np.cumsum(legs)])
    t_knots = _HOVER_S + knots / knots[-1] * (end - _HOVER_S)
    curve = make_interp_spline(t_knots, waypoints, k=3, bc_type="clamped")
    t = np.arange(0.0, T3_SECONDS, 1.0 / KNOTS_HZ)
    command = curve(np.clip(t, _HOVER_S, end))
    return t, command[:, :3], command[:, 3]
