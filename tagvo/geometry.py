"""Rotations and rigid transforms, batched: every function takes leading batch axes of any shape.

Conventions: `R_AB` brings coordinates from B to A; quaternions are Hamilton, unit, in the order
w x y z; perturbations are right (local): R = R_hat Exp(phi). Small angles are handled by series,
angles near pi by the quaternion. Source: Sola, A micro Lie theory (arXiv 1812.01537).
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.int64]
BoolArray: TypeAlias = NDArray[np.bool_]

_SMALL = 1e-2  # below this angle [rad] the closed forms lose digits and a series takes over


def hat(v: Array) -> Array:
    """Skew matrix of a vector, hat(a) @ b = a x b; (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def _coefficients(theta: Array) -> tuple[Array, Array, Array]:
    """sin(t)/t, (1-cos t)/t^2 and (t - sin t)/t^3, by series near zero."""
    small = theta < _SMALL
    t = np.where(small, 1.0, theta)
    t2 = np.square(theta)
    a = np.where(small, 1.0 - t2 / 6.0 * (1.0 - t2 / 20.0), np.sin(t) / t)
    half = np.sin(0.5 * t) / t
    b = np.where(small, 0.5 - t2 / 24.0 * (1.0 - t2 / 30.0), 2.0 * half * half)
    c = np.where(small, 1.0 / 6.0 - t2 / 120.0 * (1.0 - t2 / 42.0), (t - np.sin(t)) / (t * t * t))
    return a, b, c


def exp(phi: Array) -> Array:
    """Rotation matrix of a rotation vector [rad]; (..., 3) -> (..., 3, 3) (Rodrigues)."""
    theta = np.sqrt(np.einsum("...i,...i->...", phi, phi))
    a, b, _ = _coefficients(theta)
    k = hat(phi)
    return np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k)


def log(R: Array) -> Array:
    """Rotation vector [rad] of a rotation matrix, angle in [0, pi]; (..., 3, 3) -> (..., 3)."""
    return log_quat(quat_from_matrix(R))


def exp_quat(phi: Array) -> Array:
    """Unit quaternion wxyz of a rotation vector [rad]; (..., 3) -> (..., 4)."""
    half = 0.5 * np.linalg.norm(phi, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * phi], axis=-1)


