"""How a pixel's path lies over one flat surface, and which of its cells the path meets.

The compiled geometry below `tagvo.paint`. Within a pixel a surface's coordinates are linear in the
place, and in time linear between the points of the path. Columns and rows count cells from 0 at
the surface's upper left corner.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tagvo.compiled import njit
from tagvo.geometry import IntArray

Array32: TypeAlias = NDArray[np.float32]
Codes: TypeAlias = NDArray[np.uint8]

CELLS, TORN, BLOB = 0, 1, 2  # what a surface is cut to: its rectangle, a tear's side, an outline
KNOTS = 64  # of a tear's profile or an outline
BARE, BLACK, WHITE = 0, 1, 2  # codes of cells; higher ones are objects
MANY, OFF = -1, -2  # instead of the one code that a pixel's path meets

# A trace, a row of floats: least and greatest column and row of a pixel's path over a surface's
# plane, half a pixel around included; slopes of column, row and depth by the pixel's column and
# row at the middle point, of two the last; column, row and depth at each of p points.
U0, U1, V0, V1, UX, UY, VX, VY, DX, DY, POINTS = range(11)

_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_WIDER = np.float32(0.55)  # half a pixel and a tenth: its neighbours' slope is not quite its own
_SURE = np.float32(0.8)  # share of the way to the next edge that is skipped, for the same reason
_FARTHEST = np.float32(24.0)  # [px] skipped at once
_FACING = np.float32(-1e-6)
_TURN, _ROOT2 = np.float32(2.0 * np.pi), np.float32(1.4143)
_NOTHING = np.float32(np.inf)


class Surfaces(NamedTuple):
    """m flat surfaces that may show in a frame.

    box (m, 4): x0 x1 y0 y1 [px], high ends excluded; H (m, knots, 10): homographies from
    normalised coordinates to cells at each knot of time, and -p_z; kind, across (cells a side),
    first (of them in `cells`) (m,); cells[0] is BARE; outline (m, KNOTS + 5), see `tagvo.patches`.
    """

    box: IntArray
    H: Array32
    kind: IntArray
    across: IntArray
    first: IntArray
    cells: Codes
    outline: Array32


class Samples(NamedTuple):
    """n samples of a pixel in the order of their times, and the p points of a path.

    x, y (n,): column, row [px] from the centre; ahead (n,): time after the point before, in
    shares of the gap between points; of (p,): number of the last point's samples excluded, sample
    of[j]..of[j + 1] follow point j; time (p,): of the points after the middle of the row's
    exposure [knots].
    """

    x: Array32
    y: Array32
    ahead: Array32
    of: IntArray
    time: Array32


@njit
def poses_of(H: Array32, i: int, time: Array32, at: float, out: Array32) -> None:
    """Homographies of surface i at the points of a row's path, whose middle is `at` [knots]."""
    top = H.shape[1] - 2
    for k in range(len(time)):
        if top < 0:
            for e in range(10):
                out[k, e] = H[i, 0, e]
            continue
        t = at + time[k]
        j = min(max(int(t), 0), top)
        f = np.float32(t - j)
        for e in range(10):
            out[k, e] = H[i, j, e] + f * (H[i, j + 1, e] - H[i, j, e])


@njit
def trace_pixel(rays: Array32, y: int, x: int, H: Array32, out: Array32, m: int) -> bool:
    """Trace a pixel into out[m]; False where a ray does not meet the plane from its face.

    H (p, 10) at the points.
    """
    points = H.shape[0]
    a, b = rays[y, x, 0], rays[y, x, 1]
    u0, u1, v0, v1 = _NOTHING, -_NOTHING, _NOTHING, -_NOTHING
    for k in range(points):
        w = H[k, 6] * a + H[k, 7] * b + H[k, 8]
        if not w < _FACING:
            return False
        per_w = _ONE / w
        u = (H[k, 0] * a + H[k, 1] * b + H[k, 2]) * per_w
        v = (H[k, 3] * a + H[k, 4] * b + H[k, 5]) * per_w
        d = H[k, 9] * per_w
        out[m, POINTS + k] = u
        out[m, POINTS + points + k] = v
        out[m, POINTS + 2 * points + k] = d
        u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        if k == points // 2:
            h6, h7 = H[k, 6], H[k, 7]
            ua, ub = (H[k, 0] - u * h6) * per_w, (H[k, 1] - u * h7) * per_w
            va, vb = (H[k, 3] - v * h6) * per_w, (H[k, 4] - v * h7) * per_w
            da, db = -d * h6 * per_w, -d * h7 * per_w
    ax, ay, bx, by = rays[y, x, 2], rays[y, x, 3], rays[y, x, 4], rays[y, x, 5]
    ux, uy, vx, vy = ua * ax + ub * bx, ua * ay + ub * by, va * ax + vb * bx, va * ay + vb * by
    wide_u, wide_v = _WIDER * (abs(ux) + abs(uy)), _WIDER * (abs(vx) + abs(vy))
    out[m, U0], out[m, U1] = u0 - wide_u, u1 + wide_u
    out[m, V0], out[m, V1] = v0 - wide_v, v1 + wide_v
    out[m, UX], out[m, UY], out[m, VX], out[m, VY] = ux, uy, vx, vy
    out[m, DX], out[m, DY] = da * ax + db * bx, da * ay + db * by
    return True


