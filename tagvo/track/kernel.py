"""Tracks the tags of one image: anchors first, then all others about the pose that they give.

Compiled as one call, so that no interpreter runs between tags.
"""

import math

import numpy as np

from tagvo.compiled import njit
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.track.cells import Gray, Lens, MapArrays
from tagvo.track.edges import MAX_SCANS, MAX_STEPS, WORK, cross_sides, fit_side, line_variance
from tagvo.track.predict import (
    corner_spread,
    extent,
    inside,
    largest_sigma,
    laying_px,
    posterior,
    project_tag,
    to_pixel,
)  # fmt: skip
from tagvo.track.verify import find_pattern, is_there

# what became of a tag that was tried
TRACKED, NO_PATTERN, NO_EDGE, MOVED, NOT_IT, OUTLIER = 0, 1, 2, 3, 4, 5
FATES = ("tracked", "no_pattern", "no_edge", "moved", "bits", "outlier")

_SIGMAS = 3.0  # of the prediction that are searched
_EDGE_PX = 4.0  # least distance of a predicted corner from the rim
_SLACK_PX = 0.6  # what the prediction does not know: residual distortion, rolling shutter
_ANCHORS = 3
_TRIES = 8  # tags looked for before the prior is given up
_ENOUGH, _USEFUL_PX = 12, 18.0  # tags, beyond which those with shorter sides are left out
_SAFE = 0.9  # cells: within this an edge cannot be taken for the next one of its sense
_NEARLY_SAFE = 1.4  # cells: an edge is looked for within _SAFE first, by the print if that fails
_SCAN_PX, _SETTLED_PX = 1.5, 0.4  # between scans of the last rounds; what makes another round idle
_BLURRED_PX = 0.6  # spread of an edge from which neighbouring edges bleed into its ends
_STRAIGHT_PX = 40.0  # sides up to this bend by less than a tenth of a pixel in any usual lens
_MIN_CORRELATION = 0.55
_SHARP_PX = 0.55  # spread of a sharp edge, as in `tagvo.detect.blur`
_BLEED = 10.5  # systematic error of a blurred corner, as there
_FLOOR_PX = 0.03  # of a fitted corner: what no residual shows
_OUTLIER = 5.0  # rms of a tag's residual over its sigma


@njit
def _fit_round(
    image: Gray, lens: Lens, sense: float, quad_n: Array, lines: Array, widths: Array, most: float,
    scans: int, pitch: float, wide: bool, out: Array, work: Array, good: BoolArray,
) -> bool:  # fmt: skip
    """All four sides once about quad_n (4, 2): lines (4, 7), new corners out (4, 2).

    wide: search within `most` [px]; else within as much as the width of the edge asks, widths (4,)
    [px], but no more.
    """
    for k in range(4):
        a, b, band = quad_n[k], quad_n[(k + 1) % 4], most
        sharp = not wide and widths[k] < _BLURRED_PX
        if not wide:
            band = min(max(2.5 * widths[k] + 0.6, 1.8), most)
        if not fit_side(
            image, lens, a, b, sense, band, scans, pitch, wide, sharp, lines[k], work, good
        ):
            return False
    return cross_sides(quad_n, lines, out)


@njit
def _to_pixels(lens: Lens, quad_n: Array, quad_px: Array) -> None:
    point = np.empty(6)
    for c in range(4):
        to_pixel(lens, quad_n[c, 0], quad_n[c, 1], point)
        quad_px[c, 0], quad_px[c, 1] = point[0], point[1]


@njit
def _shifted(lens: Lens, quad_n: Array, shift: Array) -> None:
    """Move corners by a shift in the image [px], in place."""
    point = np.empty(6)
    for c in range(4):
        to_pixel(lens, quad_n[c, 0], quad_n[c, 1], point)
        det = point[2] * point[5] - point[3] * point[4]
        quad_n[c, 0] += (point[5] * shift[0] - point[3] * shift[1]) / det
        quad_n[c, 1] += (point[2] * shift[1] - point[4] * shift[0]) / det


@njit
def _corner_sigmas(lines: Array, quad_px: Array, cell_px: float, sigma: Array) -> None:
    """Standard deviation of each corner per axis [px] from its two sides, into sigma (4,)."""
    variance = np.empty(4)
    for k in range(4):
        d = (k + 1) % 4
        length = math.hypot(quad_px[d, 0] - quad_px[k, 0], quad_px[d, 1] - quad_px[k, 1])
        rms, spread = lines[k, 2], lines[k, 3]
        bleed = _BLEED * spread * (spread / cell_px) ** 3
        scatter = max(rms, 0.02 * max(spread / _SHARP_PX, 1.0))
        variance[k] = line_variance(scatter, lines[k, 6], length) + bleed * bleed
    for c in range(4):
        k, d = (c + 3) % 4, (c + 1) % 4
        ux, uy = quad_px[c, 0] - quad_px[k, 0], quad_px[c, 1] - quad_px[k, 1]
        vx, vy = quad_px[d, 0] - quad_px[c, 0], quad_px[d, 1] - quad_px[c, 1]
        sine = abs(ux * vy - uy * vx) / (math.hypot(ux, uy) * math.hypot(vx, vy))
        mean = 0.5 * (variance[k] + variance[c]) / max(sine * sine, 0.01)
        sigma[c] = math.sqrt(mean + _FLOOR_PX * _FLOOR_PX)


