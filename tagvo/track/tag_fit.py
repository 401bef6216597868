"""Fits one tag to the image about where it is expected, and makes sure that it is this one.

Compiled; nothing here allocates: what is written on comes as a `Scratch`.
"""

import math
from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, leaf, njit
from tagvo.track.pattern import PatternScratch, find_pattern, is_there
from tagvo.track.predict import extent, to_pixel
from tagvo.track.side_fit import (
    MAX_SCANS,
    MAX_STEPS,
    WORK,
    Side,
    SideScratch,
    SideSearch,
    cross_sides,
    fit_side,
    line_variance,
)
from tagvo.track.tag_model import FLAT, Foreseen, Gray, Lens, Task, TrackedTags

# what became of a tag that was tried
TRACKED, NO_PATTERN, NO_EDGE, MOVED, NOT_IT, OUTLIER = 0, 1, 2, 3, 4, 5
FATES = ("tracked", "no_pattern", "no_edge", "moved", "bits", "outlier")

_SIGMAS = 3.0  # of the prediction that are searched
_SLACK_PX = 0.6  # what the prediction does not know: residual distortion, rolling shutter
_SAFE = 0.9  # cells: within this an edge cannot be taken for the next one of its sense
_NEARLY_SAFE = 1.4  # cells: an edge is looked for within _SAFE first, by the print if that fails
_SCAN_PX, _SETTLED_PX = 1.5, 0.4  # between scans of the last rounds; what makes another round idle
_MOST_ROUNDS = 3  # of narrow fits; fewer where a round is idle
_BLURRED_PX = 0.6  # spread of an edge from which neighbouring edges bleed into its ends
_STRAIGHT_PX = 40.0  # sides up to this bend by less than a tenth of a pixel in any usual lens
_MIN_CORRELATION = 0.55
START, WAS, OUT = 0, 1, 2  # of Scratch.corners
_SHARP_PX = 0.55  # spread of a sharp edge, as in `tagvo.detect.blur`
_BLEED = 10.5  # systematic error of a blurred corner, as there
_UNSURE_PX, _UNLIKE = 0.3, 6.0  # of a side: sigma, and over its opposite's, that make it doubtful
_FLOOR_PX = 0.03  # of a fitted corner: what no residual shows


class Scratch(NamedTuple):
    """What the kernels write on, of one thread.

    lines (4, 7), widths (4,): of a tag's sides; nodes (4, 6): `to_pixel` of its corners; corners
    (3, 4, 2): where they began, were, came out; J (4, 2, 6), spread (4, 3): of a prediction.
    """

    sides: SideScratch
    pattern: PatternScratch
    lines: Array
    widths: Array
    nodes: Array
    corners: Array
    J: Array
    spread: Array


@njit
def scratch(c: int, max_sigma_px: float) -> Scratch:
    """Scratch for tags of c by c cells, predicted to a sigma."""
    k = 2 * math.ceil(_SIGMAS * max_sigma_px + _SLACK_PX + 2.0) + 3
    sides = SideScratch(np.empty((WORK, MAX_STEPS)), np.empty(MAX_SCANS, dtype=np.bool_))
    pattern = PatternScratch(
        np.empty((c, c)), np.empty((8, 4)), np.empty((c * c, 3)), np.empty((k, k)), np.empty(2)
    )
    return Scratch(
        sides, pattern, np.empty((4, 7)), np.empty(4), np.empty((4, 6)), np.empty((3, 4, 2)),
        np.empty((4, 2, 6)), np.empty((4, 3)),
    )  # fmt: skip


@bare
def _fit_round(
    image: Gray, lens: Lens, sense: float, quad_n: Array, search: SideSearch, s: Scratch
) -> bool:
    """All four sides once about quad_n (4, 2): s.lines, new corners s.corners[OUT].

    search.wide: within its band [px]; else within as much as the width of the edge asks, s.widths
    [px], but no more. s.nodes: `to_pixel` of quad_n.
    """
    lines, nodes = s.lines, s.nodes
    for k in range(4):
        band, sharp = search.band, False
        if not search.wide:
            width = s.widths[k]
            sharp = width < _BLURRED_PX
            band = min(max(2.5 * width + 0.6, 1.8), band)
        after = (k + 1) % 4
        side = Side(quad_n[k], quad_n[after], nodes[k], nodes[after])
        how = SideSearch(band, search.scans, search.pitch, search.wide, sharp)
        if not fit_side(image, lens, side, sense, how, lines[k], s.sides):
            return False
    return cross_sides(quad_n, lines, s.corners[OUT])


