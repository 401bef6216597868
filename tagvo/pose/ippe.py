"""The pose of each tag from its four corners: both planar solutions, all tags in one call.

IPPE for squares (Collins and Bartoli, IJCV 2014) on normalised coordinates, then Gauss-Newton on
pixels for both solutions, so that the covariance is that of the estimate.
"""

from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels import projection
from tagvo.kernels.gauss_newton import add_row, clear, damped_step, mirror
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import add_times, assign, copy, multiply, scale, square
from tagvo.kernels.projection import unit_square
from tagvo.kernels.so3 import rotated
from tagvo.records import Observations, TagPoses

_DAMPING = 1e-6  # a trace of Levenberg damping: a tag seen edge-on must not blow up
_RIDGE = 1e-9  # [1/m^2, 1/rad^2] for a diagonal that is zero
_MAX_TURN = 0.5  # rad


class _Pose(NamedTuple):
    """A pose R (3, 3), p (3,) of a tag with its normal equations H (6, 6), g (6,)."""

    R: Array
    p: Array
    H: Array
    g: Array


class _Work(NamedTuple):
    """Scratch of one tag: r (8,), A (8, 3), J (8, 6), x_C (4, 3); of a step: L (6, 6), b (6, 1) of
    `damped_step`, and where it leads."""

    r: Array
    A: Array
    J: Array
    x_C: Array
    L: Array
    b: Array
    new: _Pose


@bare
def homography_at_centre(corners_n: Array, size: float, x: Array, J: Array, H: Array) -> None:
    """Image x (2,) of a tag's centre and J (2, 2) = d image / d tag plane there [1/m].

    corners_n (4, 2) TL, TR, BR, BL; H (3, 3): scratch.
    """
    unit_square(corners_n, H)
    g, h = H[2, 0], H[2, 1]
    w = 1.0 + 0.5 * (g + h)
    for i in range(2):
        a, b = H[i, 0], H[i, 1]
        x[i] = (H[i, 2] + 0.5 * (a + b)) / w
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
        multiply(Rv, local, R_CT[s])


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
def _normal_equations(tag: _Pose, seen: _Corners, work: _Work) -> tuple[float, float]:
    """Writes H and g at a tag's pose; returns whitened cost and sum of squares [px^2].

    The costs are infinite where a corner is not in front of the camera.
    """
    r, J = work.r, work.J
    X, x_n, J_px_n, w = seen
    front = projection.residual(tag.R, tag.p, X, x_n, J_px_n, r, work.A, work.x_C)
    projection.tag_jacobian(work.A, tag.R, X, J)
    cost, total = 0.0, 0.0
    clear(tag.H, tag.g)
    for row in range(8):
        ww = w[row // 2] * w[row // 2]
        total += r[row] * r[row]
        cost += ww * r[row] * r[row]
        add_row(J[row], r[row], ww, tag.H, tag.g)
    mirror(tag.H)
    if front:
        return cost, total
    return np.inf, np.inf


@bare
def _step(tag: _Pose, work: _Work) -> bool:
    """Damped Gauss-Newton step of a pose into work.new."""
    b, new = work.b[:, 0], work.new
    if not damped_step(tag.H, tag.g, _DAMPING, _RIDGE, work.L, work.b):
        return False
    turn = np.sqrt(square(b[3:]))
    scale(b, min(1.0, _MAX_TURN / max(turn, 1e-12)))  # far outside the quadratic region
    rotated(tag.R, b[3:], new.R)
    assign(tag.p, new.p)
    add_times(tag.R, b[:3], new.p)
    return True


@bare
def _refine(tag: _Pose, seen: _Corners, steps: int, work: _Work) -> float:
    """Gauss-Newton steps on a pose in place while they lower the cost; its H at the end.

    Returns the sum of squared residuals [px^2].
    """
    cost, total = _normal_equations(tag, seen, work)
    new = work.new
    for _ in range(steps):
        if not _step(tag, work):
            break
        cost_new, total_new = _normal_equations(new, seen, work)
        if not cost_new < cost:
            break
        copy(new.R, tag.R)
        assign(new.p, tag.p)
        copy(new.H, tag.H)
        assign(new.g, tag.g)
        total, settled = total_new, cost - cost_new < 1e-6 * cost
        cost = cost_new
        if settled:
            break
    return total


@njit
def _solve_all(
    X: Array, size: Array, x_n: Array, J_px_n: Array, sigma_px: Array, steps: int
) -> tuple[Array, Array, Array, Array]:
    n = len(size)
    p, R = np.empty((n, 2, 3)), np.empty((n, 2, 3, 3))
    rms, information = np.empty((n, 2)), np.empty((n, 2, 6, 6))
    centre, J, H, g = np.empty(2), np.empty((2, 2)), np.empty((2, 6, 6)), np.empty(6)
    new = _Pose(np.empty((3, 3)), np.empty(3), np.empty((6, 6)), np.empty(6))
    work = _Work(
        np.empty(8), np.empty((8, 3)), np.empty((8, 6)), np.empty((4, 3)), np.empty((6, 6)),
        np.empty((6, 1)), new,
    )  # fmt: skip
    R_s, p_s, w, total = np.empty((2, 3, 3)), np.empty((2, 3)), np.empty(4), np.empty(2)
    small, tilt = np.empty((8, 3)), np.empty((3, 3))
    for i in range(n):
        homography_at_centre(x_n[i], size[i], centre, J, tilt)
        ippe_rotations(centre, J, R_s, small)
        for c in range(4):
            w[c] = 1.0 / sigma_px[i, c]
        seen = _Corners(X[i], x_n[i], J_px_n[i], w)
        for s in range(2):
            translation(R_s[s], X[i], x_n[i], p_s[s])
            total[s] = _refine(_Pose(R_s[s], p_s[s], H[s], g), seen, steps, work)
        first = 0 if total[0] <= total[1] else 1
        for s in range(2):
            k = first if s == 0 else 1 - first
            p[i, s], R[i, s], rms[i, s] = p_s[k], R_s[k], np.sqrt(0.25 * total[k])
            information[i, s] = H[k]
    return p, R, rms, information


def solve_tags(obs: Observations, corners_T: Array, size: Array, refine: int) -> TagPoses:
    """Both planar poses of every tag, better one first, by IPPE and `refine` Gauss-Newton steps.

    corners_T (n, 4, 3) [m], size (n,) [m]; a step that does not lower the cost is not taken.
    """
    arrays = _solve_all(corners_T, size, obs.corners_n, obs.J_px_n, obs.sigma_px, refine)
    return TagPoses(*arrays)
