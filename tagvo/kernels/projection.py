"""Residuals of tag corners and their derivatives, shared by the per-tag and the joint pose.

Residuals are in pixels, linearised in the image: r = J_px_n (measured - predicted) in normalised
coordinates. The distortion is thus evaluated once a frame, at the measured corner. All functions
are compiled kernels for one tag; they write into their last arguments.
"""

from tagvo.geometry import Array
from tagvo.kernels.jit import bare

_NEAR = 1e-3  # metres in front of the camera below which a corner counts as not visible


@bare
def residual(
    R: Array, p: Array, X: Array, corners_n: Array, J_px_n: Array, r: Array, A: Array, x_C: Array
) -> bool:
    """Residual of a tag's corners X (4, 3) at x_C = R X + p, and d predicted pixel / d x_C.

    Writes r (8,) [px], A (8, 3) [px/m], x_C (4, 3) [m]; False: a corner is not in front.
    """
    front = True
    for c in range(4):
        for i in range(3):
            x_C[c, i] = R[i, 0] * X[c, 0] + R[i, 1] * X[c, 1] + R[i, 2] * X[c, 2] + p[i]
        front = front and x_C[c, 2] > _NEAR
        inv_z = 1.0 / max(x_C[c, 2], _NEAR)
        x, y = x_C[c, 0] * inv_z, x_C[c, 1] * inv_z
        dx, dy = corners_n[c, 0] - x, corners_n[c, 1] - y
        for i in range(2):
            a, b = J_px_n[c, i, 0], J_px_n[c, i, 1]
            row = 2 * c + i
            r[row] = a * dx + b * dy
            A[row, 0] = a * inv_z
            A[row, 1] = b * inv_z
            A[row, 2] = -(a * x + b * y) * inv_z
    return front


@bare
def tag_jacobian(A: Array, R_CT: Array, corners_T: Array, out: Array) -> None:
    """d pixel / d [dp of the tag in T, right rotation in T]; A (8, 3) -> out (8, 6)."""
    for row in range(8):
        c = row // 2
        for j in range(3):
            out[row, j] = A[row, 0] * R_CT[0, j] + A[row, 1] * R_CT[1, j] + A[row, 2] * R_CT[2, j]
        a0, a1, a2 = out[row, 0], out[row, 1], out[row, 2]
        x, y, z = corners_T[c, 0], corners_T[c, 1], corners_T[c, 2]
        out[row, 3] = y * a2 - z * a1  # -(a @ hat(c)) = c x a for a row a
        out[row, 4] = z * a0 - x * a2
        out[row, 5] = x * a1 - y * a0


@bare
def camera_jacobian(A: Array, R_WC: Array, x_C: Array, out: Array) -> None:
    """d pixel / d [p_WC in W, right rotation in C]; A (8, 3), x_C (4, 3) -> out (8, 6)."""
    for row in range(8):
        c = row // 2
        a0, a1, a2 = A[row, 0], A[row, 1], A[row, 2]
        for j in range(3):
            out[row, j] = -(a0 * R_WC[j, 0] + a1 * R_WC[j, 1] + a2 * R_WC[j, 2])
        x, y, z = x_C[c, 0], x_C[c, 1], x_C[c, 2]
        out[row, 3] = a1 * z - a2 * y  # a @ hat(x) = a x x for a row a
        out[row, 4] = a2 * x - a0 * z
        out[row, 5] = a0 * y - a1 * x
