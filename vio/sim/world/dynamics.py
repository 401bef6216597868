"""How a multirotor moves along a course: attitude from thrust, rates without differencing."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.sim.world.course import Course, Sines, Window, weighed
from vio.sim.world.trajectory import GRAVITY

DOWN_W = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class BodyMotion:
    """True motion of I (n samples): t_s (n,), p_WI, v_WI, a_WI (n, 3), R_WI (n, 3, 3).

    w_WI_I (n, 3): rotation rate of I with respect to W, written in I [rad/s].
    """

    t_s: Array
    p_WI: Array
    v_WI: Array
    a_WI: Array
    R_WI: Array
    w_WI_I: Array


BodyFlight: TypeAlias = Callable[[Array], BodyMotion]


def body_flight(
    course: Course,
    *,
    down_W: Array = DOWN_W,
    drag_per_s: float = 0.0,
    sway: Sines | None = None,
    window: Window | None = None,
) -> BodyFlight:
    """The motion of a multirotor on this course: its z along its thrust, its x along its yaw.

    down_W (3,): unit vector of gravity in W; drag_per_s: rotor drag a = -drag v, which the thrust
    must make good by tilting; sway: a rotation vector [rad] in I turned on top, where window is 1.
    """

    def at(t_s: Array) -> BodyMotion:
        x = course(t_s)
        p, v, a, jerk = x[..., :3]
        force, force_rate = a - GRAVITY * down_W + drag_per_s * v, jerk + drag_per_s * a
        R_WI, w_I = _along(force, force_rate, x[0, :, 3], x[1, :, 3])
        if sway is not None:
            phi = sway.at(t_s) if window is None else weighed(window(t_s), sway.at(t_s))
            turn = geo.exp(phi[0])
            w_I = np.einsum("nji,nj->ni", turn, w_I)
            w_I += np.einsum("nij,nj->ni", geo.right_jacobian(phi[0]), phi[1])
            R_WI = R_WI @ turn
        return BodyMotion(t_s, p, v, a, R_WI, w_I)

    return at


def inertial(motion: BodyMotion, down_W: Array = DOWN_W) -> tuple[Array, Array]:
    """What a perfect IMU at I measures: gyro (n, 3) [rad/s], specific force (n, 3) [m/s^2]."""
    force_W = motion.a_WI - GRAVITY * down_W
    return motion.w_WI_I, np.einsum("nji,nj->ni", motion.R_WI, force_W)


def tilt(motion: BodyMotion, down_W: Array = DOWN_W) -> Array:
    """Angle between the vehicle's z and the vertical [rad]; (n,)."""
    return np.asarray(np.arccos(np.clip(-motion.R_WI[:, :, 2] @ down_W, -1.0, 1.0)))


def _along(force: Array, force_rate: Array, yaw: Array, yaw_rate: Array) -> tuple[Array, Array]:
    """R (n, 3, 3) with z along force and x towards yaw, and its rate (n, 3) in its own frame.

    Source: Mellinger and Kumar, Minimum snap trajectory generation (ICRA 2011), section III.
    """
    z, z_rate = _unit(force, force_rate)
    zero = np.zeros_like(yaw)
    heading = np.stack([np.cos(yaw), np.sin(yaw), zero], axis=-1)
    heading_rate = np.stack([-np.sin(yaw), np.cos(yaw), zero], axis=-1) * yaw_rate[:, None]
    side, side_rate = np.cross(z, heading), np.cross(z_rate, heading) + np.cross(z, heading_rate)
    y, y_rate = _unit(side, side_rate)
    x, x_rate = np.cross(y, z), np.cross(y_rate, z) + np.cross(y, z_rate)
    R = np.stack([x, y, z], axis=-1)
    rate = [(z * y_rate).sum(-1), (x * z_rate).sum(-1), (y * x_rate).sum(-1)]
    return R, np.stack(rate, axis=-1)


def _unit(v: Array, v_rate: Array) -> tuple[Array, Array]:
    """Unit vector of v (n, 3) and its rate."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    u = v / length
    return u, (v_rate - u * (u * v_rate).sum(axis=-1, keepdims=True)) / length
