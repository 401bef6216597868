"""A camera pose as the filter takes it: about the point of the map that the camera saw best.

The position of a camera over few tags is uncertain along an arc about them: where it is and how it
is turned err together, and a linear update about the camera's position would leave the arc. The
place of the tags in the camera is known well whatever the rotation; so the measurement is that
place (its pivot, found from the covariance alone) and the rotation. A flipped planar solution then
spoils the rotation alone.
"""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.records import PoseMeasurement
from vio import layout as at

_BASIS = geo.hat(np.eye(3))  # (3, 3, 3): hat of each axis


def pivot_of(R_WC: Array, cov: Array) -> Array:
    """The point in C (3,) whose place in C errs independently of the rotation, as far as any does.

    cov (6, 6) of [p_WC in W, right rotation in C]; zero where the two are independent already.
    """
    turned = _BASIS @ cov[3:, 3:]  # d ([y] x C_tt) / dy
    A = turned.reshape(3, 9).T
    b = (R_WC.T @ cov[:3, 3:]).ravel()
    normal = A.T @ A
    return np.asarray(np.linalg.solve(normal + 1e-12 * np.trace(normal) * np.eye(3), A.T @ b))


def pose_row(measured: PoseMeasurement) -> Array:
    """The measurement as a row of `layout`: kind, count, pivot in C, q_WC, cov, pivot in W."""
    R_WC = measured.R_WC
    pivot_C = pivot_of(R_WC, measured.cov)
    T = np.eye(6)
    T[:3, :3], T[:3, 3:] = -R_WC.T, geo.hat(pivot_C)
    cov = T @ measured.cov @ T.T
    q_WC = geo.quat_from_matrix(R_WC)
    pivot_W = measured.p_WC + R_WC @ pivot_C
    return np.concatenate([[at.M_POSE, 1.0], pivot_C, q_WC, cov.ravel(), pivot_W])
