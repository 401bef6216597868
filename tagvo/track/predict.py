"""Where the tags of a map must be in the image, and how sure that is; compiled.

The camera pose's error is [dp_WC in W, right rotation in C], as everywhere.
"""

import math

import numpy as np

from tagvo.camera.model import Point, distort_point
from tagvo.geometry import Array
from tagvo.kernels.gauss_newton import add_row
from tagvo.kernels.jit import bare, leaf, njit
from tagvo.kernels.linalg import (
    add_scaled,
    add_times,
    assign,
    copy,
    inverse_spd,
    subtract_times,
)
from tagvo.kernels.projection import camera_row
from tagvo.kernels.so3 import rotated
from tagvo.track.tag_model import FLAT, Belief, Lens, MapArrays, TrackedTags

_NEAR = 0.02  # [m] along z of C
_MIN_COSINE = 0.15  # a tag seen flatter than 81 deg is not worth a look
_STRETCH = 3.0  # of a side over half a diagonal, by a lens that stretches its rim twofold
_HUBER = 3.0
_STEPS = 3  # of Gauss-Newton; the last one only looks at what is left


@leaf
def to_pixel(lens: Lens, x: float, y: float) -> Point:
    """Pixel u, v of normalised x, y, and du/dx, du/dy, dv/dx, dv/dy."""
    if lens.model == FLAT:
        return x, y, 1.0, 0.0, 0.0, 1.0
    u, v, ux, uy, vx, vy = distort_point(lens.model, x, y, lens.coeffs)
    f = lens.intrinsics
    return u * f[0] + f[2], v * f[1] + f[3], ux * f[0], uy * f[0], vx * f[1], vy * f[1]


@bare
def project_tag(
    R_WC: Array, p_WC: Array, tags: MapArrays, i: int, lens: Lens, quad_n: Array, quad_px: Array,
    J: Array,
) -> bool:  # fmt: skip
    """Corners of tag i: quad_n (4, 2) normalised, quad_px (4, 2), J (4, 2, 6) d pixel / d pose.

    False, and nothing to rely on, where the camera cannot see its face.
    """
    p, R, corners = tags.p_WT[i], tags.R_WT[i], tags.corners_T[i]
    dx, dy, dz = p_WC[0] - p[0], p_WC[1] - p[1], p_WC[2] - p[2]
    z = -(R_WC[0, 2] * dx + R_WC[1, 2] * dy + R_WC[2, 2] * dz)
    if z < _NEAR:
        return False
    height = R[0, 2] * dx + R[1, 2] * dy + R[2, 2] * dz
    if height < _MIN_COSINE * math.sqrt(dx * dx + dy * dy + dz * dz):
        return False
    for c in range(4):
        X0, X1, X2 = corners[c, 0], corners[c, 1], corners[c, 2]
        w0 = R[0, 0] * X0 + R[0, 1] * X1 + R[0, 2] * X2 - dx
        w1 = R[1, 0] * X0 + R[1, 1] * X1 + R[1, 2] * X2 - dy
        w2 = R[2, 0] * X0 + R[2, 1] * X1 + R[2, 2] * X2 - dz
        cx = R_WC[0, 0] * w0 + R_WC[1, 0] * w1 + R_WC[2, 0] * w2
        cy = R_WC[0, 1] * w0 + R_WC[1, 1] * w1 + R_WC[2, 1] * w2
        cz = R_WC[0, 2] * w0 + R_WC[1, 2] * w1 + R_WC[2, 2] * w2
        if cz < _NEAR:
            return False
        x, y = cx / cz, cy / cz
        if x * x + y * y >= lens.max_radius * lens.max_radius:
            return False
        u, v, ux, uy, vx, vy = to_pixel(lens, x, y)
        quad_n[c, 0], quad_n[c, 1], quad_px[c, 0], quad_px[c, 1] = x, y, u, v
        x_C = (cx, cy, cz)
        camera_row((ux / cz, uy / cz, -(ux * x + uy * y) / cz), x_C, R_WC, J[c, 0])
        camera_row((vx / cz, vy / cz, -(vx * x + vy * y) / cz), x_C, R_WC, J[c, 1])
    return True


@bare
def may_be_seen(
    R_WC: Array, p_WC: Array, tags: MapArrays, i: int, lens: Lens, min_side: float
) -> bool:
    """A quick look before `project_tag`: False only where tag i is no use for certain.

    Its centre lies between its corners, hence within what the image shows if they do; no side can
    be longer than the tag would look from straight above.
    """
    p = tags.p_WT[i]
    dx, dy, dz = p[0] - p_WC[0], p[1] - p_WC[1], p[2] - p_WC[2]
    z = R_WC[0, 2] * dx + R_WC[1, 2] * dy + R_WC[2, 2] * dz
    if z < _NEAR:
        return False
    x = R_WC[0, 0] * dx + R_WC[1, 0] * dy + R_WC[2, 0] * dz
    y = R_WC[0, 1] * dx + R_WC[1, 1] * dy + R_WC[2, 1] * dz
    reach = lens.reach
    if not (reach[0] * z <= x <= reach[1] * z and reach[2] * z <= y <= reach[3] * z):
        return False
    X = tags.corners_T[i, 1]
    half = math.sqrt(X[0] * X[0] + X[1] * X[1])  # of a diagonal
    longest = _STRETCH * half * max(lens.intrinsics[0], lens.intrinsics[1])
    return bool(longest >= min_side * (z - half))


