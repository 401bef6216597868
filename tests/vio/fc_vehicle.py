"""A vehicle that flies on an autopilot's estimate, and that estimate: for the in-test autopilots.

A double integrator with a heading; the estimator knows the vehicle's acceleration in the body
exactly and turns it by its own yaw, so that all that goes wrong comes through vision.
"""

import bisect

import numpy as np


def turn(yaw):
    """Body (forward, right) to north, east; down stays."""
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Vehicle:
    """True position, velocity (3,) NED and yaw; remembers them by true time [ns]."""

    def __init__(self, yaw=0.0, p=(0.0, 0.0, -0.1)):
        self.p, self.v, self.yaw = np.array(p, dtype=float), np.zeros(3), float(yaw)
        self.t, self.track = [0], [(self.p.copy(), self.v.copy(), self.yaw)]

    def step(self, t_ns, accel_ned, dt):
        self.p = self.p + dt * self.v + 0.5 * dt * dt * accel_ned
        self.v = self.v + dt * accel_ned
        self.t.append(t_ns)
        self.track.append((self.p.copy(), self.v.copy(), self.yaw))

    def at(self, t_ns):
        """Position and velocity at a true time, between two steps."""
        i = min(bisect.bisect_right(self.t, t_ns), len(self.t) - 1)
        t0, t1 = self.t[max(i - 1, 0)], self.t[i]
        u = 0.0 if t1 == t0 else min(max((t_ns - t0) / (t1 - t0), 0.0), 1.0)
        (p0, v0, yaw), (p1, v1, _) = self.track[max(i - 1, 0)], self.track[i]
        return (1 - u) * p0 + u * p1, (1 - u) * v0 + u * v1, yaw


class Ekf:
    """Position, velocity, yaw with one 2x2 covariance for all axes; looks back for late vision."""

    def __init__(self, accel_noise=0.35):
        self.p, self.v, self.yaw = np.zeros(3), np.zeros(3), 0.0
        self.P = np.diag([1.0, 0.25])
        self.q = accel_noise**2
        self.times, self.past = [], []
        self.moved = np.zeros(3)  # by corrections, of now and of the past alike
        self.yaw_aligned = False

    def predict(self, t_ns, accel_body, dt):
        a = turn(self.yaw) @ accel_body
        self.p = self.p + dt * self.v + 0.5 * dt * dt * a
        self.v = self.v + dt * a
        F = np.array([[1.0, dt], [0.0, 1.0]])
        g = np.array([0.5 * dt * dt, dt])
        self.P = F @ self.P @ F.T + self.q * np.outer(g, g)
        self.times.append(t_ns)
        self.past.append(self.p - self.moved)
        if len(self.times) > 400:
            del self.times[:200], self.past[:200]

    def innovation(self, t_ns, p):
        """Measured minus what was estimated at that time of the autopilot's clock."""
        i = min(max(bisect.bisect_left(self.times, t_ns), 0), len(self.times) - 1)
        return p - self.past[i] - self.moved

    def gate(self, innovation, sigma, gates):
        """Whether every axis is within `gates` standard deviations."""
        return bool((np.abs(innovation) < gates * np.sqrt(self.P[0, 0] + sigma**2)).all())

    def correct(self, innovation, sigma):
        k = self.P[:, 0] / (self.P[0, 0] + sigma**2)
        self._move(k[0] * innovation)
        self.v = self.v + k[1] * innovation
        self.P = self.P - np.outer(k, self.P[0])

    def reset(self, innovation, sigma):
        """Position to vision at once; the velocity stays what it was."""
        self._move(innovation)
        self.P = np.diag([sigma**2, self.P[1, 1]])

    def _move(self, shift):
        self.p, self.moved = self.p + shift, self.moved + shift

    def correct_yaw(self, yaw, gain=0.2):
        misfit = (yaw - self.yaw + np.pi) % (2 * np.pi) - np.pi
        self.yaw += misfit if not self.yaw_aligned else gain * misfit
        self.yaw_aligned = True
