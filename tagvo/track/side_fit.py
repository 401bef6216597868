"""Fits the four sides of one tag to the image, lens and all; compiled.

A side is a straight line in normalised coordinates, so that it may bend in the image. It is looked
for along the image's own normal at points spread over it; side k runs from corner k to corner k+1,
clockwise in the image, so that its outward normal is on its left.
"""

import math
from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array, BoolArray
from tagvo.kernels.jit import bare, leaf
from tagvo.track.predict import to_pixel
from tagvo.track.tag_model import Gray, Lens

MARGIN = 0.12  # share of a side left out at either end: there the neighbouring side blurs in
MAX_SCANS, MAX_STEPS, WORK = 24, 96, 8
_FLOOR = 0.2  # share of a profile's steepest step below which a step is noise
_MIN_STEP = 6.0  # grey values across an edge; below, a scan has seen no edge
_WEAK = 0.4  # a scan whose step is smaller than this share of the side's median saw another edge
_MIN_GOOD = 0.6  # share of a side's scans that must agree on one line
_PIECE_PX = 60.0  # of a side that a cubic and one normal are good for
_INDEPENDENT_PX = 1.5  # scans nearer to one another than this see the same noise


class Ray(NamedTuple):
    """A pixel u, v and the unit normal nu, nv of the side that passes it."""

    u: float
    v: float
    nu: float
    nv: float


class Side(NamedTuple):
    """The predicted corners a, b (2,) [normalised] of a side, and `to_pixel` of them (6,)."""

    a: Array
    b: Array
    at_a: Array
    at_b: Array


class SideSearch(NamedTuple):
    """How a side is looked for: within `band` [px] to either side, by so many scans.

    pitch: between samples [px]; wide: the side is not yet known well; sharp: the band holds its
    whole edge and no other.
    """

    band: float
    scans: int
    pitch: float
    wide: bool
    sharp: bool


class SideScratch(NamedTuple):
    """What `fit_side` writes on: work (WORK, MAX_STEPS), good (MAX_SCANS,)."""

    work: Array
    good: BoolArray


@leaf
def grey(image: Gray, u: float, v: float) -> float:
    """Bilinear grey value at a pixel that lies inside the image by one pixel at least."""
    x, y, one = np.uintp(u), np.uintp(v), np.uintp(1)  # unsigned: no wrap-around to be looked for
    a, b = u - np.int64(x), v - np.int64(y)
    p, q = np.float64(image[y, x]), np.float64(image[y, x + one])
    r, s = np.float64(image[y + one, x]), np.float64(image[y + one, x + one])
    top, low = p + a * (q - p), r + a * (s - r)
    return float(top + b * (low - top))


@leaf
def _profile(image: Gray, ray: Ray, band: float, steps: int, sense: float, seen: Array) -> bool:
    """Grey steps in the edge's own sense along the normal, from -band to +band, into seen."""
    u, v, nu, nv = ray
    h, w = image.shape
    eu, ev = abs(nu) * band + 1.0, abs(nv) * band + 1.0
    if not (eu <= u < w - 1.0 - eu and ev <= v < h - 1.0 - ev):
        return False
    pitch = 2.0 * band / steps
    before = grey(image, u - band * nu, v - band * nv)
    for i in range(steps):
        at = (i + 1) * pitch - band
        now = grey(image, u + at * nu, v + at * nv)
        seen[i] = sense * (now - before)
        before = now
    return True


@leaf
def _steepest(seen: Array, steps: int) -> int:
    """Index of the steepest step of a profile, neighbours counted half; -1: none rises."""
    best, top = -1, 0.0
    for i in range(steps):
        near = seen[i]
        near += 0.5 * seen[i - 1] if i > 0 else 0.0
        near += 0.5 * seen[i + 1] if i < steps - 1 else 0.0
        if near > top:
            best, top = i, near
    return best