@bare
def laying_px(R_WC: Array, p_WC: Array, tags: MapArrays, i: int, lens: Lens) -> float:
    """How far a laying error of one sigma moves the corners of tag i in the image, about [px]."""
    s, X = tags.laying[i], tags.corners_T[i, 1]
    r2 = X[0] * X[0] + X[1] * X[1]
    p = tags.p_WT[i]
    dx, dy, dz = p[0] - p_WC[0], p[1] - p_WC[1], p[2] - p_WC[2]
    z = R_WC[0, 2] * dx + R_WC[1, 2] * dy + R_WC[2, 2] * dz
    across = s[0] * s[0] + s[5] * s[5] * r2
    slant = max((dx * dx + dy * dy + dz * dz) / (z * z) - 1.0, 0.0)
    out_of_plane = (s[2] * s[2] + s[3] * s[3] * r2) * slant
    return float(math.sqrt(across + out_of_plane) * lens.intrinsics[0] / z)


@bare
def largest_sigma(spread: Array) -> float:
    """Standard deviation along the worst direction of the worst corner; spread (4, 3) [px^2]."""
    worst = 0.0
    for c in range(4):
        uu, uv, vv = spread[c]
        mean, half = 0.5 * (uu + vv), 0.5 * (uu - vv)
        worst = max(worst, mean + math.sqrt(half * half + uv * uv))
    return math.sqrt(max(worst, 0.0))


@bare
def extent(quad_px: Array) -> tuple[float, float]:
    """Shortest side and least height of a quad (4, 2) across a side [px]."""
    d0x, d0y = quad_px[2, 0] - quad_px[0, 0], quad_px[2, 1] - quad_px[0, 1]
    d1x, d1y = quad_px[3, 0] - quad_px[1, 0], quad_px[3, 1] - quad_px[1, 1]
    area = 0.5 * (d0x * d1y - d0y * d1x)
    shortest, longest = np.inf, 0.0
    for k in range(4):
        x, y = quad_px[k, 0] - quad_px[k - 1, 0], quad_px[k, 1] - quad_px[k - 1, 1]
        length = math.sqrt(x * x + y * y)
        shortest, longest = min(shortest, length), max(longest, length)
    return shortest, area / max(longest, 1e-9)


@bare
def inside(quad_px: Array, lens: Lens, margin: float) -> bool:
    """Whether all four corners lie at least `margin` [px] within the image's rim."""
    for c in range(4):
        u, v = quad_px[c, 0], quad_px[c, 1]
        if not (margin <= u <= lens.size[0] - 1.0 - margin):
            return False
        if not (margin <= v <= lens.size[1] - 1.0 - margin):
            return False
    return True


@njit
def posterior(
    prior: Belief, tags: MapArrays, lens: Lens, found: TrackedTags, count: int, out: Belief,
    chi: Array,
) -> bool:  # fmt: skip
    """The pose by a prior and the corners of `count` tags, robust against a few wrong tags.

    Writes out and chi (count,): rms of each tag's residual over its sigma, laying included.
    Gauss-Newton on the posterior with Huber's weight a tag; False: nothing positive to invert.
    """
    R_WC, p_WC, P = out
    R0, p0, P0 = prior
    rows, corners_px, sigma_px = found.rows, found.corners_px, found.sigma_px
    info, H, b = np.empty((6, 6)), np.empty((6, 6)), np.empty((6, 1))
    quad_n, quad_px, J = np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 2, 6))
    xi = np.zeros(6)
    if not inverse_spd(P0, info):
        return False
    R_WC[:], p_WC[:] = R0, p0
    for step in range(_STEPS):
        copy(info, H)
        b[:] = 0.0
        subtract_times(info, xi, b[:, 0])
        for t in range(count):
            i = rows[t]
            chi[t] = np.inf
            if not project_tag(R_WC, p_WC, tags, i, lens, quad_n, quad_px, J):
                continue
            lay = laying_px(R_WC, p_WC, tags, i, lens)
            square = 0.0
            for c in range(4):
                for r in range(2):
                    e = corners_px[t, c, r] - quad_px[c, r]
                    square += e * e / (sigma_px[t, c] * sigma_px[t, c] + lay * lay)
            chi[t] = math.sqrt(square / 8.0)
            weight = 1.0 if chi[t] <= _HUBER else _HUBER / chi[t]
            for c in range(4):
                w = weight / (sigma_px[t, c] * sigma_px[t, c] + 4.0 * lay * lay)
                for r in range(2):
                    add_row(J[c, r], corners_px[t, c, r] - quad_px[c, r], w, H, b[:, 0])
        if not inverse_spd(H, P):
            return False
        if step == _STEPS - 1:
            break
        add_times(P, b[:, 0], xi)
        rotated(R0, xi[3:], R_WC)
        assign(p0, p_WC)
        add_scaled(xi[:3], 1.0, p_WC)
    return True


@njit
def sides_in_view(R_WC: Array, p_WC: Array, tags: MapArrays, lens: Lens, sides: Array) -> None:
    """Shortest image side [px] of every tag wholly in view into sides (n,), 0: not in view."""
    quad_n, quad_px, J = np.empty((4, 2)), np.empty((4, 2)), np.empty((4, 2, 6))
    for i in range(len(tags.p_WT)):
        sides[i] = 0.0
        if not may_be_seen(R_WC, p_WC, tags, i, lens, 0.0):
            continue
        if project_tag(R_WC, p_WC, tags, i, lens, quad_n, quad_px, J) and inside(
            quad_px, lens, 0.0
        ):
            sides[i] = extent(quad_px)[0]
