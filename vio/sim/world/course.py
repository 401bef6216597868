"""Where a vehicle is meant to be, with three exact derivatives: what thrust and IMU follow from.

A course takes times (n,) [s] and gives (4, n, 4): x y z [m] and yaw [rad] in W, and their first,
second and third derivatives in time.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import comb
from typing import TypeAlias

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from tagvo.geometry import Array
from vio.sim.world.trajectory import Command, smoothed

ORDERS = 4
Course: TypeAlias = Callable[[Array], Array]
Window: TypeAlias = Callable[[Array], Array]  # times (n,) -> (4, n): a weight and its derivatives
_SMOOTH_STEP = np.array([0.0, 0, 0, 0, 35, -84, 70, -20])  # at rest to third order
_STEP_ORDERS = np.stack([np.pad(polyder(_SMOOTH_STEP, i), (0, i)) for i in range(ORDERS)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Sines:
    """Sums of m sine waves on k channels: hz (m,), amplitude (m, k), phase (m, k) [rad]."""

    hz: Array
    amplitude: Array
    phase: Array

    def at(self, t_s: Array) -> Array:
        """Value and three derivatives at times (n,); (4, n, k)."""
        w = 2.0 * np.pi * self.hz
        angle = t_s[:, None] * w
        waves = np.concatenate([np.sin(angle), np.cos(angle)], axis=1)  # once for all channels
        a, b = self.amplitude * np.cos(self.phase), self.amplitude * np.sin(self.phase)
        turns = ((a, b), (-b, a), (-a, -b), (b, -a))
        scale = [w[:, None] ** order for order in range(ORDERS)]
        return np.stack(
            [waves @ np.vstack([x * k, y * k]) for (x, y), k in zip(turns, scale, strict=True)]
        )


def band_limited(
    rms: float, band_hz: tuple[float, float], channels: int, rng: np.random.Generator
) -> Sines:
    """A random motion with this standard deviation on each channel and no power outside the band.

    Twenty-four waves at frequencies even in octaves, amplitudes of one size, phases random.
    """
    count = 24
    share = (np.arange(count) + rng.uniform(size=count)) / count
    hz = band_hz[0] * (band_hz[1] / band_hz[0]) ** share
    amplitude = np.full((count, channels), rms * np.sqrt(2.0 / count))
    return Sines(hz, amplitude, rng.uniform(0.0, 2.0 * np.pi, size=(count, channels)))


def step(t_s: Array, start_s: float, end_s: float) -> Array:
    """A smooth step from 0 to 1 and its derivatives, at rest to third order; (n,) -> (4, n)."""
    length = end_s - start_s
    u = np.clip((t_s - start_s) / length, 0.0, 1.0)
    return np.asarray(polyval(u, _STEP_ORDERS) / length ** np.arange(ORDERS)[:, None])


def weighed(window: Array, values: Array) -> Array:
    """Product of a window (4, n) and values (4, n, k) with its derivatives (Leibniz's rule)."""
    terms = [
        sum(comb(i, j) * window[j][:, None] * values[i - j] for j in range(i + 1))
        for i in range(ORDERS)
    ]
    return np.stack(terms)


def followed(command: Command) -> Course:
    """The rounded command; at rest at its ends beyond its first and last time."""
    spline = smoothed(*command)
    orders = [spline, *(spline.derivative(i) for i in range(1, ORDERS))]
    first, last = float(command[0][0]), float(command[0][-1])

    def at(t_s: Array) -> Array:
        within = np.clip(t_s, first, last)
        out = np.stack([order(within) for order in orders])
        out[1:, (t_s < first) | (t_s > last)] = 0.0
        return out

    return at


def shuttle(
    middle: tuple[float, float, float, float], reach: Array, rate_hz: float, duration_s: float
) -> Course:
    """To and fro through middle (x, y, z, yaw) by reach (3,) [m], swinging up and down at its ends.

    The swing grows over the first period and a half, and dies away over the last.
    """
    wave = Sines(np.array([rate_hz]), np.array([[*reach, 0.0]]), np.zeros((1, 4)))
    ramp = 1.5 / rate_hz

    def at(t_s: Array) -> Array:
        up, down = step(t_s, 0.0, ramp), step(t_s, duration_s - ramp, duration_s)
        out = weighed(up - down, wave.at(t_s))
        out[0] += middle
        return out

    return at


def faster(course: Course, factor: float) -> Course:
    """The same course flown `factor` times as fast."""
    scale = factor ** np.arange(ORDERS)[:, None, None]
    return lambda t_s: course(factor * t_s) * scale


def later(course: Course, delay_s: float) -> Course:
    """The same course, begun that much later."""
    return lambda t_s: course(t_s - delay_s)


def from_the_ground(course: Course, ground_z: float, up: Window) -> Course:
    """The course, stood on the ground [m] where `up` is 0 and flown where it is 1.

    The course must be at rest while `up` is in between: the vehicle then climbs straight up.
    """

    def at(t_s: Array) -> Array:
        out, window = course(t_s), up(t_s)
        height = out[:, :, 2:3].copy()
        height[0] -= ground_z
        out[:, :, 2:3] = weighed(window, height)
        out[0, :, 2] += ground_z
        return out

    return at


def shaken(course: Course, shake: Sines, window: Window) -> Course:
    """The course with a random motion of x, y and z added where the window lets it."""

    def at(t_s: Array) -> Array:
        out = course(t_s)
        out[:, :, :3] += weighed(window(t_s), shake.at(t_s))
        return out

    return at
