"""Inertial propagation, compiled: nominal state and covariance over one IMU interval.

Midpoint rule with the closed-form exponential; gyro and accelerometer come as their means over
the interval (or as increments divided by it). Only the nine active rows of the transition matrix
are touched. Source: Sola, Quaternion kinematics for the error-state Kalman filter (1711.02508).
"""

import math
from pathlib import Path

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import KERNELS, bare, drop_stale_code, njit
from vio.filter import state as at

drop_stale_code([KERNELS, Path(__file__).parent])  # its kernels call those of tagvo

Quat = tuple[float, float, float, float]
_SMALL = 1e-4  # half angle [rad] below which sin(h)/h and its kin come from their series


@bare
def exp_quat(x: float, y: float, z: float) -> Quat:
    """Unit quaternion wxyz of a rotation vector [rad]."""
    h = 0.5 * math.sqrt(x * x + y * y + z * z)
    s = 0.5 - h * h / 12.0 if h < _SMALL else 0.5 * math.sin(h) / h
    return math.cos(h), s * x, s * y, s * z


@bare
def turn_quat(x: Array, i: int, d: Quat) -> None:
    """x[i:i+4] := x[i:i+4] * d, normalised; quaternions wxyz."""
    w, a, b, c = x[i], x[i + 1], x[i + 2], x[i + 3]
    dw, da, db, dc = d
    nw = w * dw - a * da - b * db - c * dc
    na = w * da + a * dw + b * dc - c * db
    nb = w * db - a * dc + b * dw + c * da
    nc = w * dc + a * db - b * da + c * dw
    s = 1.0 / math.sqrt(nw * nw + na * na + nb * nb + nc * nc)
    x[i], x[i + 1], x[i + 2], x[i + 3] = nw * s, na * s, nb * s, nc * s


