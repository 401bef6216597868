"""Is this the tag it should be, and does it lie just there? Its cells and their edges; compiled.

The unit square is the tag's border: corner TL at (0, 0), BR at (1, 1).
"""

import math
from typing import NamedTuple

import numpy as np

from tagvo.camera.model import Point
from tagvo.geometry import Array
from tagvo.kernels.jit import bare, leaf
from tagvo.kernels.linalg import cholesky
from tagvo.kernels.projection import unit_square
from tagvo.track.predict import to_pixel
from tagvo.track.side_fit import grey
from tagvo.track.tag_model import Cells, Gray, Lens, Limits, MapArrays

_MIN_SEEN = 0.6  # share of the promised cells that must lie in the image
_CLEAR = 0.15  # share of the contrast by which a cell must be on its side of the threshold
_LEVELS = 4  # unknowns of the light on a tag: mean, slopes in u and v, half the contrast
_ACROSS_PX = 1.2  # how far on either side of an inner edge the light is looked at
_OFF = 0.75  # mean response of inner edges, 0 aligned, 1 off by 1.2 px or more
_FEW_EDGES = 4.0  # below, a mean says nothing
_TOP, _NEAR_BEST = 2, 0.15  # steps around the best correlation, and how much worse is as good


class PatternScratch(NamedTuple):
    """What `is_there` and `find_pattern` write on.

    light (c, c), small (8, 4); at (c * c, 3), score (k, k), where k bounds the steps; shift (2,)
    [px]: the answer of `find_pattern`.
    """

    light: Array
    small: Array
    at: Array
    score: Array
    shift: Array


