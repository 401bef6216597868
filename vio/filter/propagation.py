"""Inertial propagation: nominal state and covariance over one IMU interval.

Midpoint rule with the closed-form exponential; gyro and accelerometer come as their means over
the interval (or as increments divided by it). Only the nine active rows of the transition matrix
are touched. Source: Sola, Quaternion kinematics for the error-state Kalman filter (1711.02508),
section 5.4. Derivation: docs/filter/propagation.md.
"""

import math
from pathlib import Path

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import KERNELS, bare, drop_stale_code, njit
from tagvo.kernels.so3 import exp_quat, matrix_into, right_jacobian_into, times_hat, turn_quat
from vio.filter import state as at

drop_stale_code([KERNELS, Path(__file__).parent])  # its kernels call those of tagvo


@bare
def mechanise(x: Array, w: Array, f: Array, dt: float, g: float, R_mid: Array) -> None:
    """Nominal state x one interval on, in place; w [rad/s], f [m/s^2] interval means with bias.

    R_mid = R_WI Exp((w - b_g) dt / 2)    a = R_mid (f - b_a) - g z_L_hat
    p += v dt + a dt^2 / 2    v += a dt    R_WI := R_WI Exp((w - b_g) dt)
    g [m/s^2] is gravity's magnitude; R_mid (3, 3) receives the attitude R_WI at mid interval.
    """
    half = 0.5 * dt
    w0, w1, w2 = w[0] - x[at.X_BG], w[1] - x[at.X_BG + 1], w[2] - x[at.X_BG + 2]
    d = exp_quat(w0 * half, w1 * half, w2 * half)
    turn_quat(x, at.X_Q, d)
    matrix_into(R_mid, x[at.X_Q], x[at.X_Q + 1], x[at.X_Q + 2], x[at.X_Q + 3])
    turn_quat(x, at.X_Q, d)
    f0, f1, f2 = f[0] - x[at.X_BA], f[1] - x[at.X_BA + 1], f[2] - x[at.X_BA + 2]
    qw, qx, qy, qz = x[at.X_QWL], x[at.X_QWL + 1], x[at.X_QWL + 2], x[at.X_QWL + 3]
    down = (-2 * (qx * qz + qw * qy), -2 * (qy * qz - qw * qx), 2 * (qx * qx + qy * qy) - 1)
    for i in range(3):
        a = R_mid[i, 0] * f0 + R_mid[i, 1] * f1 + R_mid[i, 2] * f2 + g * down[i]
        x[at.X_P + i] += dt * (x[at.X_V + i] + half * a)
        x[at.X_V + i] += dt * a


@njit
def transition_into(
    B: Array, x: Array, w: Array, f: Array, dt: float, g: float, R_mid: Array
) -> None:
    """Active blocks of the transition about x (after the step; biases do not change in it).

    B (6, 11): rows 0-2 add to dv from [theta, bg, ba, level(2)]; rows 3-5 give the new theta
    from [theta, bg]. The position's row is dt dv_old + dt / 2 of what rows 0-2 add.
    dv/dtheta = -R_mid hat(f - b_a) dt E    E = Exp(-(w - b_g) dt / 2)    dv/db_a = -R_mid dt
    dtheta'/dtheta = E E    dtheta'/db_g = -J_r((w - b_g) dt) dt    dv/dlevel = g dt [y, -x]_L_hat
    """
    half = 0.5 * dt
    w0, w1, w2 = w[0] - x[at.X_BG], w[1] - x[at.X_BG + 1], w[2] - x[at.X_BG + 2]
    E, J, M = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    times_hat(M, R_mid, f - x[at.X_BA : at.X_BA + 3], -dt)  # d dv / d theta at mid interval
    d = exp_quat(-w0 * half, -w1 * half, -w2 * half)
    matrix_into(E, d[0], d[1], d[2], d[3])
    right_jacobian_into(J, w0 * half, w1 * half, w2 * half)
    for i in range(3):
        for j in range(3):
            B[i, j] = M[i, 0] * E[0, j] + M[i, 1] * E[1, j] + M[i, 2] * E[2, j]
            B[i, 3 + j] = -half * (M[i, 0] * J[0, j] + M[i, 1] * J[1, j] + M[i, 2] * J[2, j])
            B[i, 6 + j] = -dt * R_mid[i, j]
    matrix_into(M, x[at.X_QWL], x[at.X_QWL + 1], x[at.X_QWL + 2], x[at.X_QWL + 3])
    right_jacobian_into(J, w0 * dt, w1 * dt, w2 * dt)
    for i in range(3):
        B[i, 9], B[i, 10] = dt * g * M[i, 1], -dt * g * M[i, 0]
        for j in range(3):
            B[3 + i, j] = E[i, 0] * E[0, j] + E[i, 1] * E[1, j] + E[i, 2] * E[2, j]
            B[3 + i, 3 + j] = -dt * J[i, j]


