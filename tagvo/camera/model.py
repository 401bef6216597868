"""The camera model: pinhole with radial-tangential or equidistant distortion, batched.

Pixel centres lie at integer coordinates. Normalised coordinates are x/z, y/z in C (x right,
y down, z forward). Coefficients: radtan k1 k2 p1 p2 [k3 [k4 k5 k6]] (OpenCV), equidistant
k1..k4 of theta (Kannala-Brandt, OpenCV's fisheye).
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np

from tagvo.geometry import Array, BoolArray
from tagvo.kernels.jit import bare, leaf, njit

Point: TypeAlias = tuple[float, float, float, float, float, float]

_NEWTON_STEPS = 25
_NEWTON_TOLERANCE = 1e-14
_MAX_THETA = np.radians(85.0)  # equidistant: beyond it x/z is no useful coordinate


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera.

    model: radtan, equidistant or none; intrinsics (4,) fu fv pu pv [px]; coeffs (k,);
    resolution (width, height) [px]; R_CI (3, 3), p_CI (3,): pose of the IMU in the camera
    (Kalibr's T_cam_imu); timeshift_s: t_imu = t_cam + timeshift; source: the file; notes:
    what its reader took for granted, a line each.
    """

    model: str
    intrinsics: Array
    coeffs: Array
    resolution: tuple[int, int]
    R_CI: Array = field(default_factory=lambda: np.eye(3))
    p_CI: Array = field(default_factory=lambda: np.zeros(3))
    timeshift_s: float = 0.0
    source: str = "camera"
    notes: tuple[str, ...] = ()

    @cached_property
    def kernel_coeffs(self) -> Array:
        """The coefficients padded with zeros to eight; (8,)."""
        return np.concatenate([self.coeffs, np.zeros(8 - len(self.coeffs))])

    @cached_property
    def max_radius(self) -> float:
        """Normalised radius up to which the distortion can be inverted (inf: everywhere)."""
        if self.model == "equidistant":
            return float(np.tan(_MAX_THETA))
        radii = np.linspace(0.0, 4.0, 8001)[1:]
        radial = self.kernel_coeffs.copy()
        radial[2:4] = 0.0
        _, J = _distort_all(MODELS[self.model], radial, np.stack([radii, 0.0 * radii], axis=-1))
        folded = np.flatnonzero(J[:, 0, 0] <= 1e-3)
        return float(radii[folded[0]]) if folded.size else np.inf


@leaf
def _radtan(x: float, y: float, k: Array) -> Point:
    """Distorted x, y and d/dx, d/dy of both; k (8,), zeros where not used."""
    xy, xx, yy = x * y, x * x, y * y
    r2 = xx + yy
    top = 1 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    below = 1 + r2 * (k[5] + r2 * (k[6] + r2 * k[7]))
    g = top / below
    d_top = k[0] + r2 * (2 * k[1] + r2 * 3 * k[4])
    dg = 2 * (d_top - g * (k[5] + r2 * (2 * k[6] + r2 * 3 * k[7]))) / below
    p1, p2 = k[2], k[3]
    x_d = x * g + 2 * p1 * xy + p2 * (r2 + 2 * xx)
    y_d = y * g + p1 * (r2 + 2 * yy) + 2 * p2 * xy
    across = xy * dg + 2 * p1 * x + 2 * p2 * y
    x_dx, y_dy = g + xx * dg + 2 * p1 * y + 6 * p2 * x, g + yy * dg + 6 * p1 * y + 2 * p2 * x
    return x_d, y_d, x_dx, across, across, y_dy


@leaf
def _equidistant(x: float, y: float, k: Array) -> Point:
    """As `_radtan`, for the fisheye model theta_d = theta (1 + k1 theta^2 + ...)."""
    r = np.sqrt(x * x + y * y)
    theta = np.arctan(r)
    t2 = theta * theta
    scale, d_scale = 1.0, 0.0
    if r > 1e-6:
        d = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
        scale = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) / r
        d_scale = (d / (1 + r * r) - scale) / (r * r)
    across = d_scale * x * y
    x_dx, y_dy = scale + d_scale * x * x, scale + d_scale * y * y
    return scale * x, scale * y, x_dx, across, across, y_dy


@bare
def distort_point(model: int, x: float, y: float, k: Array) -> Point:
    """Distorted x, y and d/dx, d/dy of both, of one point; k (8,)."""
    if model == 1:
        return _radtan(x, y, k)
    if model == 2:
        return _equidistant(x, y, k)
    return x, y, 1.0, 0.0, 0.0, 1.0