@leaf
def _rough_edge(seen: Array, steps: int, band: float) -> tuple[float, float, float]:
    """Place of the edge in a profile [px from its middle], its spread [px], its step [grey].

    The centre of the squared steps, small ones left out: robust where other edges may be near.
    Step 0: there is none.
    """
    pitch = 2.0 * band / steps
    best = _steepest(seen, steps)
    if best < 0:
        return 0.0, 0.0, 0.0
    floor = _FLOOR * seen[best]
    rise = mass = first = moment = second = third = 0.0
    for i in range(steps):
        rise += max(seen[i], 0.0)
        g = seen[i] - floor
        if g > 0.0:
            x = (i + 0.5) * pitch - band
            mass += g * g
            first += g * g * x
            moment += g
            second += g * x
            third += g * x * x
    if mass <= 0.0:
        return 0.0, 0.0, 0.0
    mean = second / moment
    return first / mass, math.sqrt(max(third / moment - mean * mean, 0.0)), rise


@leaf
def _fine_edge(seen: Array, steps: int, band: float) -> tuple[float, float, float]:
    """As `_rough_edge`, by the centre of all steps: where the light is half way on the average.

    Linear in the light, hence without a bias towards pixel centres; for a band that holds this
    edge alone.
    """
    pitch = 2.0 * band / steps
    mass = first = square = 0.0
    for i in range(steps):
        x = (i + 0.5) * pitch - band
        mass += seen[i]
        first += seen[i] * x
        square += seen[i] * x * x
    if mass <= 0.0:
        return 0.0, 0.0, 0.0
    place = first / mass
    if abs(place) > band:
        return 0.0, 0.0, 0.0
    return place, math.sqrt(max(square / mass - place * place, 0.0)), mass