@bare
def _rows(T: Array, P: Array, B: Array, dt: float) -> None:
    """T (9, n) := the nine active rows of F P."""
    n = P.shape[0]
    half = 0.5 * dt
    for i in range(3):
        for j in range(n):
            T[3 + i, j] = B[i, 9] * P[at.LEVEL, j] + B[i, 10] * P[at.LEVEL + 1, j]
            T[6 + i, j] = 0.0
        for c in range(9):
            b = B[i, c]
            for j in range(n):
                T[3 + i, j] += b * P[at.TH + c, j]
        for c in range(6):
            b = B[3 + i, c]
            for j in range(n):
                T[6 + i, j] += b * P[at.TH + c, j]
        for j in range(n):
            d = T[3 + i, j]
            T[i, j] = P[i, j] + dt * P[3 + i, j] + half * d
            T[3 + i, j] = P[3 + i, j] + d


@njit
def spread(P: Array, B: Array, dt: float) -> None:
    """P (n, n) := F P F^T in place, F given by its active blocks B; P stays exactly symmetric."""
    n = P.shape[0]
    half = 0.5 * dt
    T = np.empty((9, n))
    _rows(T, P, B, dt)
    for i in range(9):
        for j in range(9, n):
            P[i, j] = T[i, j]
            P[j, i] = T[i, j]
        for k in range(3):
            d = B[k, 9] * T[i, at.LEVEL] + B[k, 10] * T[i, at.LEVEL + 1]
            for c in range(9):
                d += B[k, c] * T[i, at.TH + c]
            P[i, k] = T[i, k] + dt * T[i, 3 + k] + half * d
            P[i, 3 + k] = T[i, 3 + k] + d
            e = 0.0
            for c in range(6):
                e += B[3 + k, c] * T[i, at.TH + c]
            P[i, 6 + k] = e
    for i in range(9):
        for j in range(i):
            P[j, i] = P[i, j]


@bare
def add_noise(
    P: Array, R_mid: Array, dt: float, q: at.ProcessNoise, scale: Array, layout: at.Layout
) -> None:
    """P += process noise of one interval; scale (6,) widens single axes of the IMU."""
    third = dt / 3.0
    for i in range(3):
        P[at.TH + i, at.TH + i] += q.gyro * scale[i] * dt
        P[at.BG + i, at.BG + i] += q.gyro_walk * dt
        P[at.BA + i, at.BA + i] += q.accel_walk * dt
        P[at.EX + i, at.EX + i] += q.extrinsic_walk * dt
        for j in range(3):
            v = 0.0
            for k in range(3):
                v += R_mid[i, k] * scale[3 + k] * R_mid[j, k]
            v *= q.accel * dt
            P[at.V + i, at.V + j] += v
            P[at.P + i, at.V + j] += v * 0.5 * dt
            P[at.V + j, at.P + i] += v * 0.5 * dt
            P[at.P + i, at.P + j] += v * third * dt
    P[at.TD, at.TD] += q.time_offset_walk * dt
    if layout.pose_bias != at.OFF:
        _relax_bias(P, layout.pose_bias, math.exp(-dt * q.pose_bias_rate))


@bare
def _relax_bias(P: Array, first: int, keep: float) -> None:
    """The pose bias forgets all but this share; its stationary variance is 1."""
    n = P.shape[0]
    for i in range(first, first + 6):
        for j in range(n):
            P[i, j] *= keep
    for i in range(n):
        for j in range(first, first + 6):
            P[i, j] *= keep
    for i in range(first, first + 6):
        P[i, i] += 1.0 - keep * keep


@njit
def propagate(
    x: Array, P: Array, imu: Array, dt: float, q: at.ProcessNoise, layout: at.Layout
) -> None:
    """State x (NOMINAL,) and covariance P (n, n) over dt [s], in place, with process noise q.

    imu (12,): means of gyro [rad/s] and specific force [m/s^2] over the interval, in I, then what
    multiplies the white noise of each of the six axes.
    """
    R_mid, B = np.empty((3, 3)), np.empty((6, 11))
    w, f = imu[0:3], imu[3:6]
    mechanise(x, w, f, dt, q.gravity, R_mid)
    transition_into(B, x, w, f, dt, q.gravity, R_mid)
    spread(P, B, dt)
    add_noise(P, R_mid, dt, q, imu[6:12], layout)
    if layout.pose_bias != at.OFF:
        keep = math.exp(-dt * q.pose_bias_rate)
        for i in range(at.X_BIAS, at.X_BIAS + 6):
            x[i] *= keep
