"""Rotations: quaternions wxyz (Hamilton), matrices, the exponential and its right Jacobian.

Source: Sola, Quaternion kinematics for the error-state Kalman filter (1711.02508), sections 1 to 4;
the quaternion of a matrix by Shepperd, 1978.
"""

import math

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare

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
def times_hat(out: Array, R: Array, v: Array, s: float) -> None:
    """out (3, 3) := s R hat(v); v (3,)."""
    for i in range(3):
        a, b, c = R[i, 0], R[i, 1], R[i, 2]
        out[i, 0] = s * (b * v[2] - c * v[1])
        out[i, 1] = s * (c * v[0] - a * v[2])
        out[i, 2] = s * (a * v[1] - b * v[0])


@bare
def rotated(R: Array, phi: Array, out: Array) -> None:
    """R Exp(phi) into `out` (3, 3); phi (3,) [rad]."""
    t2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if t2 < 1e-8:
        a, b = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0
    else:
        t = np.sqrt(t2)
        a, b = np.sin(t) / t, (1.0 - np.cos(t)) / t2
    x, y, z = phi[0], phi[1], phi[2]
    e00, e11, e22 = 1 - b * (y * y + z * z), 1 - b * (x * x + z * z), 1 - b * (x * x + y * y)
    e01, e10 = b * x * y - a * z, b * x * y + a * z
    e02, e20 = b * x * z + a * y, b * x * z - a * y
    e12, e21 = b * y * z - a * x, b * y * z + a * x
    for i in range(3):
        r0, r1, r2 = R[i, 0], R[i, 1], R[i, 2]
        out[i, 0] = r0 * e00 + r1 * e10 + r2 * e20
        out[i, 1] = r0 * e01 + r1 * e11 + r2 * e21
        out[i, 2] = r0 * e02 + r1 * e12 + r2 * e22


@bare
def quaternion(R: Array, q: Array) -> None:
    """Unit quaternion wxyz of a rotation matrix (3, 3) into q (4,); its sign is free (Shepperd)."""
    t = R[0, 0] + R[1, 1] + R[2, 2]
    k = 0  # the largest component: w, or x, y, z
    largest = t
    for i in range(3):
        if R[i, i] > largest:
            k, largest = i + 1, R[i, i]
    if k == 0:
        q[0] = 1.0 + t
        q[1], q[2], q[3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q[0] = R[m, j] - R[j, m]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[m, m]
        q[1 + j], q[1 + m] = R[j, i] + R[i, j], R[m, i] + R[i, m]
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= norm


@bare
def not_orthonormal(R: Array, E: Array) -> float:
    """R^T R - I into E (3, 3); -> its largest element, by size."""
    worst = 0.0
    for i in range(3):
        for k in range(3):
            E[i, k] = R[0, i] * R[0, k] + R[1, i] * R[1, k] + R[2, i] * R[2, k]
            E[i, k] -= 1.0 if i == k else 0.0
            worst = max(worst, abs(E[i, k]))
    return worst


@bare
def orthonormalize(R: Array, E: Array) -> None:
    """R (3, 3) := R (1 - E / 2), E = R^T R - I: nearer to a rotation, the error squared."""
    for i in range(3):
        x, y, z = R[i, 0], R[i, 1], R[i, 2]
        for k in range(3):
            R[i, k] -= 0.5 * (x * E[0, k] + y * E[1, k] + z * E[2, k])


@bare
def pose_distance2(R_a: Array, p_a: Array, R_b: Array, p_b: Array, depth: float) -> float:
    """Squared disagreement of two poses: chord of the rotation [rad] and shift / depth."""
    trace, shift = 0.0, 0.0
    for i in range(3):
        d = p_a[i] - p_b[i]
        shift += d * d
        for j in range(3):
            trace += R_a[i, j] * R_b[i, j]
    return max(3.0 - trace, 0.0) + shift / (depth * depth)