@njit
def code_met(cells: Codes, first: int, n: int, u0: float, u1: float, v0: float, v1: float) -> int:
    """The one code of n x n cells that a path meets, MANY, or OFF where it meets no cell."""
    if not (u1 > 0.0 and u0 < n and v1 > 0.0 and v0 < n):
        return OFF
    if not (u0 >= 0.0 and u1 < n and v0 >= 0.0 and v1 < n):
        return MANY
    column, row = int(u0), int(v0)
    code = cells[first + row * n + column]
    for r in range(row, int(v1) + 1):
        for c in range(column, int(u1) + 1):
            if cells[first + r * n + c] != code:
                return MANY
    return int(code)


@njit
def cut_met(kind: int, outline: Array32, n: int, trace: Array32, m: int) -> int:
    """Whether a path stays off (OFF), within (BARE) or across (MANY) the outline's cut."""
    per = _ONE / np.float32(n)
    u0, u1, v0, v1 = trace[m, U0], trace[m, U1], trace[m, V0], trace[m, V1]
    x, y = (u0 + u1) * per - _ONE, _ONE - (v0 + v1) * per
    reach = ((u1 - u0) + (v1 - v0)) * per
    low, high = outline[KNOTS + 3], outline[KNOTS + 4]
    if kind == TORN:
        d = x * outline[KNOTS] + y * outline[KNOTS + 1] - outline[KNOTS + 2]
        low = -high - low
    else:
        d = np.float32(np.sqrt(x * x + y * y))
    if d - reach > high:
        return OFF
    return BARE if d + reach < low else MANY


@njit
def pixels_ahead(trace: Array32, m: int, n: int, off: bool) -> int:
    """Pixels to the right that surely meet the same single cells, or (off) none, too."""
    px = -_ONE if off else _NOTHING
    for axis in range(2):
        low, high = trace[m, 2 * axis], trace[m, 2 * axis + 1]
        speed = abs(trace[m, UX + 2 * axis])
        if off:
            px = max(px, max(low - np.float32(n), -high) / speed)
        else:
            px = min(px, min(low - np.floor(low), np.floor(high) + _ONE - high) / speed)
    return int(min(_SURE * px, _FARTHEST))


@njit
def _knot(outline: Array32, t: float) -> float:
    """The outline at t in 0..KNOTS - 1, linear between its knots."""
    j = min(max(int(t), 0), KNOTS - 2)
    return float(outline[j] + np.float32(t - j) * (outline[j + 1] - outline[j]))


@njit
def _cut(kind: int, outline: Array32, x: float, y: float, code: int) -> int:
    """The code at x, y (-1..1 across the surface) once it is cut to its outline."""
    if kind == TORN:
        c, s, at, rim = outline[KNOTS], outline[KNOTS + 1], outline[KNOTS + 2], outline[KNOTS + 3]
        beyond = x * c + y * s - at
        along = (y * c - x * s) / _ROOT2  # -1..1
        edge = _knot(outline, (along + _ONE) * _HALF * np.float32(KNOTS - 1))
        if beyond > edge:
            return BARE
        return WHITE if beyond > edge - rim else code
    angle = np.float32(np.arctan2(y, x)) / _TURN
    edge = _knot(outline, (angle - np.floor(angle)) * np.float32(KNOTS - 1))
    return code if x * x + y * y < edge * edge else BARE


@njit
def sampled(trace: Array32, m: int, axis: int, points: int, samples: Samples, out: Array32) -> None:
    """Column, row or depth (axis 0, 1, 2) of a traced pixel at its samples, into out (n,)."""
    by_x, by_y = trace[m, UX + 2 * axis], trace[m, UY + 2 * axis]
    base = POINTS + axis * points
    for j in range(max(points - 1, 1)):
        start = trace[m, base + j]
        step = trace[m, base + j + 1] - start if points > 1 else start - start
        first, last = samples.of[j], samples.of[j + 1]
        x, y = samples.x[first:last], samples.y[first:last]  # slices: so that the loop is SIMD
        ahead, part = samples.ahead[first:last], out[first:last]
        for k in range(last - first):
            part[k] = start + step * ahead[k] + by_x * x[k] + by_y * y[k]


@njit
def inks(
    scene: Surfaces,
    i: int,
    u: Array32,
    v: Array32,
    at: NDArray[np.int32],
    index: NDArray[np.uint32],
    inks: Codes,
) -> None:
    """Codes of surface i at columns u, rows v (n,), into inks (n,); at, index: one buffer."""
    cells, n, first = scene.cells, np.int32(scene.across[i]), np.int32(scene.first[i])
    side = np.float32(n)
    for k in range(len(u)):
        place = np.int32(v[k]) * n + np.int32(u[k]) + first
        on = u[k] >= _ZERO and v[k] >= _ZERO and u[k] < side and v[k] < side
        at[k] = place if on else 0
    for k in range(len(u)):
        inks[k] = cells[index[k]]
    kind = scene.kind[i]
    if kind != CELLS:
        outline, per = scene.outline[i], _TWO / side
        for k in range(len(u)):
            if inks[k] != BARE:
                x, y = u[k] * per - _ONE, _ONE - v[k] * per
                inks[k] = _cut(kind, outline, x, y, inks[k])
