"""The pose of each tag from its four corners: both planar solutions, all tags in one call.

IPPE for squares (Collins and Bartoli, IJCV 2014) on normalised coordinates, then Gauss-Newton on
pixels for both solutions, so that the covariance is that of the estimate.
"""

from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels import projection
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import assign, backward, cholesky, copy, forward
from tagvo.kernels.so3 import rotated
from tagvo.records import Observations, TagPoses

_DAMPING = 1e-6  # a trace of Levenberg damping: a tag seen edge-on must not blow up
_MAX_TURN = 0.5  # rad


class _Work(NamedTuple):
    """Scratch of one tag: r (8,), A (8, 3), J (8, 6), x_C (4, 3); of a step: two gradients (6,),
    the step b (6, 1), the new pose R (3, 3), p (3,), its information H and a factor L (6, 6)."""

    r: Array
    A: Array
    J: Array
    x_C: Array
    g: Array
    g_new: Array
    b: Array
    R_new: Array
    p_new: Array
    H_new: Array
    L: Array


@bare
def homography_at_centre(corners_n: Array, size: float, x: Array, J: Array) -> None:
    """Image x (2,) of a tag's centre and J (2, 2) = d image / d tag plane there [1/m].

    corners_n (4, 2) TL, TR, BR, BL; the unit square has TL at (0, 0), BR at (1, 1) (Heckbert).
    """
    p0, p1, p2, p3 = corners_n[0], corners_n[1], corners_n[2], corners_n[3]
    d1x, d1y, d2x, d2y = p1[0] - p2[0], p1[1] - p2[1], p3[0] - p2[0], p3[1] - p2[1]
    sx, sy = p0[0] - p1[0] + p2[0] - p3[0], p0[1] - p1[1] + p2[1] - p3[1]
    det = d1x * d2y - d2x * d1y
    if abs(det) < 1e-18:
        det = 1e-18
    g, h = (sx * d2y - d2x * sy) / det, (d1x * sy - sx * d1y) / det
    w = 1.0 + 0.5 * (g + h)
    for i in range(2):
        a = p1[i] - p0[i] + g * p1[i]
        b = p3[i] - p0[i] + h * p3[i]
        x[i] = (p0[i] + 0.5 * (a + b)) / w
        J[i, 0] = (a - x[i] * g) / (w * size)
        J[i, 1] = -(b - x[i] * h) / (w * size)  # T's y points up, the unit square's down


@bare
def ippe_rotations(x: Array, J: Array, R_CT: Array, small: Array) -> None:
    """Both rotations R_CT (2, 3, 3) that agree with the image of the plane at its centre.

    x (2,) image of the centre, J (2, 2) its derivative [1/m] (Collins and Bartoli, section 3);
    small (8, 3): scratch.
    """
    norm = np.sqrt(1.0 + x[0] * x[0] + x[1] * x[1])
    c, sx, sy = 1.0 / norm, x[0] / norm, x[1] / norm
    k = 1.0 / (1.0 + c)
    Rv, local, A = small[:3], small[3:6], small[6:, :2]
    Rv[0, 0], Rv[0, 1], Rv[0, 2] = 1.0 - k * sx * sx, -k * sx * sy, sx  # turns the z axis to the
    Rv[1, 0], Rv[1, 1], Rv[1, 2] = -k * sx * sy, 1.0 - k * sy * sy, sy  # line of sight (x, 1)
    Rv[2, 0], Rv[2, 1], Rv[2, 2] = -sx, -sy, c
    b00, b01 = Rv[0, 0] - x[0] * Rv[2, 0], Rv[0, 1] - x[0] * Rv[2, 1]
    b10, b11 = Rv[1, 0] - x[1] * Rv[2, 0], Rv[1, 1] - x[1] * Rv[2, 1]
    det = b00 * b11 - b01 * b10
    for j in range(2):
        A[0, j] = (b11 * J[0, j] - b01 * J[1, j]) / det
        A[1, j] = (b00 * J[1, j] - b10 * J[0, j]) / det
    q = A[0, 0] ** 2 + A[0, 1] ** 2 + A[1, 0] ** 2 + A[1, 1] ** 2
    det_A = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    gamma = np.sqrt(0.5 * (q + np.sqrt(max(q * q - 4.0 * det_A * det_A, 0.0))))
    for i in range(2):
        for j in range(2):
            A[i, j] /= max(gamma, 1e-12)
    b0 = np.sqrt(max(1.0 - A[0, 0] ** 2 - A[1, 0] ** 2, 0.0))
    b1 = np.sqrt(max(1.0 - A[0, 1] ** 2 - A[1, 1] ** 2, 0.0))
    if A[0, 0] * A[0, 1] + A[1, 0] * A[1, 1] > 0.0:
        b1 = -b1
    for s in range(2):
        sign = 1.0 if s == 0 else -1.0
        for i in range(2):
            local[i, 0], local[i, 1] = A[i, 0], A[i, 1]
        local[2, 0], local[2, 1] = sign * b0, sign * b1
        local[0, 2] = local[1, 0] * local[2, 1] - local[2, 0] * local[1, 1]
        local[1, 2] = local[2, 0] * local[0, 1] - local[0, 0] * local[2, 1]
        local[2, 2] = local[0, 0] * local[1, 1] - local[1, 0] * local[0, 1]
        for i in range(3):
            for j in range(3):
                R_CT[s, i, j] = (
                    Rv[i, 0] * local[0, j] + Rv[i, 1] * local[1, j] + Rv[i, 2] * local[2, j]
                )