@njit
def track_tag(
    image: Gray, tags: MapArrays, i: int, lens: Lens, quad_n: Array, cell_px: float,
    sigma_px: float, limits: Array, quad_px: Array, corner_sigma: Array, light: Array,
) -> tuple[int, int, float]:  # fmt: skip
    """Find tag i about its predicted corners quad_n (4, 2), which are moved to where it is.

    cell_px: width of a cell; sigma_px: of the prediction; limits: [min_contrast, max_errors].
    Writes quad_px (4, 2) and corner_sigma (4,); -> its fate, wrong cells, margin.
    """
    work, good = np.empty((WORK, MAX_STEPS)), np.empty(MAX_SCANS, dtype=np.bool_)
    lines, start, band = np.empty((4, 7)), quad_n.copy(), _SIGMAS * sigma_px + _SLACK_PX
    fate, wrong, margin = NO_EDGE, 0, 0.0
    if band <= _NEARLY_SAFE * cell_px:
        reach = min(band, max(_SAFE * cell_px, 1.5))
        fate = _fit_tag(image, tags.sense, lens, quad_n, cell_px, reach, quad_px, lines, work, good)
        if fate == TRACKED:
            wrong, margin = _check(image, tags, i, lens, quad_n, quad_px, cell_px, limits, light)
            fate = NOT_IT if wrong < 0 else TRACKED
    if fate != TRACKED and band > _SAFE * cell_px:
        quad_n[:] = start
        fate = _by_pattern(image, tags, i, lens, quad_n, cell_px, band, quad_px, lines, work, good)
        if fate == TRACKED:
            wrong, margin = _check(image, tags, i, lens, quad_n, quad_px, cell_px, limits, light)
            fate = NOT_IT if wrong < 0 else TRACKED
    if fate == TRACKED:
        _corner_sigmas(lines, quad_px, cell_px, corner_sigma)
    return fate, max(wrong, 0), margin


@njit
def _by_pattern(
    image: Gray, tags: MapArrays, i: int, lens: Lens, quad_n: Array, cell_px: float, band: float,
    quad_px: Array, lines: Array, work: Array, good: BoolArray,
) -> int:  # fmt: skip
    """As `_fit_tag`, about where the correlation of the cells puts the tag."""
    shift, step = np.zeros(2), max(0.4 * cell_px, 1.0)
    found = find_pattern(image, lens, quad_n, tags.cells[i], tags.border, step, band + step, shift)
    if found < _MIN_CORRELATION:
        return NO_PATTERN
    _shifted(lens, quad_n, shift)
    reach = max(0.6 * cell_px, 1.5)
    return _fit_tag(image, tags.sense, lens, quad_n, cell_px, reach, quad_px, lines, work, good)


@njit
def _fit_tag(
    image: Gray, sense: float, lens: Lens, quad_n: Array, cell_px: float, band: float,
    quad_px: Array, lines: Array, work: Array, good: BoolArray,
) -> int:  # fmt: skip
    """Fit the sides about quad_n, first within `band` [px], then as narrow as the blur allows."""
    out, was, widths = np.empty((4, 2)), np.empty((4, 2)), np.empty(4)
    _to_pixels(lens, quad_n, was)
    if not _fit_round(
        image, lens, sense, quad_n, lines, widths, band, 8, 0.8, True, out, work, good
    ):
        return NO_EDGE
    quad_n[:] = out
    widths[:] = lines[:, 3]
    most = max(0.85 * cell_px, 1.5)
    scans = min(max(int(0.76 * extent(was)[0] / _SCAN_PX), 8), MAX_SCANS)
    _to_pixels(lens, quad_n, quad_px)
    for _ in range(3):
        if not _fit_round(
            image, lens, sense, quad_n, lines, widths, most, scans, 0.6, False, out, work, good
        ):
            return NO_EDGE
        quad_n[:] = out
        _to_pixels(lens, out, quad_px)
        if _farthest(lines) < _SETTLED_PX:
            break
    for c in range(4):
        if math.hypot(quad_px[c, 0] - was[c, 0], quad_px[c, 1] - was[c, 1]) > 1.5 * band + 1.0:
            return MOVED
    return TRACKED