@njit
def _distort_all(model: int, k: Array, x_n: Array) -> tuple[Array, Array]:
    """Distorted coordinates (m, 2) and Jacobians (m, 2, 2) of x_n (m, 2)."""
    m = len(x_n)
    x_d, J = np.empty((m, 2)), np.empty((m, 2, 2))
    for i in range(m):
        x_d[i, 0], x_d[i, 1], J[i, 0, 0], J[i, 0, 1], J[i, 1, 0], J[i, 1, 1] = distort_point(
            model, x_n[i, 0], x_n[i, 1], k
        )
    return x_d, J


@njit
def _undistort_all(
    model: int, k: Array, target: Array, max_radius: float
) -> tuple[Array, Array, BoolArray]:
    """Newton's method on `distort_point` for every row of target (m, 2)."""
    m = len(target)
    x_n, J, valid = np.zeros((m, 2)), np.zeros((m, 2, 2)), np.zeros(m, dtype=np.bool_)
    for i in range(m):
        u, v = target[i, 0], target[i, 1]
        x, y = u, v
        if model == 2:
            theta = np.sqrt(u * u + v * v)
            if theta > 1e-6:
                x, y = u * np.tan(min(theta, 1.48)) / theta, v * np.tan(min(theta, 1.48)) / theta
        residual, xx, xy, yx, yy = np.inf, 1.0, 0.0, 0.0, 1.0
        for _ in range(_NEWTON_STEPS):
            x_d, y_d, xx, xy, yx, yy = distort_point(model, x, y, k)
            eu, ev = u - x_d, v - y_d
            residual = max(abs(eu), abs(ev))
            if residual < _NEWTON_TOLERANCE:
                break
            det = xx * yy - xy * yx
            if not abs(det) > 1e-9:
                break
            x += min(max((yy * eu - xy * ev) / det, -0.5), 0.5)
            y += min(max((xx * ev - yx * eu) / det, -0.5), 0.5)
        J[i, 0, 0], J[i, 0, 1], J[i, 1, 0], J[i, 1, 1] = xx, xy, yx, yy
        if residual < 1e-8 and x * x + y * y < max_radius * max_radius:
            valid[i] = True
            x_n[i, 0], x_n[i, 1] = x, y
    return x_n, J, valid


MODELS = {"none": 0, "radtan": 1, "equidistant": 2}


def distort(camera: Camera, x_n: Array) -> tuple[Array, Array]:
    """Pixels of normalised coordinates and d pixel / d normalised.

    x_n (..., 2) -> pixels (..., 2), J (..., 2, 2).
    """
    flat = np.ascontiguousarray(x_n, dtype=float).reshape(-1, 2)
    x_d, J = _distort_all(MODELS[camera.model], camera.kernel_coeffs, flat)
    f = camera.intrinsics[:2]
    pixels = x_d.reshape(x_n.shape) * f + camera.intrinsics[2:]
    return pixels, J.reshape(*x_n.shape, 2) * f[:, None]


def project(camera: Camera, p_C: Array) -> tuple[Array, BoolArray]:
    """Pixels of points in C [m] and whether each can be seen at all.

    p_C (..., 3) -> pixels (..., 2), valid (...): in front of the camera and inside the radius
    where the distortion model holds (the image's edges are not looked at).
    """
    z = p_C[..., 2]
    front = z > 1e-6
    x_n = p_C[..., :2] / np.where(front, z, 1.0)[..., None]
    r = np.sqrt(np.einsum("...i,...i->...", x_n, x_n))
    valid = front & (r < camera.max_radius)
    pixels, _ = distort(camera, np.where(valid[..., None], x_n, 0.0))
    return pixels, valid


def unproject(camera: Camera, pixels: Array) -> tuple[Array, Array, BoolArray]:
    """Normalised coordinates of pixels, by Newton's method on the analytic Jacobian.

    pixels (..., 2) -> x_n (..., 2), J (..., 2, 2) d pixel / d normalised there, valid (...):
    False (and x_n 0) where the model has no inverse, as far outside a strong barrel distortion.
    """
    f, c = camera.intrinsics[:2], camera.intrinsics[2:]
    target = np.ascontiguousarray((pixels - c) / f).reshape(-1, 2)
    x_n, J, valid = _undistort_all(
        MODELS[camera.model], camera.kernel_coeffs, target, camera.max_radius
    )
    shape = pixels.shape
    return x_n.reshape(shape), J.reshape(*shape, 2) * f[:, None], valid.reshape(shape[:-1])