@leaf
def _put(source: Array, out: Array) -> None:
    """Copy corners (4, 2 and more) to out (4, 2); a slice would copy twice, for fear of overlap."""
    for c in range(4):
        out[c, 0], out[c, 1] = source[c, 0], source[c, 1]


@bare
def _to_pixels(lens: Lens, quad_n: Array, nodes: Array) -> None:
    for c in range(4):
        nodes[c, 0], nodes[c, 1], nodes[c, 2], nodes[c, 3], nodes[c, 4], nodes[c, 5] = to_pixel(
            lens, quad_n[c, 0], quad_n[c, 1]
        )


@bare
def _shifted(lens: Lens, quad_n: Array, shift: Array) -> None:
    """Move corners by a shift in the image [px], in place."""
    for c in range(4):
        _, _, ux, uy, vx, vy = to_pixel(lens, quad_n[c, 0], quad_n[c, 1])
        det = ux * vy - uy * vx
        quad_n[c, 0] += (vy * shift[0] - uy * shift[1]) / det
        quad_n[c, 1] += (ux * shift[1] - vx * shift[0]) / det


@bare
def _corner_sigmas(lines: Array, quad_px: Array, cell_px: float, sigma: Array) -> None:
    """Standard deviation of each corner per axis [px] from its two sides, into sigma (4,)."""
    before = _side_variance(lines[3], quad_px[3], quad_px[0], cell_px)
    for c in range(4):
        k, d = (c + 3) % 4, (c + 1) % 4
        after = _side_variance(lines[c], quad_px[c], quad_px[d], cell_px)
        ux, uy = quad_px[c, 0] - quad_px[k, 0], quad_px[c, 1] - quad_px[k, 1]
        vx, vy = quad_px[d, 0] - quad_px[c, 0], quad_px[d, 1] - quad_px[c, 1]
        sine = abs(ux * vy - uy * vx) / (math.hypot(ux, uy) * math.hypot(vx, vy))
        mean = 0.5 * (before + after) / max(sine * sine, 0.01)
        sigma[c] = math.sqrt(mean + _FLOOR_PX * _FLOOR_PX)
        before = after


@bare
def _sides_alike(lines: Array, quad_px: Array, cell_px: float) -> bool:
    """Whether both sides of either pair are about as sure: they see the same light and blur.

    One much less sure than its opposite runs partly along something else, off by pixels.
    """
    for k in range(2):
        a = _side_variance(lines[k], quad_px[k], quad_px[k + 1], cell_px)
        b = _side_variance(lines[k + 2], quad_px[k + 2], quad_px[(k + 3) % 4], cell_px)
        high, low = max(a, b), min(a, b)
        if high > _UNSURE_PX * _UNSURE_PX and high > _UNLIKE * _UNLIKE * low:
            return False
    return True


@bare
def _side_variance(line: Array, a: Array, b: Array, cell_px: float) -> float:
    """Variance of a fitted side at its ends a, b (2,) [px^2]; line (7,) of `fit_side`."""
    rms, spread = line[2], line[3]
    bleed = _BLEED * spread * (spread / cell_px) ** 3
    scatter = max(rms, 0.02 * max(spread / _SHARP_PX, 1.0))
    length = math.hypot(b[0] - a[0], b[1] - a[1])
    return float(line_variance(scatter, line[6], length) + bleed * bleed)