@njit
def _farthest(lines: Array) -> float:
    """How far the last round has moved the end of a side [px]."""
    worst = 0.0
    for k in range(4):
        worst = max(worst, max(abs(lines[k, 0]), abs(lines[k, 1])) * lines[k, 5])
    return worst


@njit
def _check(
    image: Gray, tags: MapArrays, i: int, lens: Lens, quad_n: Array, quad_px: Array,
    cell_px: float, limits: Array, light: Array,
) -> tuple[int, float]:  # fmt: skip
    """Wrong cells and margin, as `is_there`; the lens is left out where a tag is small."""
    errors = int(limits[1])
    if cell_px * tags.border < _STRAIGHT_PX:
        unit = np.zeros(4)
        unit[:2] = 1.0
        flat = Lens(0, unit, lens.coeffs, lens.size, lens.max_radius)
        return is_there(
            image, flat, quad_px, tags.cells[i], tags.border, cell_px, limits[0], errors, light
        )
    return is_there(
        image, lens, quad_n, tags.cells[i], tags.border, cell_px, limits[0], errors, light
    )


@njit
def _foresee(
    R_WC: Array, p_WC: Array, P: Array, tags: MapArrays, lens: Lens, i: int, min_side: float,
    quad_n: Array, quad_px: Array, facts: Array,
) -> bool:  # fmt: skip
    """Predict tag i; facts (4,): sigma [px], cell [px], shortest side [px], laying [px]."""
    J, spread = np.empty((4, 2, 6)), np.empty((4, 3))
    if not project_tag(R_WC, p_WC, tags, i, lens, quad_n, quad_px, J):
        return False
    if not inside(quad_px, lens, _EDGE_PX):
        return False
    side, height = extent(quad_px)
    if side < min_side or height < 0.5 * min_side:
        return False
    corner_spread(J, P, spread)
    lay = laying_px(R_WC, p_WC, tags, i, lens)
    facts[0] = math.sqrt(largest_sigma(spread) ** 2 + lay * lay)
    facts[1], facts[2], facts[3] = min(side, height) / tags.border, side, lay
    return True


@njit
def _spread_out(
    facts: Array, quads_px: Array, lens: Lens, seen: IntArray, count: int, wanted: int,
    size: Array, order: IntArray,
) -> int:  # fmt: skip
    """The most useful `wanted` of the tags seen, into order; -> how many.

    Worth is the square of the side over that of the corners' error, laying included, divided among
    the tags already taken from the same twelfth of the image; the two largest sizes in view come
    first, since the selection of the paper lives on them. Small tags are left out once there are
    enough.
    """
    taken, crowd = np.zeros(count, dtype=np.bool_), np.zeros(12)
    place, n = np.empty(count, dtype=np.int64), min(wanted, count)
    for m in range(count):
        q = quads_px[seen[m]]
        u = 0.25 * (q[0, 0] + q[1, 0] + q[2, 0] + q[3, 0]) / lens.size[0]
        v = 0.25 * (q[0, 1] + q[1, 1] + q[2, 1] + q[3, 1]) / lens.size[1]
        place[m] = min(max(int(4 * u), 0), 3) + 4 * min(max(int(3 * v), 0), 2)
    chosen, largest, second = 0, 0.0, 0.0
    for m in range(count):
        s = size[seen[m]]
        if s > 1.001 * largest:
            largest, second = s, largest
        elif 1.001 * second < s < 0.999 * largest:
            second = s
    for _ in range(n):
        best, worth = -1, -1.0
        for m in range(count):
            if taken[m]:
                continue
            i = seen[m]
            w = facts[i, 2] ** 2 / ((0.01 + facts[i, 3] ** 2) * (1.0 + crowd[place[m]]))
            if size[i] > 0.999 * second:
                w *= 1e6
            if w > worth:
                best, worth = m, w
        if chosen >= _ENOUGH and facts[seen[best], 2] < _USEFUL_PX:
            taken[best] = True  # small beside those there are: not worth the time
            continue
        taken[best] = True
        crowd[place[best]] += 1.0
        order[chosen] = seen[best]
        chosen += 1
    return chosen