@leaf
def _place(H: Array, lens: Lens, u: float, v: float) -> Point:
    """Pixel (and its derivatives, as `to_pixel`) of a place on the tag."""
    w = H[2, 0] * u + H[2, 1] * v + 1.0
    x = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w
    y = (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
    return to_pixel(lens, x, y)


@leaf
def _within(image: Gray, u: float, v: float, margin: float) -> bool:
    h, w = image.shape
    return bool(margin <= u < w - 1.0 - margin and margin <= v < h - 1.0 - margin)


@bare
def cell_light(
    image: Gray, lens: Lens, H: Array, cells: Cells, border: int, reach_px: float, light: Array
) -> int:
    """Grey value of each promised cell into light (c, c), NaN where out of the image; -> how many.

    reach_px: the mean of five samples in a cross of this size, 0: the centre alone.
    """
    c = len(cells)
    pad, count = 0.5 * (c - border), 0
    for i in range(c):
        for j in range(c):
            light[i, j] = np.nan
            if cells[i, j] == 0:
                continue
            place = _place(H, lens, (j + 0.5 - pad) / border, (i + 0.5 - pad) / border)
            u, v = place[0], place[1]
            if not _within(image, u, v, reach_px):
                continue
            value = grey(image, u, v)
            if reach_px > 0.0:
                d = reach_px
                value += grey(image, u - d, v) + grey(image, u + d, v)
                value += grey(image, u, v - d) + grey(image, u, v + d)
                value *= 0.2
            light[i, j] = value
            count += 1
    return count


@bare
def fit_light(light: Array, cells: Cells, model: Array, A: Array) -> bool:
    """Least squares light = m0 + m1 j + m2 i + m3 cell over the cells seen; model (4,).

    A (4, 4): scratch.
    """
    c = len(cells)
    n = x = y = s = xx = xy = xs = yy = ys = ss = bn = bx = by = bs = 0.0
    middle = 0.5 * (c - 1)
    for i in range(c):
        for j in range(c):
            value, cell = light[i, j], float(cells[i, j])
            if cell == 0.0 or value != value:
                continue
            u, v = (j - middle) / c, (i - middle) / c
            n, x, y, s = n + 1.0, x + u, y + v, s + cell
            xx, xy, xs = xx + u * u, xy + u * v, xs + u * cell
            yy, ys, ss = yy + v * v, ys + v * cell, ss + cell * cell
            bn, bx, by, bs = bn + value, bx + u * value, by + v * value, bs + cell * value
    A[0, 0], A[1, 0], A[2, 0], A[3, 0] = n, x, y, s
    A[1, 1], A[2, 1], A[3, 1] = xx, xy, xs
    A[2, 2], A[3, 2], A[3, 3] = yy, ys, ss
    for m in range(_LEVELS):
        A[m, m] += 1e-6
    if not cholesky(A):
        return False
    model[0], model[1], model[2], model[3] = bn, bx, by, bs
    for m in range(_LEVELS):
        for k in range(m):
            model[m] -= A[m, k] * model[k]
        model[m] /= A[m, m]
    for m in range(_LEVELS - 1, -1, -1):
        for k in range(m + 1, _LEVELS):
            model[m] -= A[k, m] * model[k]
        model[m] /= A[m, m]
    return True


@bare
def wrong_cells(light: Array, cells: Cells, model: Array) -> tuple[int, float]:
    """Cells that read wrong, or hardly right, by a fitted light; and the mean clearance [grey].

    The clearance is that of the worse colour, as the decision margin of the AprilTag library.
    """
    c, wrong = len(cells), 0
    middle = 0.5 * (c - 1)
    white = black = whites = blacks = 0.0
    for i in range(c):
        for j in range(c):
            if cells[i, j] == 0 or np.isnan(light[i, j]):
                continue
            level = model[0] + model[1] * (j - middle) / c + model[2] * (i - middle) / c
            d = (light[i, j] - level) * cells[i, j]
            if d < _CLEAR * model[3]:
                wrong += 1
            if cells[i, j] > 0:
                white += d
                whites += 1.0
            else:
                black += d
                blacks += 1.0
    return wrong, min(white / max(whites, 1.0), black / max(blacks, 1.0))


@bare
def inner_edges_off(
    image: Gray, lens: Lens, H: Array, cells: Cells, border: int, model: Array
) -> float:
    """How far the edges between unlike cells lie from where they should: 0 .. 1 (1.2 px or more).

    Each edge answers with the mean light just at and around it, less the threshold, signed by its
    sense; means over the left and right, and the upper and lower half of the tag, so that a
    stretched fit shows as well as a shifted one. -> the largest of them.
    """
    worst = 0.0
    for axis in range(2):
        low, high = _edges_off(image, lens, H, cells, border, model, axis)
        worst = max(worst, low, high)
    return worst


@bare
def _edges_off(
    image: Gray, lens: Lens, H: Array, cells: Cells, border: int, model: Array, axis: int
) -> tuple[float, float]:
    """As `inner_edges_off`, of the edges across one axis: in its lower and in its upper half."""
    c = len(cells)
    pad, middle = 0.5 * (c - border), 0.5 * (c - 1)
    sum_low = sum_high = low = high = 0.0
    contrast = max(model[3], 1e-6)
    for i in range(c):
        for j in range(c - 1):
            r, q = (i, j) if axis == 0 else (j, i)
            r2, q2 = (i, j + 1) if axis == 0 else (j + 1, i)
            sign = float(cells[r2, q2])
            if cells[r, q] * cells[r2, q2] >= 0:
                continue
            x, y = 0.5 * (q + q2), 0.5 * (r + r2)
            place = _place(H, lens, (x + 0.5 - pad) / border, (y + 0.5 - pad) / border)
            if not _within(image, place[0], place[1], 2.0):
                continue
            level = model[0] + model[1] * (x - middle) / c + model[2] * (y - middle) / c
            answer = sign * (_around(image, H, axis, place) - level) / contrast
            if (x if axis == 0 else y) < middle:
                sum_low, low = sum_low + answer, low + 1.0
            else:
                sum_high, high = sum_high + answer, high + 1.0
    off_low = abs(sum_low) / low if low >= _FEW_EDGES else 0.0
    off_high = abs(sum_high) / high if high >= _FEW_EDGES else 0.0
    return off_low, off_high


@leaf
def _around(image: Gray, H: Array, axis: int, place: Point) -> float:
    """Mean grey value at a pixel and 1.2 px to either side of it along the tag's x or y axis."""
    u, v, ux, uy, vx, vy = place
    du, dv = ux * H[0, axis] + uy * H[1, axis], vx * H[0, axis] + vy * H[1, axis]
    k = _ACROSS_PX / max(math.sqrt(du * du + dv * dv), 1e-9)
    du, dv = k * du, k * dv
    total = grey(image, u - du, v - dv) + grey(image, u, v) + grey(image, u + du, v + dv)
    return float(total / 3.0)


@bare
def is_there(
    image: Gray, lens: Lens, quad_n: Array, tags: MapArrays, i: int, cell_px: float,
    limits: Limits, scratch: PatternScratch,
) -> tuple[int, float]:  # fmt: skip
    """Wrong cells and margin of tag i in a quad (4, 2) [normalised]; -1: it is not this tag.

    cell_px: width of a cell.
    """
    cells, border, light, small = tags.cells[i], tags.border, scratch.light, scratch.small
    H, model, A = small[:3, :3], small[3], small[4:]
    if not unit_square(quad_n, H):
        return -1, 0.0
    promised = 0
    for i in range(len(cells)):
        for j in range(len(cells)):
            promised += 1 if cells[i, j] != 0 else 0
    seen = cell_light(image, lens, H, cells, border, _reach(cell_px), light)
    if seen < _MIN_SEEN * promised or not fit_light(light, cells, model, A):
        return -1, 0.0
    if model[3] < 0.5 * limits.min_contrast:
        return -1, 0.0
    wrong, margin = wrong_cells(light, cells, model)
    allowed = limits.max_errors if seen == promised else 0
    if wrong > allowed or inner_edges_off(image, lens, H, cells, border, model) > _OFF:
        return -1, 0.0
    return wrong, margin


@bare
def _reach(cell_px: float) -> float:
    """Size of the cross that reads a cell: none in small cells, where its arms would leave it."""
    return min(0.25 * cell_px, 3.0) if cell_px > 4.0 else 0.0


@bare
def find_pattern(
    image: Gray, lens: Lens, quad_n: Array, tags: MapArrays, i_tag: int, step: float,
    radius: float, scratch: PatternScratch,
) -> float:  # fmt: skip
    """Where a tag's print is, shifted in the image, by the correlation of its cells; -> the best.

    quad_n (4, 2): predicted corners; all shifts within `radius` [px] at this step [px], each cell
    by the nearest pixel to its centre; scratch.shift receives the best, the middle of those nearly
    as good around it.
    """
    cells, border = tags.cells[i_tag], tags.border
    at, score, shift = scratch.at, scratch.score, scratch.shift
    c, H = len(cells), scratch.small[:3, :3]
    shift[:] = 0.0
    if not unit_square(quad_n, H):
        return -1.0
    m, pad = 0, 0.5 * (c - border)
    for i in range(c):
        for j in range(c):
            if cells[i, j] != 0:
                place = _place(H, lens, (j + 0.5 - pad) / border, (i + 0.5 - pad) / border)
                at[m, 0], at[m, 1], at[m, 2] = place[0], place[1], float(cells[i, j])
                m += 1
    n = min(math.ceil(radius / step), (len(score) - 3) // 2)
    for i in range(2 * n + 3):
        for j in range(2 * n + 3):
            score[i, j] = -1.0
    best, bi, bj = -1.0, n, n
    for i in range(-n, n + 1):
        for j in range(-n, n + 1):
            if i * i + j * j > (n + 0.5) * (n + 0.5):
                continue
            value = _correlation(image, at, m, j * step, i * step)
            score[i + n + 1, j + n + 1] = value
            if value > best:
                best, bi, bj = value, i + n, j + n
    if best <= 0.0:
        return best
    weight = du = dv = 0.0
    for i in range(max(bi - _TOP, -1), min(bi + _TOP, 2 * n + 1) + 1):
        for j in range(max(bj - _TOP, -1), min(bj + _TOP, 2 * n + 1) + 1):
            w = score[i + 1, j + 1] - best + _NEAR_BEST
            if w > 0.0:
                weight += w
                du += w * (j - n)
                dv += w * (i - n)
    shift[0], shift[1] = du / weight * step, dv / weight * step
    return best


@leaf
def _correlation(image: Gray, at: Array, m: int, du: float, dv: float) -> float:
    """Normalised correlation of m cells with the image under a shift; -1: too few inside.

    at (m, 3): pixel and sign of each.
    """
    h, w = image.shape
    n = s = ss = p = pp = ps = 0.0
    for k in range(m):
        x, y = at[k, 0] + du + 0.5, at[k, 1] + dv + 0.5
        if 0.0 <= x < w and 0.0 <= y < h:
            g, sign = float(image[np.uintp(y), np.uintp(x)]), at[k, 2]
            n += 1.0
            s += g
            ss += g * g
            p += sign
            pp += 1.0
            ps += sign * g
    if n < _MIN_SEEN * m:
        return -1.0
    a, b = ss - s * s / n, pp - p * p / n
    if a < 4.0 * n or b <= 0.0:  # flat: less than two grey values of scatter
        return -1.0
    return float((ps - p * s / n) / math.sqrt(a * b))