@bare
def translation(R_CT: Array, X: Array, corners_n: Array, p_CT: Array) -> None:
    """Least-squares p_CT (3,) [m] for a known rotation: rows [1 0 -x; 0 1 -y] p = x Z - X."""
    sx, sy, sq, v0, v1, v2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(4):
        X0, X1, X2 = X[c, 0], X[c, 1], X[c, 2]
        Y0 = R_CT[0, 0] * X0 + R_CT[0, 1] * X1 + R_CT[0, 2] * X2
        Y1 = R_CT[1, 0] * X0 + R_CT[1, 1] * X1 + R_CT[1, 2] * X2
        Y2 = R_CT[2, 0] * X0 + R_CT[2, 1] * X1 + R_CT[2, 2] * X2
        x, y = corners_n[c, 0], corners_n[c, 1]
        bx, by = x * Y2 - Y0, y * Y2 - Y1
        sx, sy, sq = sx + x, sy + y, sq + x * x + y * y
        v0, v1, v2 = v0 + bx, v1 + by, v2 - x * bx - y * by
    # [4 0 -sx; 0 4 -sy; -sx -sy sq] p = v, by elimination
    z = (v2 + 0.25 * (sx * v0 + sy * v1)) / max(sq - 0.25 * (sx * sx + sy * sy), 1e-18)
    p_CT[0], p_CT[1], p_CT[2] = 0.25 * (v0 + sx * z), 0.25 * (v1 + sy * z), z


class _Corners(NamedTuple):
    """Corners of a tag: X (4, 3) in T, x_n (4, 2), J_px_n (4, 2, 2), w (4,) = 1 / sigma_px."""

    X: Array
    x_n: Array
    J_px_n: Array
    w: Array


