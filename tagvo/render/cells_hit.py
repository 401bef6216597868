"""How a pixel's path lies over one flat surface, and which of its cells the path meets.

The compiled geometry below `tagvo.paint`. Within a pixel a surface's coordinates are linear in the
place, and in time linear between the points of the path. Columns and rows count cells from 0 at
the surface's upper left corner.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tagvo.geometry import IntArray
from tagvo.kernels.jit import bare, njit

Array32: TypeAlias = NDArray[np.float32]
Codes: TypeAlias = NDArray[np.uint8]

CELLS, TORN, BLOB = 0, 1, 2  # what a surface is cut to: its rectangle, a tear's side, an outline
KNOTS = 64  # of a tear's profile or an outline
BARE, BLACK, WHITE = 0, 1, 2  # codes of cells
FIRST_OBJECT = 4  # all higher ones are objects
MANY, OFF = -1, -2  # instead of the one code that a pixel's path meets

# A trace (fields, w): of each pixel of a row the least depth on its path over a surface's plane;
# least and greatest column and row, half a pixel around included; slopes of column, row and depth
# by the pixel's column and row at the middle point (of two the last); column, row and depth at
# each of p points.
SEEN, U0, U1, V0, V1, UX, UY, VX, VY, DX, DY, POINTS = range(12)

_ZERO, _HALF, _ONE, _TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)
_WIDER = np.float32(0.55)  # half a pixel and a tenth: its neighbours' slope is not quite its own
_SURE = np.float32(0.8)  # share of the way to the next edge that is skipped, for the same reason
_FARTHEST = np.float32(24.0)  # [px] skipped at once
_THREE, _TINY, _ROOT2 = np.float32(3), np.float32(1e-12), np.float32(1.4143)
_NOTHING = np.float32(np.inf)
_SLOPED = 3  # column, row and depth


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
def poses_of(H: Array32, i: int, time: Array32, at: float, out: Array32) -> bool:
    """Homographies of surface i at the points of a row's path, whose middle is `at` [knots].

    False where its face is turned away.
    """
    facing = True
    top = H.shape[1] - 2
    for k in range(len(time)):
        if top < 0:
            for e in range(10):
                out[k, e] = H[i, 0, e]
            facing = facing and out[k, 9] < _ZERO
            continue
        t = at + time[k]
        j = min(max(int(t), 0), top)
        f = np.float32(t - j)
        for e in range(10):
            out[k, e] = H[i, j, e] + f * (H[i, j + 1, e] - H[i, j, e])
        facing = facing and out[k, 9] < _ZERO
    return facing


@bare
def trace_row(rays: Array32, y: int, first: int, last: int, H: Array32, trace: Array32) -> None:
    """Trace pixels first..last of row y; rays (h, 6, w), H (p, 10), into trace (fields, w).

    Every loop is over one row of pixels and free of branches, so that it runs on SIMD.
    """
    points, n = H.shape[0], last - first
    a, b = rays[y, 0, first:last], rays[y, 1, first:last]
    seen = trace[SEEN, first:last]
    u0, u1 = trace[U0, first:last], trace[U1, first:last]
    v0, v1 = trace[V0, first:last], trace[V1, first:last]
    for p in range(points):
        u, v = trace[POINTS + p, first:last], trace[POINTS + points + p, first:last]
        d = trace[POINTS + 2 * points + p, first:last]
        h0, h1, h2, h3, h4 = H[p, 0], H[p, 1], H[p, 2], H[p, 3], H[p, 4]
        h5, h6, h7, h8, h9 = H[p, 5], H[p, 6], H[p, 7], H[p, 8], H[p, 9]
        for k in range(n):
            per_w = _ONE / (h6 * a[k] + h7 * b[k] + h8)
            u[k] = (h0 * a[k] + h1 * b[k] + h2) * per_w
            v[k] = (h3 * a[k] + h4 * b[k] + h5) * per_w
            d[k] = h9 * per_w
        if p == 0:
            for k in range(n):
                u0[k], u1[k], v0[k], v1[k], seen[k] = u[k], u[k], v[k], v[k], d[k]
        for k in range(n):
            u0[k] = u[k] if u[k] < u0[k] else u0[k]
            u1[k] = u[k] if u[k] > u1[k] else u1[k]
            v0[k] = v[k] if v[k] < v0[k] else v0[k]
            v1[k] = v[k] if v[k] > v1[k] else v1[k]
            seen[k] = d[k] if d[k] < seen[k] else seen[k]
    for axis in range(_SLOPED):
        _slope(rays, y, first, last, H, axis, trace)
    for axis in range(2):
        by_x, by_y = trace[UX + 2 * axis, first:last], trace[UY + 2 * axis, first:last]
        low, high = trace[U0 + 2 * axis, first:last], trace[U1 + 2 * axis, first:last]
        for k in range(n):
            wide = _WIDER * (abs(by_x[k]) + abs(by_y[k]))
            low[k] -= wide
            high[k] += wide


@bare
def _slope(
    rays: Array32, y: int, first: int, last: int, H: Array32, axis: int, trace: Array32
) -> None:
    """Slopes of column, row or depth (axis 0, 1, 2) by a pixel, at the middle of the points."""
    points = H.shape[0]
    h, at = H[points // 2], POINTS + points // 2
    ax, ay = rays[y, 2, first:last], rays[y, 3, first:last]
    bx, by = rays[y, 4, first:last], rays[y, 5, first:last]
    by_x, by_y = trace[UX + 2 * axis, first:last], trace[UY + 2 * axis, first:last]
    value, d = trace[at + axis * points, first:last], trace[at + 2 * points, first:last]
    h6, h7, per_z = h[6], h[7], _ONE / h[9]
    g, q = (h[3 * axis], h[3 * axis + 1]) if axis < 2 else (h6 - h6, h6 - h6)
    for k in range(last - first):
        per_w = d[k] * per_z
        da, db = (g - value[k] * h6) * per_w, (q - value[k] * h7) * per_w
        by_x[k] = da * ax[k] + db * bx[k]
        by_y[k] = da * ay[k] + db * by[k]


@bare
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
def cut_met(kind: int, outline: Array32, n: int, trace: Array32, x: int) -> int:
    """Whether a path stays off (OFF), within (BARE) or across (MANY) the outline's cut."""
    per = _ONE / np.float32(n)
    u0, u1, v0, v1 = trace[U0, x], trace[U1, x], trace[V0, x], trace[V1, x]
    right, up = (u0 + u1) * per - _ONE, _ONE - (v0 + v1) * per
    reach = ((u1 - u0) + (v1 - v0)) * per
    low, high = outline[KNOTS + 3], outline[KNOTS + 4]
    if kind == TORN:
        d = right * outline[KNOTS] + up * outline[KNOTS + 1] - outline[KNOTS + 2]
        low = -high - low
    else:
        d = np.float32(np.sqrt(right * right + up * up))
    if d - reach > high:
        return OFF
    return BARE if d + reach < low else MANY