@njit
def track_image(
    image: Gray, tags: MapArrays, size: Array, lens: Lens, R0: Array, p0: Array, P0: Array,
    limits: Array, wanted: int, rows: IntArray, corners: Array, sigma: Array, wrong: IntArray,
    margin: Array, fates: IntArray,
) -> tuple[int, int, float]:  # fmt: skip
    """Every tag of the map that the prior puts into the image, as far as it is there.

    limits: [min_contrast, max_errors, min_side, max_sigma]; wanted: most tags to track. Writes
    rows (k,), corners (k, 4, 2) [px], sigma (k, 4) [px], wrong (k,), margin (k,) of those tracked
    and adds to fates (6,); -> how many were tracked, how many tried, largest sigma of the prior
    among tags in view [px].
    """
    n = len(tags.p_WT)
    quads_n, quads_px, facts = np.empty((n, 4, 2)), np.empty((n, 4, 2)), np.empty((n, 4))
    seen, order = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    R, p, P, chi = R0.copy(), p0.copy(), P0.copy(), np.empty(n)
    light = np.empty(tags.cells.shape[1:])
    done = np.zeros(n, dtype=np.bool_)
    found, count, largest = 0, 0, 0.0
    for i in range(n):
        if _foresee(R, p, P, tags, lens, i, limits[2], quads_n[i], quads_px[i], facts[i]):
            seen[count] = i
            count += 1
            largest = max(largest, facts[i, 0])
    if count == 0 or largest > limits[3]:
        return 0, count, largest
    tried = 0
    while found < _ANCHORS and tried < min(_TRIES, count):
        best, worth = -1, -1.0
        for m in range(count):
            i = seen[m]
            if not done[i]:
                w = _anchor_worth(facts[i], quads_px[i], quads_px, rows, found)
                if w > worth:
                    best, worth = i, w
        done[best] = True
        if found > 0 and not _foresee(
            R, p, P, tags, lens, best, limits[2], quads_n[best], quads_px[best], facts[best]
        ):
            continue
        tried += 1
        k = found
        fate, wrong[k], margin[k] = track_tag(
            image, tags, best, lens, quads_n[best], facts[best, 1], facts[best, 0], limits,
            corners[k], sigma[k], light,
        )  # fmt: skip
        fates[fate] += 1
        if fate != TRACKED:
            continue
        rows[k] = best
        found += 1
        if not posterior(R0, p0, P0, tags, lens, rows, found, corners, sigma, R, p, P, chi):
            return 0, count, largest
    if found == 0:
        return 0, tried, largest
    return _track_rest(
        image, tags, size, lens, R0, p0, P0, R, p, P, limits, wanted, rows, corners, sigma, wrong,
        margin, fates, done, found, tried, largest, seen, order, quads_n, quads_px, facts, chi,
        light,
    )  # fmt: skip


@njit
def _anchor_worth(
    facts: Array, quad_px: Array, quads_px: Array, rows: IntArray, found: int
) -> float:
    """How good an anchor a tag is: large for its uncertainty, far from the anchors there are."""
    worth = facts[1] / (facts[0] + 1.0) * min(facts[2], 150.0)
    nearest = 1e3
    for k in range(found):
        q = quads_px[rows[k]]
        nearest = min(nearest, math.hypot(quad_px[0, 0] - q[0, 0], quad_px[0, 1] - q[0, 1]))
    return float(worth * min(nearest, 300.0))


@njit
def _track_rest(
    image: Gray, tags: MapArrays, size: Array, lens: Lens, R0: Array, p0: Array, P0: Array,
    R: Array, p: Array, P: Array, limits: Array, wanted: int, rows: IntArray, corners: Array,
    sigma: Array, wrong: IntArray, margin: Array, fates: IntArray, done: BoolArray, found: int,
    tried: int, largest: float, seen: IntArray, order: IntArray, quads_n: Array, quads_px: Array,
    facts: Array, chi: Array, light: Array,
) -> tuple[int, int, float]:  # fmt: skip
    """The tags besides the anchors, about the pose (R, p, P) that these gave; see `track_image`."""
    n, count = len(tags.p_WT), 0
    for i in range(n):
        if done[i]:
            continue
        if _foresee(R, p, P, tags, lens, i, limits[2], quads_n[i], quads_px[i], facts[i]):
            seen[count] = i
            count += 1
    count = _spread_out(facts, quads_px, lens, seen, count, max(wanted - found, 0), size, order)
    for m in range(count):
        i, k = order[m], found
        fate, wrong[k], margin[k] = track_tag(
            image, tags, i, lens, quads_n[i], facts[i, 1], facts[i, 0], limits,
            corners[k], sigma[k], light,
        )  # fmt: skip
        tried += 1
        if fate == TRACKED:
            rows[k] = i
            found += 1
        fates[fate] += 1
    if not posterior(R0, p0, P0, tags, lens, rows, found, corners, sigma, R, p, P, chi):
        return 0, tried, largest
    kept = 0
    for k in range(found):
        if chi[k] > _OUTLIER:
            fates[TRACKED] -= 1
            fates[OUTLIER] += 1
            continue
        if kept != k:
            rows[kept], wrong[kept], margin[kept] = rows[k], wrong[k], margin[k]
            corners[kept], sigma[kept] = corners[k], sigma[k]
        kept += 1
    return kept, tried, largest