@bare
def matrix_into(R: Array, w: float, x: float, y: float, z: float) -> None:
    """R (3, 3) := rotation matrix of a unit quaternion."""
    R[0, 0], R[1, 1] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z)
    R[2, 2] = 1 - 2 * (x * x + y * y)
    R[0, 1], R[1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    R[0, 2], R[2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    R[1, 2], R[2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)


@bare
def right_jacobian_into(J: Array, x: float, y: float, z: float) -> None:
    """J (3, 3) := right Jacobian of the rotation vector (x, y, z)."""
    t2 = x * x + y * y + z * z
    if t2 < 1e-4:
        b, c = 0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0
    else:
        t = math.sqrt(t2)
        b, c = (1.0 - math.cos(t)) / t2, (t - math.sin(t)) / (t2 * t)
    J[0, 0], J[1, 1], J[2, 2] = (
        1 - c * (y * y + z * z),
        1 - c * (x * x + z * z),
        1 - c * (t2 - z * z),
    )
    J[0, 1], J[1, 0] = b * z + c * x * y, -b * z + c * x * y
    J[0, 2], J[2, 0] = -b * y + c * x * z, b * y + c * x * z
    J[1, 2], J[2, 1] = b * x + c * y * z, -b * x + c * y * z


@bare
def _right_hat(out: Array, R: Array, v0: float, v1: float, v2: float, s: float) -> None:
    """out (3, 3) := s R hat(v)."""
    for i in range(3):
        a, b, c = R[i, 0], R[i, 1], R[i, 2]
        out[i, 0] = s * (b * v2 - c * v1)
        out[i, 1] = s * (c * v0 - a * v2)
        out[i, 2] = s * (a * v1 - b * v0)


@bare
def mechanise(x: Array, w: Array, f: Array, dt: float, g: float, R_mid: Array) -> None:
    """Nominal state x one interval on, in place; w [rad/s], f [m/s^2] interval means with bias.

    g [m/s^2] is gravity's magnitude; R_mid (3, 3) receives the attitude R_WI at mid interval.
    """
    half = 0.5 * dt
    w0, w1, w2 = w[0] - x[at.X_BG], w[1] - x[at.X_BG + 1], w[2] - x[at.X_BG + 2]
    d = exp_quat(w0 * half, w1 * half, w2 * half)
    turn_quat(x, at.X_Q, d)
    matrix_into(R_mid, x[at.X_Q], x[at.X_Q + 1], x[at.X_Q + 2], x[at.X_Q + 3])
    turn_quat(x, at.X_Q, d)
    f0, f1, f2 = f[0] - x[at.X_BA], f[1] - x[at.X_BA + 1], f[2] - x[at.X_BA + 2]
    qw, qx, qy, qz = x[at.X_QWG], x[at.X_QWG + 1], x[at.X_QWG + 2], x[at.X_QWG + 3]
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

    B (6, 11): rows 0-2 add to dv from [theta, bg, ba, gravity(2)]; rows 3-5 give the new theta
    from [theta, bg]. The position's row is dt dv_old + dt / 2 of what rows 0-2 add.
    """
    half = 0.5 * dt
    w0, w1, w2 = w[0] - x[at.X_BG], w[1] - x[at.X_BG + 1], w[2] - x[at.X_BG + 2]
    f0, f1, f2 = f[0] - x[at.X_BA], f[1] - x[at.X_BA + 1], f[2] - x[at.X_BA + 2]
    E, J, M = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    _right_hat(M, R_mid, f0, f1, f2, -dt)  # d dv / d theta at mid interval
    d = exp_quat(-w0 * half, -w1 * half, -w2 * half)
    matrix_into(E, d[0], d[1], d[2], d[3])
    right_jacobian_into(J, w0 * half, w1 * half, w2 * half)
    for i in range(3):
        for j in range(3):
            B[i, j] = M[i, 0] * E[0, j] + M[i, 1] * E[1, j] + M[i, 2] * E[2, j]
            B[i, 3 + j] = -half * (M[i, 0] * J[0, j] + M[i, 1] * J[1, j] + M[i, 2] * J[2, j])
            B[i, 6 + j] = -dt * R_mid[i, j]
    matrix_into(M, x[at.X_QWG], x[at.X_QWG + 1], x[at.X_QWG + 2], x[at.X_QWG + 3])
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
            T[3 + i, j] = B[i, 9] * P[at.GR, j] + B[i, 10] * P[at.GR + 1, j]
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
            d = B[k, 9] * T[i, at.GR] + B[k, 10] * T[i, at.GR + 1]
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
def add_noise(P: Array, R_mid: Array, dt: float, q: Array, scale: Array) -> None:
    """P += process noise of one interval; q as in `layout`, scale (6,) widens single axes."""
    n = P.shape[0]
    third = dt / 3.0
    for i in range(3):
        P[at.TH + i, at.TH + i] += q[at.N_GYRO] * scale[i] * dt
        P[at.BG + i, at.BG + i] += q[at.N_GYRO_WALK] * dt
        P[at.BA + i, at.BA + i] += q[at.N_ACCEL_WALK] * dt
        P[at.EX + i, at.EX + i] += q[at.N_EX_WALK] * dt
        for j in range(3):
            v = 0.0
            for k in range(3):
                v += R_mid[i, k] * scale[3 + k] * R_mid[j, k]
            v *= q[at.N_ACCEL] * dt
            P[at.V + i, at.V + j] += v
            P[at.P + i, at.V + j] += v * 0.5 * dt
            P[at.V + j, at.P + i] += v * 0.5 * dt
            P[at.P + i, at.P + j] += v * third * dt
    P[at.TD, at.TD] += q[at.N_TD_WALK] * dt
    if n >= at.WITH_BIAS:
        _relax_bias(P, dt, q)


@bare
def _relax_bias(P: Array, dt: float, q: Array) -> None:
    """The pose bias forgets at its rate; its stationary variance is 1."""
    n = P.shape[0]
    keep = math.exp(-dt * q[at.N_BIAS_RATE])
    for i in range(at.BIAS, at.BIAS + 6):
        for j in range(n):
            P[i, j] *= keep
    for i in range(n):
        for j in range(at.BIAS, at.BIAS + 6):
            P[i, j] *= keep
    for i in range(at.BIAS, at.BIAS + 6):
        P[i, i] += 1.0 - keep * keep


@njit
def propagate(x: Array, P: Array, imu: Array, dt: float, q: Array) -> None:
    """State x (NOMINAL,) and covariance P (n, n) over dt [s], in place; q (NOISE,) process noise.

    imu (12,): means of gyro [rad/s] and specific force [m/s^2] over the interval, in I, then what
    multiplies the white noise of each of the six axes.
    """
    R_mid, B = np.empty((3, 3)), np.empty((6, 11))
    w, f = imu[0:3], imu[3:6]
    mechanise(x, w, f, dt, q[at.N_GRAVITY], R_mid)
    transition_into(B, x, w, f, dt, q[at.N_GRAVITY], R_mid)
    spread(P, B, dt)
    add_noise(P, R_mid, dt, q, imu[6:12])
    if P.shape[0] >= at.WITH_BIAS:
        keep = math.exp(-dt * q[at.N_BIAS_RATE])
        for i in range(at.X_BIAS, at.X_BIAS + 6):
            x[i] *= keep