@njit
def pixels_ahead(trace: Array32, x: int, n: int, off: bool) -> int:
    """Pixels to the right that surely meet the same single cells, or (off) none, too."""
    px = -_ONE if off else _NOTHING
    for axis in range(2):
        low, high = trace[U0 + 2 * axis, x], trace[U1 + 2 * axis, x]
        speed = abs(trace[UX + 2 * axis, x])
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
    along = x / (abs(x) + abs(y) + _TINY)  # a quarter of a turn is 1, as on a square on its tip
    turn = _ONE - along if y >= _ZERO else _THREE + along
    edge = _knot(outline, float(turn * np.float32((KNOTS - 1) / 4)))
    return code if x * x + y * y < edge * edge else BARE


@bare
def sampled(trace: Array32, x: int, axis: int, samples: Samples, out: Array32) -> None:
    """Column, row or depth (axis 0, 1, 2) of a traced pixel at its samples, into out (n,)."""
    by_x, by_y = trace[UX + 2 * axis, x], trace[UY + 2 * axis, x]
    points = len(samples.time)
    base = POINTS + axis * points
    for j in range(max(points - 1, 1)):
        start = trace[base + j, x]
        step = trace[base + j + 1, x] - start if points > 1 else start - start
        first, last = samples.of[j], samples.of[j + 1]
        right, down = samples.x[first:last], samples.y[first:last]  # slices, for SIMD
        ahead, part = samples.ahead[first:last], out[first:last]
        for k in range(last - first):
            part[k] = start + step * ahead[k] + by_x * right[k] + by_y * down[k]


@bare
def depth_traced(rays: Array32, y: int, x: int, H: Array32, trace: Array32) -> None:
    """The depths of one pixel's trace alone, into the first column of trace (fields, 1)."""
    points = H.shape[0]
    a, b = rays[y, 0, x], rays[y, 1, x]
    for p in range(points):
        per_w = _ONE / (H[p, 6] * a + H[p, 7] * b + H[p, 8])
        d = H[p, 9] * per_w
        trace[POINTS + 2 * points + p, 0] = d
        if p == points // 2:
            da, db = -d * H[p, 6] * per_w, -d * H[p, 7] * per_w
            trace[DX, 0] = da * rays[y, 2, x] + db * rays[y, 4, x]
            trace[DY, 0] = da * rays[y, 3, x] + db * rays[y, 5, x]


@njit
def cells_met(
    trace: Array32, x: int, samples: Samples, first: int, n: int, at: NDArray[np.int32]
) -> None:
    """Where in `cells` the samples of a traced pixel lie on a surface; 0 off it; into at (n,)."""
    u_x, u_y, v_x, v_y = trace[UX, x], trace[UY, x], trace[VX, x], trace[VY, x]
    points, across, start, side = len(samples.time), np.int32(n), np.int32(first), np.float32(n)
    for j in range(max(points - 1, 1)):
        u, v = trace[POINTS + j, x], trace[POINTS + points + j, x]
        du = trace[POINTS + j + 1, x] - u if points > 1 else u - u
        dv = trace[POINTS + points + j + 1, x] - v if points > 1 else v - v
        low, high = samples.of[j], samples.of[j + 1]
        right, down = samples.x[low:high], samples.y[low:high]
        ahead, part = samples.ahead[low:high], at[low:high]
        for k in range(high - low):
            column = u + du * ahead[k] + u_x * right[k] + u_y * down[k]
            row = v + dv * ahead[k] + v_x * right[k] + v_y * down[k]
            on = (column >= _ZERO) & (row >= _ZERO) & (column < side) & (row < side)
            cell = np.int32(row) * across + np.int32(column) + start
            part[k] = cell if on else np.int32(0)


@njit
def cut_samples(
    scene: Surfaces,
    i: int,
    trace: Array32,
    x: int,
    samples: Samples,
    u: Array32,
    v: Array32,
    ink: Codes,
) -> None:
    """Take from the codes (n,) of surface i at a pixel's samples what its outline cuts off."""
    sampled(trace, x, 0, samples, u)
    sampled(trace, x, 1, samples, v)
    kind, outline, per = scene.kind[i], scene.outline[i], _TWO / np.float32(scene.across[i])
    for k in range(len(u)):
        if ink[k] != BARE:
            ink[k] = _cut(kind, outline, u[k] * per - _ONE, _ONE - v[k] * per, ink[k])