@bare
def track_tag(task: Task, i: int, expected: Foreseen, out: TrackedTags, k: int, s: Scratch) -> int:
    """Find tag i about its predicted corners, which are moved to where it is; -> its fate.

    Writes corners, sigma, wrong cells and margin of place k of out.
    """
    quad_n, quad_px, cell_px = expected.quads_n[i], out.corners_px[k], expected.cell_px[i]
    band = _SIGMAS * expected.sigma_px[i] + _SLACK_PX
    start = s.corners[START]
    _put(quad_n, start)
    fate, wrong, margin = NO_EDGE, 0, 0.0
    if band <= _NEARLY_SAFE * cell_px:
        reach = min(band, max(_SAFE * cell_px, 1.5))
        fate = _fit_tag(task, quad_n, cell_px, reach, quad_px, s)
        if fate == TRACKED:
            wrong, margin = _check(task, i, quad_n, quad_px, cell_px, s)
            fate = NOT_IT if wrong < 0 else TRACKED
    if fate != TRACKED and band > _SAFE * cell_px:
        _put(start, quad_n)
        fate = _by_pattern(task, i, quad_n, cell_px, band, quad_px, s)
        if fate == TRACKED:
            wrong, margin = _check(task, i, quad_n, quad_px, cell_px, s)
            fate = NOT_IT if wrong < 0 else TRACKED
    if fate == TRACKED and not _sides_alike(s.lines, quad_px, cell_px):
        fate = NO_EDGE
    if fate == TRACKED:
        _corner_sigmas(s.lines, quad_px, cell_px, out.sigma_px[k])
    out.wrong[k], out.margin[k] = max(wrong, 0), margin
    return fate


@bare
def _by_pattern(
    task: Task, i: int, quad_n: Array, cell_px: float, band: float, quad_px: Array, s: Scratch
) -> int:
    """As `_fit_tag`, about where the correlation of the cells puts the tag."""
    step = max(0.4 * cell_px, 1.0)
    found = find_pattern(task.image, task.lens, quad_n, task.tags, i, step, band + step, s.pattern)
    if found < _MIN_CORRELATION:
        return NO_PATTERN
    _shifted(task.lens, quad_n, s.pattern.shift)
    return _fit_tag(task, quad_n, cell_px, max(0.6 * cell_px, 1.5), quad_px, s)


@bare
def _fit_tag(
    task: Task, quad_n: Array, cell_px: float, band: float, quad_px: Array, s: Scratch
) -> int:
    """Fit the sides about quad_n, first within `band` [px], then as narrow as the blur allows."""
    image, lens, sense = task.image, task.lens, task.tags.sense
    was, out = s.corners[WAS], s.corners[OUT]
    _to_pixels(lens, quad_n, s.nodes)
    _put(s.nodes, was)
    if not _fit_round(image, lens, sense, quad_n, SideSearch(band, 8, 0.8, True, False), s):
        return NO_EDGE
    _put(out, quad_n)
    for k in range(4):
        s.widths[k] = s.lines[k, 3]
    most = max(0.85 * cell_px, 1.5)
    scans = min(max(int(0.76 * extent(was)[0] / _SCAN_PX), 8), MAX_SCANS)
    _to_pixels(lens, quad_n, s.nodes)
    narrow = SideSearch(most, scans, 0.6, False, False)
    for _ in range(_MOST_ROUNDS):
        if not _fit_round(image, lens, sense, quad_n, narrow, s):
            return NO_EDGE
        _put(out, quad_n)
        _to_pixels(lens, quad_n, s.nodes)
        if _farthest(s.lines) < _SETTLED_PX:
            break
    _put(s.nodes, quad_px)
    for c in range(4):
        moved = math.hypot(quad_px[c, 0] - was[c, 0], quad_px[c, 1] - was[c, 1])
        if moved > 1.5 * band + 1.0:
            return MOVED
    return TRACKED


@bare
def _farthest(lines: Array) -> float:
    """How far the last round has moved the end of a side [px]."""
    worst = 0.0
    for k in range(4):
        worst = max(worst, max(abs(lines[k, 0]), abs(lines[k, 1])) * lines[k, 5])
    return worst


@bare
def _check(
    task: Task, i: int, quad_n: Array, quad_px: Array, cell_px: float, s: Scratch
) -> tuple[int, float]:
    """Wrong cells and margin, as `is_there`; the lens is left out where a tag is small."""
    lens, tags = task.lens, task.tags
    if cell_px * tags.border < _STRAIGHT_PX:
        flat = Lens(FLAT, lens.intrinsics, lens.coeffs, lens.size, lens.max_radius, lens.reach)
        return is_there(task.image, flat, quad_px, tags, i, cell_px, task.limits, s.pattern)
    return is_there(task.image, lens, quad_n, tags, i, cell_px, task.limits, s.pattern)