@bare
def _median(values: Array, n: int) -> float:
    """Upper median of the first n values, which are put in order (few: insertion sort)."""
    for i in range(1, n):
        v = values[i]
        j = i - 1
        while j >= 0 and values[j] > v:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = v
    return float(values[n // 2])


@bare
def _distance(
    t: Array, e: Array, good: BoolArray, n: int, a: float, b: float, left: Array
) -> float:
    """Median distance of the good ones of n points from the line e = a + b t; left: scratch."""
    m = 0
    for k in range(n):
        if good[k]:
            left[m] = abs(e[k] - a - b * t[k])
            m += 1
    return _median(left, m)


@bare
def _first_line(
    t: Array, e: Array, good: BoolArray, n: int, wide: bool, out: Array, left: Array
) -> float:
    """A line that most of the good points lie on, into out (2,); -> their median distance.

    wide: by pairs of points from the first and the last third, the pair whose line has the least
    median distance; else the side is as good as found, and the median offset is the line.
    """
    if not wide:
        m = 0
        for k in range(n):
            if good[k]:
                left[m] = e[k]
                m += 1
        out[0], out[1] = _median(left, m), 0.0
        return _distance(t, e, good, n, out[0], 0.0, left)
    least = np.inf
    for i in range((n + 2) // 3):
        for j in range(n - (n + 2) // 3, n):
            if good[i] and good[j]:
                b = (e[j] - e[i]) / (t[j] - t[i])
                a = e[i] - b * t[i]
                middle = _distance(t, e, good, n, a, b, left)
                if middle < least:
                    least, out[0], out[1] = middle, a, b
    return least


@bare
def _robust_line(
    t: Array, e: Array, good: BoolArray, n: int, wide: bool, out: Array, left: Array
) -> float:
    """Line e = out[0] + out[1] t through the good ones of n points; -> rms of those that agree.

    Least squares over the points that agree with `_first_line`; `good` becomes those. Negative:
    too few agree.
    """
    least_count, total = max(4, int(_MIN_GOOD * n)), 0
    for i in range(n):
        total += 1 if good[i] else 0
    if total < least_count:
        return -1.0
    least = _first_line(t, e, good, n, wide, out, left)
    if not least < np.inf:
        return -1.0
    limit, rms = max(4.0 * least, 0.3), -1.0
    a0, b0 = out[0], out[1]
    for _ in range(2):
        w = st = se = stt = ste = 0.0
        for k in range(n):
            if good[k] and abs(e[k] - a0 - b0 * t[k]) <= limit:
                w += 1.0
                st += t[k]
                se += e[k]
                stt += t[k] * t[k]
                ste += t[k] * e[k]
        det = w * stt - st * st
        if w < least_count or det < 1e-9:
            return -1.0
        b0 = (w * ste - st * se) / det
        a0 = (se - b0 * st) / w
        square = 0.0
        for k in range(n):
            d = e[k] - a0 - b0 * t[k]
            if good[k] and abs(d) <= limit:
                square += d * d
        rms = math.sqrt(square / max(w - 2.0, 1.0))
        limit = min(limit, max(3.0 * rms, 0.1))
    for k in range(n):
        good[k] = good[k] and abs(e[k] - a0 - b0 * t[k]) <= limit
    out[0], out[1] = a0, b0
    return rms


@bare
def fit_side(
    image: Gray, lens: Lens, side: Side, sense: float, search: SideSearch, line: Array,
    scratch: SideScratch,
) -> bool:  # fmt: skip
    """One side about where it is predicted -> line (7,).

    line: perpendicular offset of the edge at a and at b [normalised], rms of the scans from it
    [px], spread of the edge [px], step [grey], pixels a normalised unit across it, share of the
    scans that agree. False: there is no such edge within the band.
    """
    a, b, at_a, at_b = side
    band, scans, pitch, wide, sharp = search
    work, good = scratch
    t, e, spread, rise, scale, left = work[0], work[1], work[2], work[3], work[4], work[7]
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.sqrt(dx * dx + dy * dy)
    if length < 1e-9:
        return False
    pieces = 1 + int(math.hypot(at_b[0] - at_a[0], at_b[1] - at_a[1]) / _PIECE_PX)
    first, u0, v0, ux0, uy0, vx0, vy0 = 0, at_a[0], at_a[1], at_a[2], at_a[3], at_a[4], at_a[5]
    for piece in range(1, pieces + 1):
        end = piece / pieces
        u1, v1, ux1, uy1, vx1, vy1 = at_b[0], at_b[1], at_b[2], at_b[3], at_b[4], at_b[5]
        if piece < pieces:
            u1, v1, ux1, uy1, vx1, vy1 = to_pixel(lens, a[0] + end * dx, a[1] + end * dy)
        mu0, mv0 = (ux0 * dx + uy0 * dy) / pieces, (vx0 * dx + vy0 * dy) / pieces
        mu1, mv1 = (ux1 * dx + uy1 * dy) / pieces, (vx1 * dx + vy1 * dy) / pieces
        du, dv = u1 - u0, v1 - v0
        tu, tv = 1.5 * du - 0.25 * (mu0 + mu1), 1.5 * dv - 0.25 * (mv0 + mv1)
        long = math.sqrt(tu * tu + tv * tv)
        nu, nv = tv / long, -tu / long
        ux, uy, vx, vy = 0.5 * (ux0 + ux1), 0.5 * (uy0 + uy1), 0.5 * (vx0 + vx1), 0.5 * (vy0 + vy1)
        det = ux * vy - uy * vx
        mx, my = (vy * nu - uy * nv) / det, (ux * nv - vx * nu) / det
        unit = (mx * dy - my * dx) / length  # normalised units across the side for one pixel
        along = (mx * dx + my * dy) / (length * length)
        qu2, qu3 = 3.0 * du - 2.0 * mu0 - mu1, mu0 + mu1 - 2.0 * du  # cubic through both ends
        qv2, qv3 = 3.0 * dv - 2.0 * mv0 - mv1, mv0 + mv1 - 2.0 * dv
        for k in range(first, scans):
            s = MARGIN + (1.0 - 2.0 * MARGIN) * k / (scans - 1)
            if s > end:
                break
            first, r = k + 1, s * pieces - (piece - 1)
            u, v = u0 + r * (mu0 + r * (qu2 + r * qu3)), v0 + r * (mv0 + r * (qv2 + r * qv3))
            e[k], spread[k], rise[k] = _scan(
                image, Ray(u, v, nu, nv), band, pitch, sense, sharp and not wide, work[5]
            )
            t[k], scale[k], good[k] = s + e[k] * along, unit, rise[k] >= _MIN_STEP
        u0, v0, ux0, uy0, vx0, vy0 = u1, v1, ux1, uy1, vx1, vy1
    for k in range(scans):
        left[k] = rise[k]
    usual = _median(left, scans)
    for k in range(scans):
        good[k] = good[k] and rise[k] > _WEAK * usual
    rms = _robust_line(t, e, good, scans, wide, line, left)
    if rms < 0.0:
        return False
    _summary(good, spread, rise, scale, scans, rms, line)
    return True


@leaf
def _scan(
    image: Gray, ray: Ray, band: float, pitch: float, sense: float, fine: bool, seen: Array
) -> tuple[float, float, float]:
    """Place, spread and step of the edge along the normal through a pixel; seen: scratch."""
    steps = min(MAX_STEPS, max(4, int(2.0 * band / pitch) + 1))
    if not _profile(image, ray, band, steps, sense, seen):
        return 0.0, 0.0, 0.0
    return _fine_edge(seen, steps, band) if fine else _rough_edge(seen, steps, band)


@bare
def _summary(
    good: BoolArray, spread: Array, rise: Array, scale: Array, scans: int, rms: float, line: Array
) -> None:
    """Turn the line of a side (value at 0, slope, in pixels) into what `fit_side` promises."""
    n, width, step, unit = 0, 0.0, 0.0, 0.0
    for k in range(scans):
        if good[k]:
            n += 1
            width += spread[k]
            step += rise[k]
            unit += scale[k]
    unit /= n
    line[1] = (line[0] + line[1]) * unit
    line[0] *= unit
    line[2], line[3], line[4], line[5], line[6] = rms, width / n, step / n, 1.0 / unit, n / scans


@bare
def cross_sides(quad_n: Array, lines: Array, out: Array) -> bool:
    """Corners (4, 2) [normalised] where the moved sides cross; lines (4, 7) of `fit_side`."""
    for c in range(4):
        k = (c + 3) % 4  # the side that ends in this corner; side c begins in it
        d = (c + 1) % 4
        ax, ay, bx, by = quad_n[k, 0], quad_n[k, 1], quad_n[c, 0], quad_n[c, 1]
        long = math.hypot(bx - ax, by - ay)
        nx, ny = (by - ay) / long, -(bx - ax) / long
        ax, ay, bx, by = (
            ax + lines[k, 0] * nx, ay + lines[k, 0] * ny,
            bx + lines[k, 1] * nx, by + lines[k, 1] * ny,
        )  # fmt: skip
        cx, cy, ex, ey = quad_n[c, 0], quad_n[c, 1], quad_n[d, 0], quad_n[d, 1]
        long = math.hypot(ex - cx, ey - cy)
        nx, ny = (ey - cy) / long, -(ex - cx) / long
        cx, cy, ex, ey = (
            cx + lines[c, 0] * nx, cy + lines[c, 0] * ny,
            ex + lines[c, 1] * nx, ey + lines[c, 1] * ny,
        )  # fmt: skip
        ux, uy, vx, vy = bx - ax, by - ay, ex - cx, ey - cy
        det = ux * vy - uy * vx
        if abs(det) < 0.05 * math.hypot(ux, uy) * math.hypot(vx, vy):
            return False
        s = ((cx - ax) * vy - (cy - ay) * vx) / det
        out[c, 0], out[c, 1] = ax + s * ux, ay + s * uy
    return True


@bare
def line_variance(rms: float, share: float, length_px: float) -> float:
    """Variance of a fitted side at its end [px^2] from the scatter of its scans.

    That of a straight line at the end of its data and MARGIN beyond; share: of the scans that
    agree; scans that see the same pixels count once.
    """
    n = max(share * length_px * (1.0 - 2.0 * MARGIN) / _INDEPENDENT_PX, 3.0)
    half = 0.5 - MARGIN
    return rms * rms / n * (1.0 + 3.0 * 0.25 / (half * half))