@bare
def _normal_equations(
    R: Array, p: Array, seen: _Corners, H: Array, g: Array, work: _Work
) -> tuple[float, float]:
    """Information H (6, 6), gradient g (6,); returns whitened cost and sum of squares [px^2].

    The costs are infinite where a corner is not in front of the camera.
    """
    r, J = work.r, work.J
    X, x_n, J_px_n, w = seen
    front = projection.residual(R, p, X, x_n, J_px_n, r, work.A, work.x_C)
    projection.tag_jacobian(work.A, R, X, J)
    cost, square = 0.0, 0.0
    for i in range(6):
        g[i] = 0.0
        for j in range(i + 1):
            H[i, j] = 0.0
    for row in range(8):
        ww = w[row // 2] * w[row // 2]
        square += r[row] * r[row]
        cost += ww * r[row] * r[row]
        for i in range(6):
            a = ww * J[row, i]
            g[i] += a * r[row]
            for j in range(i + 1):
                H[i, j] += a * J[row, j]
    for i in range(6):
        for j in range(i):
            H[j, i] = H[i, j]
    if front:
        return cost, square
    return np.inf, np.inf


@bare
def _step(R: Array, p: Array, H: Array, work: _Work) -> bool:
    """Damped Gauss-Newton step of a pose and its H and work.g into work.R_new, work.p_new."""
    L, b = work.L, work.b
    for i in range(6):
        for j in range(i + 1):
            L[i, j] = H[i, j]
        L[i, i] = H[i, i] * (1.0 + _DAMPING) + 1e-9
        b[i, 0] = work.g[i]
    if not cholesky(L):
        return False
    forward(L, b)
    backward(L, b)
    turn = np.sqrt(b[3, 0] ** 2 + b[4, 0] ** 2 + b[5, 0] ** 2)
    scale = min(1.0, _MAX_TURN / max(turn, 1e-12))  # far outside the quadratic region
    for i in range(6):
        b[i, 0] *= scale
    rotated(R, b[3:, 0], work.R_new)
    for i in range(3):
        work.p_new[i] = p[i] + R[i, 0] * b[0, 0] + R[i, 1] * b[1, 0] + R[i, 2] * b[2, 0]
    return True


@bare
def _refine(R: Array, p: Array, seen: _Corners, steps: int, H: Array, work: _Work) -> float:
    """Gauss-Newton steps on R, p in place while they lower the cost; H (6, 6) at the end.

    Returns the sum of squared residuals [px^2].
    """
    cost, square = _normal_equations(R, p, seen, H, work.g, work)
    for _ in range(steps):
        if not _step(R, p, H, work):
            break
        cost_new, square_new = _normal_equations(
            work.R_new, work.p_new, seen, work.H_new, work.g_new, work
        )
        if not cost_new < cost:
            break
        copy(work.R_new, R)
        assign(work.p_new, p)
        copy(work.H_new, H)
        assign(work.g_new, work.g)
        square, settled = square_new, cost - cost_new < 1e-6 * cost
        cost = cost_new
        if settled:
            break
    return square


@njit
def _solve_all(
    X: Array, size: Array, x_n: Array, J_px_n: Array, sigma_px: Array, steps: int
) -> tuple[Array, Array, Array, Array]:
    n = len(size)
    p, R = np.empty((n, 2, 3)), np.empty((n, 2, 3, 3))
    rms, information = np.empty((n, 2)), np.empty((n, 2, 6, 6))
    centre, J, H = np.empty(2), np.empty((2, 2)), np.empty((2, 6, 6))
    work = _Work(
        np.empty(8), np.empty((8, 3)), np.empty((8, 6)), np.empty((4, 3)), np.empty(6), np.empty(6),
        np.empty((6, 1)), np.empty((3, 3)), np.empty(3), np.empty((6, 6)), np.empty((6, 6)),
    )  # fmt: skip
    R_s, p_s, w, square = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(4), np.empty(2)
    small = np.empty((8, 3))
    for i in range(n):
        homography_at_centre(x_n[i], size[i], centre, J)
        ippe_rotations(centre, J, R_s, small)
        for c in range(4):
            w[c] = 1.0 / sigma_px[i, c]
        seen = _Corners(X[i], x_n[i], J_px_n[i], w)
        for s in range(2):
            translation(R_s[s], X[i], x_n[i], p_s[s])
            square[s] = _refine(R_s[s], p_s[s], seen, steps, H[s], work)
        first = 0 if square[0] <= square[1] else 1
        for s in range(2):
            k = first if s == 0 else 1 - first
            p[i, s], R[i, s], rms[i, s] = p_s[k], R_s[k], np.sqrt(0.25 * square[k])
            information[i, s] = H[k]
    return p, R, rms, information


def solve_tags(obs: Observations, corners_T: Array, size: Array, refine: int) -> TagPoses:
    """Both planar poses of every tag, better one first, by IPPE and `refine` Gauss-Newton steps.

    corners_T (n, 4, 3) [m], size (n,) [m]; a step that does not lower the cost is not taken.
    """
    arrays = _solve_all(corners_T, size, obs.corners_n, obs.J_px_n, obs.sigma_px, refine)
    return TagPoses(*arrays)