def conjugate_quat(q: Array) -> Array:
    """The inverse of a unit quaternion wxyz; (..., 4)."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def log_quat(q: Array) -> Array:
    """Rotation vector [rad] of a unit quaternion wxyz, angle in [0, pi]; (..., 4) -> (..., 3)."""
    q = np.where(q[..., :1] < 0.0, -q, q)
    v = q[..., 1:]
    s = np.sqrt(np.einsum("...i,...i->...", v, v))
    small = s < 1e-8
    scale = np.where(small, 2.0, 2.0 * np.arctan2(s, q[..., 0]) / np.where(small, 1.0, s))
    return np.asarray(scale[..., None] * v)


def right_jacobian(phi: Array) -> Array:
    """Jr with Exp(phi + d) = Exp(phi) Exp(Jr d) to first order; (..., 3) -> (..., 3, 3)."""
    theta = np.sqrt(np.einsum("...i,...i->...", phi, phi))
    _, b, c = _coefficients(theta)
    k = hat(phi)
    return np.eye(3) - b[..., None, None] * k + c[..., None, None] * (k @ k)


def left_jacobian(phi: Array) -> Array:
    """Jl with Exp(phi + d) = Exp(Jl d) Exp(phi) to first order; (..., 3) -> (..., 3, 3)."""
    return right_jacobian(-phi)


def quat_from_matrix(R: Array) -> Array:
    """Unit quaternion wxyz with w >= 0 of a rotation matrix; (..., 3, 3) -> (..., 4) (Shepperd)."""
    m = R
    m00, m11, m22 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1], m[..., 0, 2], m[..., 1, 0]
    d, e, f = m[..., 1, 2], m[..., 2, 0], m[..., 0, 1]
    rows = np.empty((*m.shape[:-2], 4, 4))  # 4 q q^T, one column a choice of pivot
    rows[..., 0, 0] = 1 + m00 + m11 + m22
    rows[..., 1, 1] = 1 + m00 - m11 - m22
    rows[..., 2, 2] = 1 - m00 + m11 - m22
    rows[..., 3, 3] = 1 - m00 - m11 + m22
    rows[..., 0, 1] = rows[..., 1, 0] = a - d
    rows[..., 0, 2] = rows[..., 2, 0] = b - e
    rows[..., 0, 3] = rows[..., 3, 0] = c - f
    rows[..., 1, 2] = rows[..., 2, 1] = c + f
    rows[..., 1, 3] = rows[..., 3, 1] = b + e
    rows[..., 2, 3] = rows[..., 3, 2] = a + d
    pivot = np.argmax(np.diagonal(rows, axis1=-2, axis2=-1), axis=-1)
    q: Array = np.take_along_axis(rows, pivot[..., None, None], axis=-2)[..., 0, :]
    q = q / np.sqrt(np.einsum("...i,...i->...", q, q))[..., None]
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def matrix_from_quat(q: Array) -> Array:
    """Rotation matrix of a quaternion wxyz, normalised here; (..., 4) -> (..., 3, 3)."""
    q = q / np.sqrt(np.einsum("...i,...i->...", q, q))[..., None]
    w, x, y, z = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    out = np.empty((*q.shape[:-1], 3, 3))
    out[..., 0, 0] = 1 - 2 * (y * y + z * z)
    out[..., 1, 1] = 1 - 2 * (x * x + z * z)
    out[..., 2, 2] = 1 - 2 * (x * x + y * y)
    out[..., 0, 1], out[..., 1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    out[..., 0, 2], out[..., 2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    out[..., 1, 2], out[..., 2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return out


def multiply_quat(a: Array, b: Array) -> Array:
    """Hamilton product of quaternions wxyz; (..., 4) x (..., 4) -> (..., 4)."""
    w = a[..., 0] * b[..., 0] - np.einsum("...i,...i->...", a[..., 1:], b[..., 1:])
    v = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([w[..., None], v], axis=-1)


def angle(R: Array) -> Array:
    """Rotation angle [rad] in [0, pi]; (..., 3, 3) -> (...)."""
    phi = log(R)
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", phi, phi)))


def project_to_so3(m: Array) -> Array:
    """Nearest rotation matrix (Frobenius) of a 3x3 matrix; (..., 3, 3) -> (..., 3, 3)."""
    u, _, vt = np.linalg.svd(m)
    d = np.ones(m.shape[:-1])
    d[..., 2] = np.where(np.linalg.det(u @ vt) < 0.0, -1.0, 1.0)
    return np.asarray((u * d[..., None, :]) @ vt)


def transform(R_AB: Array, p_AB: Array, x_B: Array) -> Array:
    """Points from B to A; (..., 3, 3), (..., 3), (..., 3) -> (..., 3) [m]."""
    return np.asarray(np.einsum("...ij,...j->...i", R_AB, x_B) + p_AB)


def compose(R_AB: Array, p_AB: Array, R_BC: Array, p_BC: Array) -> tuple[Array, Array]:
    """Pose (R, p) of C in A from B in A and C in B; (..., 3, 3) and (..., 3)."""
    return R_AB @ R_BC, transform(R_AB, p_AB, p_BC)


def invert(R_AB: Array, p_AB: Array) -> tuple[Array, Array]:
    """Pose (R, p) of A in B from the pose of B in A; (..., 3, 3) and (..., 3)."""
    R_BA = np.swapaxes(R_AB, -1, -2)
    return R_BA, -np.einsum("...ij,...j->...i", R_BA, p_AB)


def shortest_sides(corners_px: Array) -> Array:
    """Shortest side of quads in the image; (n, 4, 2) -> (n,) [px]."""
    sides = corners_px - corners_px[:, (3, 0, 1, 2)]
    return np.asarray(np.sqrt(np.square(sides).sum(axis=2).min(axis=1)))


def exp_se3(xi: Array) -> tuple[Array, Array]:
    """Pose (R, p) of a twist [rho (m), phi (rad)]; (..., 6) -> (..., 3, 3) and (..., 3)."""
    rho, phi = xi[..., :3], xi[..., 3:]
    return exp(phi), np.einsum("...ij,...j->...i", left_jacobian(phi), rho)


def matrix_from_rpy(roll: ArrayLike, pitch: ArrayLike, yaw: ArrayLike) -> Array:
    """Rotation Rz(yaw) Ry(pitch) Rx(roll) [rad], the paper's ZYX; (...) -> (..., 3, 3)."""
    r, p, y = np.broadcast_arrays(*(np.asarray(a, dtype=float) for a in (roll, pitch, yaw)))
    zero = np.zeros_like(r)
    about_x = exp(np.stack([r, zero, zero], axis=-1))
    about_y = exp(np.stack([zero, p, zero], axis=-1))
    about_z = exp(np.stack([zero, zero, y], axis=-1))
    return about_z @ about_y @ about_x


def rpy_from_matrix(R: Array) -> Array:
    """Roll, pitch, yaw [rad] of Rz(yaw) Ry(pitch) Rx(roll); (..., 3, 3) -> (..., 3)."""
    horizontal = np.hypot(R[..., 0, 0], R[..., 1, 0])
    pitch = np.arctan2(-R[..., 2, 0], horizontal)
    level = horizontal > 1e-9  # at pitch +-90 deg only yaw -+ roll is defined: roll is set to 0
    roll = np.where(level, np.arctan2(R[..., 2, 1], R[..., 2, 2]), 0.0)
    yaw = np.where(
        level,
        np.arctan2(R[..., 1, 0], R[..., 0, 0]),
        np.arctan2(-R[..., 0, 1], R[..., 1, 1]),
    )
    return np.stack([roll, pitch, yaw], axis=-1)
