"""The camera model: pinhole with radial-tangential or equidistant distortion, batched.

Pixel centres lie at integer coordinates. Normalised coordinates are x/z, y/z in C (x right,
y down, z forward). Coefficients: radtan k1 k2 p1 p2 [k3 [k4 k5 k6]] (OpenCV), equidistant
k1..k4 of theta (Kannala-Brandt, OpenCV's fisheye).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from tagvo.geometry import Array, BoolArray

_NEWTON_STEPS = 25
_NEWTON_TOLERANCE = 1e-11
_MAX_THETA = np.radians(85.0)  # equidistant: beyond it x/z is no useful coordinate


@dataclass(frozen=True, eq=False)
class Camera:
    """One calibrated camera.

    model: radtan, equidistant or none; intrinsics (4,) fu fv pu pv [px]; coeffs (k,);
    resolution (width, height) [px]; R_CI (3, 3), p_CI (3,): pose of the IMU in the camera
    (Kalibr's T_cam_imu); timeshift_s: t_imu = t_cam + timeshift; source: the file.
    """

    model: str
    intrinsics: Array
    coeffs: Array
    resolution: tuple[int, int]
    R_CI: Array = field(default_factory=lambda: np.eye(3))
    p_CI: Array = field(default_factory=lambda: np.zeros(3))
    timeshift_s: float = 0.0
    source: str = "camera"

    @cached_property
    def max_radius(self) -> float:
        """Normalised radius up to which the distortion can be inverted (inf: everywhere)."""
        if self.model == "equidistant":
            return float(np.tan(_MAX_THETA))
        radii = np.linspace(0.0, 4.0, 8001)[1:]
        x_n = np.stack([radii, np.zeros_like(radii)], axis=-1)
        radial = np.concatenate([self.coeffs[:2], np.zeros(2), self.coeffs[4:]])
        _, J = _radtan(x_n, radial)
        folded = np.flatnonzero(J[:, 0, 0] <= 1e-3)
        return float(radii[folded[0]]) if folded.size else np.inf


def _radtan(x_n: Array, k: Array) -> tuple[Array, Array]:
    """Distorted normalised coordinates and their Jacobian; (..., 2) -> (..., 2), (..., 2, 2)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.concatenate([k, np.zeros(8 - len(k))]).tolist()
    x, y = x_n[..., 0], x_n[..., 1]
    xy, xx, yy = x * y, x * x, y * y
    r2 = xx + yy
    top = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    d_top = k1 + r2 * (2 * k2 + r2 * 3 * k3)
    if k4 or k5 or k6:
        below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        d_below = k4 + r2 * (2 * k5 + r2 * 3 * k6)
        g = top / below
        dg = 2 * (d_top - g * d_below) / below  # d g / d r2, doubled
    else:
        g, dg = top, 2 * d_top
    out = np.empty(x_n.shape)
    out[..., 0] = x * g + 2 * p1 * xy + p2 * (r2 + 2 * xx)
    out[..., 1] = y * g + p1 * (r2 + 2 * yy) + 2 * p2 * xy
    J = np.empty((*x_n.shape, 2))
    J[..., 0, 0] = g + xx * dg + 2 * p1 * y + 6 * p2 * x
    J[..., 0, 1] = J[..., 1, 0] = xy * dg + 2 * p1 * x + 2 * p2 * y
    J[..., 1, 1] = g + yy * dg + 6 * p1 * y + 2 * p2 * x
    return out, J


def _equidistant(x_n: Array, k: Array) -> tuple[Array, Array]:
    """As `_radtan`, for the fisheye model theta_d = theta (1 + k1 theta^2 + ...)."""
    r = np.sqrt(np.einsum("...i,...i->...", x_n, x_n))
    small = r < 1e-6
    safe = np.where(small, 1.0, r)
    theta = np.arctan(r)
    t2 = theta * theta
    poly = 1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))
    d_theta_d = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
    scale = np.where(small, 1.0, theta * poly / safe)
    d_scale = np.where(small, 0.0, (d_theta_d / (1 + r * r) - scale) / (safe * safe))
    outer = x_n[..., :, None] * x_n[..., None, :]
    J = scale[..., None, None] * np.eye(2) + d_scale[..., None, None] * outer
    return np.asarray(scale[..., None] * x_n), J


def _undistorted(x_n: Array, k: Array) -> tuple[Array, Array]:
    return x_n, np.broadcast_to(np.eye(2), (*x_n.shape, 2)).copy()


DISTORTION: dict[str, Callable[[Array, Array], tuple[Array, Array]]] = {
    "radtan": _radtan,
    "equidistant": _equidistant,
    "none": _undistorted,
}


def distort(camera: Camera, x_n: Array) -> tuple[Array, Array]:
    """Pixels of normalised coordinates and d pixel / d normalised.

    x_n (..., 2) -> pixels (..., 2), J (..., 2, 2).
    """
    x_d, J = DISTORTION[camera.model](x_n, camera.coeffs)
    f = camera.intrinsics[:2]
    return x_d * f + camera.intrinsics[2:], J * f[:, None]


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


def projection_jacobian(camera: Camera, p_C: Array) -> Array:
    """d pixel / d p_C [px/m] for points in front of the camera; (..., 3) -> (..., 2, 3)."""
    z = p_C[..., 2:]
    x_n = p_C[..., :2] / z
    _, J = distort(camera, x_n)
    d = np.zeros((*p_C.shape[:-1], 2, 3))
    d[..., 0, 0] = d[..., 1, 1] = 1.0 / z[..., 0]
    d[..., :, 2] = -x_n / z
    return np.asarray(J @ d)


def unproject(camera: Camera, pixels: Array) -> tuple[Array, Array, BoolArray]:
    """Normalised coordinates of pixels, by Newton's method on the analytic Jacobian.

    pixels (..., 2) -> x_n (..., 2), J (..., 2, 2) d pixel / d normalised there, valid (...):
    False (and x_n 0) where the model has no inverse, as far outside a strong barrel distortion.
    """
    f, c = camera.intrinsics[:2], camera.intrinsics[2:]
    target = (pixels - c) / f
    function, k = DISTORTION[camera.model], camera.coeffs
    x = _first_guess(camera, target)
    for _ in range(_NEWTON_STEPS):
        x_d, J = function(x, k)
        error = target - x_d
        det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
        det = np.where(np.abs(det) < 1e-9, 1e-9, det)
        step = np.empty(x.shape)
        step[..., 0] = (J[..., 1, 1] * error[..., 0] - J[..., 0, 1] * error[..., 1]) / det
        step[..., 1] = (J[..., 0, 0] * error[..., 1] - J[..., 1, 0] * error[..., 0]) / det
        x = x + np.clip(step, -0.5, 0.5)
        if np.abs(step).max(initial=0.0) < _NEWTON_TOLERANCE:
            break
    x_d, J = function(x, k)
    radius = np.sqrt(np.einsum("...i,...i->...", x, x))
    residual = np.abs(target - x_d).max(axis=-1, initial=0.0)
    valid = np.isfinite(x).all(axis=-1) & (residual < 1e-8) & (radius < camera.max_radius)
    return np.where(valid[..., None], x, 0.0), J * f[:, None], valid


def _first_guess(camera: Camera, target: Array) -> Array:
    if camera.model != "equidistant":
        return target.copy()
    theta = np.sqrt(np.einsum("...i,...i->...", target, target))
    safe = np.where(theta < 1e-6, 1.0, theta)
    scale = np.where(theta < 1e-6, 1.0, np.tan(np.minimum(theta, _MAX_THETA)) / safe)
    return np.asarray(scale[..., None] * target)
