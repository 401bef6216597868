"""Slow and obvious ways to the numbers of tagvo's poses; nothing here is fast or shared with it."""

import numpy as np
import scipy.optimize
from scipy.spatial.transform import Rotation

from tagvo.camera.model import project


def central_difference(f, n, step=1e-6):
    """d f / d x at 0 of a function of (n,); (m, n)."""
    columns = [(f(step * e) - f(-step * e)) / (2.0 * step) for e in np.eye(n)]
    return np.stack(columns, axis=-1)


def turned(R, phi):
    """R Exp(phi) by scipy."""
    return R @ Rotation.from_rotvec(phi).as_matrix()


def pixels_of(camera, R_WC, p_WC, R_WT, p_WT, corners_T):
    """Pixels (8,) of a tag's corners, point by point."""
    out = []
    for x_T in corners_T:
        x_C = R_WC.T @ (R_WT @ x_T + p_WT - p_WC)
        out.extend(project(camera, x_C)[0])
    return np.array(out)


def least_tag_pose(camera, corners_px, corners_T, R_CT, p_CT, sigma_px):
    """Tag pose in the camera of least whitened pixel error, by scipy from a start."""

    def residuals(x):
        R, p = turned(R_CT, x[3:]), p_CT + x[:3]
        found = pixels_of(camera, np.eye(3), np.zeros(3), R, p, corners_T)
        return (found - corners_px.ravel()) / np.repeat(sigma_px, 2)

    best = scipy.optimize.least_squares(residuals, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return turned(R_CT, best.x[3:]), p_CT + best.x[:3], 2.0 * best.cost


def tag_covariance(camera, R_WC, p_WC, R_WT, p_WT, corners_T, sigma_px, laying):
    """Covariance (8, 8) of a tag's residuals in pixels, by finite differences."""

    def moved(d):
        return pixels_of(camera, R_WC, p_WC, turned(R_WT, d[3:]), p_WT + R_WT @ d[:3], corners_T)

    L = central_difference(moved, 6)
    return np.diag(np.repeat(sigma_px, 2) ** 2) + L @ np.diag(laying**2) @ L.T


def joint_pose(camera, corners_px, tags, R_WC, p_WC, limit):
    """Minimum of the robust, whitened cost over all tags by scipy; R, p, cost.

    tags: list of (R_WT, p_WT, corners_T, sigma_px, laying); S is taken at the start, as its
    value hardly matters to where the minimum lies.
    """
    whiteners = [
        np.linalg.inv(np.linalg.cholesky(tag_covariance(camera, R_WC, p_WC, *tag))) for tag in tags
    ]

    def residuals(x):
        R, p = turned(R_WC, x[3:]), p_WC + x[:3]
        out = []
        for tag, white, seen in zip(tags, whiteners, corners_px, strict=True):
            r = white @ (pixels_of(camera, R, p, *tag[:3]) - seen.ravel())
            d2 = r @ r
            rho = d2 if d2 <= limit else limit * (1.0 + np.log(d2 / limit))
            out.append(r * np.sqrt(rho / max(d2, 1e-300)))
        return np.concatenate(out)

    best = scipy.optimize.least_squares(residuals, np.zeros(6), x_scale=[0.01] * 3 + [0.01] * 3)
    return turned(R_WC, best.x[3:]), p_WC + best.x[:3], 2.0 * best.cost


def chordal_mean(q, w):
    """Rotation matrix nearest all rotations in the squared chord, by search from each of them."""
    R = Rotation.from_quat(q, scalar_first=True)

    def cost(phi, start):
        R_try = (start * Rotation.from_rotvec(phi)).as_matrix()
        return float(w @ ((R.as_matrix() - R_try) ** 2).sum(axis=(1, 2)))

    tries = [
        (scipy.optimize.minimize(cost, np.zeros(3), (r,), "BFGS", options={"gtol": 1e-10}), r)
        for r in R
    ]
    best, start = min(tries, key=lambda t: t[0].fun)
    return (start * Rotation.from_rotvec(best.x)).as_matrix()
