"""Residuals of tag corners and their derivatives, shared by the per-tag and the joint pose.

Residuals are in pixels, linearised in the image: r = J_px_n (measured - predicted) in normalised
coordinates. The distortion is thus evaluated once a frame, at the measured corner. All functions
are compiled kernels for one tag; they write into their last arguments.
"""

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, leaf

_NEAR = 1e-3  # metres in front of the camera below which a corner counts as not visible
_FLAT = 1e-15  # determinant below which a quad is a line, in the units of its corners squared
_LEAST_DET = 1e-18  # keeps what comes of such a quad finite


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


Row = tuple[float, float, float]


@leaf
def camera_row(a: Row, x_C: Row, R_WC: Array, out: Array) -> None:
    """out (6,) := a d x_C / d [p_WC in W, right rotation in C] = [-a R_WC^T, a hat(x_C)]."""
    a0, a1, a2 = a
    x, y, z = x_C
    for j in range(3):
        out[j] = -(a0 * R_WC[j, 0] + a1 * R_WC[j, 1] + a2 * R_WC[j, 2])
    out[3] = a1 * z - a2 * y  # a @ hat(x) = a x x for a row a
    out[4] = a2 * x - a0 * z
    out[5] = a0 * y - a1 * x


@bare
def camera_jacobian(A: Array, R_WC: Array, x_C: Array, out: Array) -> None:
    """d pixel / d [p_WC in W, right rotation in C]; A (8, 3), x_C (4, 3) -> out (8, 6)."""
    for row in range(8):
        c = row // 2
        a, x = (A[row, 0], A[row, 1], A[row, 2]), (x_C[c, 0], x_C[c, 1], x_C[c, 2])
        camera_row(a, x, R_WC, out[row])


@bare
def corner_covariance(J: Array, P: Array, out: Array) -> None:
    """Covariance of each corner [px^2] from the pose's: J (4, 2, 6), P (6, 6) -> out (4, 3).

    out: the entries uu, uv, vv.
    """
    for c in range(4):
        uu = uv = vv = 0.0
        for k in range(6):
            row_u = row_v = 0.0
            for m in range(6):
                row_u += J[c, 0, m] * P[m, k]
                row_v += J[c, 1, m] * P[m, k]
            uu += row_u * J[c, 0, k]
            uv += row_u * J[c, 1, k]
            vv += row_v * J[c, 1, k]
        out[c, 0], out[c, 1], out[c, 2] = uu, uv, vv


@bare
def unit_square(quad: Array, H: Array) -> bool:
    """Homography H (3, 3) from the unit square to a quad (4, 2); False: three corners in a row.

    Corner TL lies at (0, 0), BR at (1, 1). Source: Heckbert, Fundamentals of texture mapping, 1989.
    """
    sx = quad[0, 0] - quad[1, 0] + quad[2, 0] - quad[3, 0]
    sy = quad[0, 1] - quad[1, 1] + quad[2, 1] - quad[3, 1]
    ax, ay = quad[1, 0] - quad[2, 0], quad[1, 1] - quad[2, 1]
    bx, by = quad[3, 0] - quad[2, 0], quad[3, 1] - quad[2, 1]
    det = ax * by - ay * bx
    good = bool(abs(det) >= _FLAT)
    if abs(det) < _LEAST_DET:
        det = _LEAST_DET
    g, h = (sx * by - sy * bx) / det, (ax * sy - ay * sx) / det
    for r in range(2):
        H[r, 0] = quad[1, r] - quad[0, r] + g * quad[1, r]
        H[r, 1] = quad[3, r] - quad[0, r] + h * quad[3, r]
        H[r, 2] = quad[0, r]
    H[2, 0], H[2, 1], H[2, 2] = g, h, 1.0
    return good
