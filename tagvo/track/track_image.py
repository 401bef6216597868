"""Tracks the tags of one image: anchors first, then all others about the pose that they give.

Compiled as one call, so that no interpreter runs between tags.
"""

import math

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.kernels.jit import bare, njit
from tagvo.track.predict import (
    corner_spread,
    extent,
    inside,
    largest_sigma,
    laying_px,
    may_be_seen,
    posterior,
    project_tag,
)  # fmt: skip
from tagvo.track.tag_fit import OUTLIER, TRACKED, Scratch, scratch, track_tag
from tagvo.track.tag_model import Gray, Lens, MapArrays

_EDGE_PX = 4.0  # least distance of a predicted corner from the rim
_ANCHORS = 3
_TRIES = 8  # tags looked for before the prior is given up
_ENOUGH, _USEFUL_PX = 12, 18.0  # tags, beyond which those with shorter sides are left out
_OUTLIER = 5.0  # rms of a tag's residual over its sigma


@bare
def _foresee(
    R_WC: Array, p_WC: Array, P: Array, tags: MapArrays, lens: Lens, i: int, min_side: float,
    quad_n: Array, quad_px: Array, facts: Array, s: Scratch,
) -> bool:  # fmt: skip
    """Predict tag i; facts (4,): sigma [px], cell [px], shortest side [px], laying [px]."""
    if not may_be_seen(R_WC, p_WC, tags, i, lens, min_side):
        return False
    if not project_tag(R_WC, p_WC, tags, i, lens, quad_n, quad_px, s.J):
        return False
    if not inside(quad_px, lens, _EDGE_PX):
        return False
    side, height = extent(quad_px)
    if side < min_side or height < 0.5 * min_side:
        return False
    corner_spread(s.J, P, s.spread)
    lay = laying_px(R_WC, p_WC, tags, i, lens)
    facts[0] = math.sqrt(largest_sigma(s.spread) ** 2 + lay * lay)
    facts[1], facts[2], facts[3] = min(side, height) / tags.border, side, lay
    return True


@bare
def _in_view(
    R_WC: Array, p_WC: Array, P: Array, tags: MapArrays, lens: Lens, min_side: float,
    done: BoolArray, seen: IntArray, quads_n: Array, quads_px: Array, facts: Array, s: Scratch,
) -> tuple[int, float]:  # fmt: skip
    """Foresee all tags but those done; into seen those in view -> how many, largest sigma [px]."""
    count, largest = 0, 0.0
    for i in range(len(tags.p_WT)):
        if not done[i] and _foresee(
            R_WC, p_WC, P, tags, lens, i, min_side, quads_n[i], quads_px[i], facts[i], s
        ):
            seen[count] = i
            count += 1
            largest = max(largest, facts[i, 0])
    return count, largest


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
        a = size[seen[m]]
        if a > 1.001 * largest:
            largest, second = a, largest
        elif 1.001 * second < a < 0.999 * largest:
            second = a
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
    s = scratch(tags.cells.shape[1], limits[3])
    done = np.zeros(n, dtype=np.bool_)
    found = 0
    count, largest = _in_view(
        R, p, P, tags, lens, limits[2], done, seen, quads_n, quads_px, facts, s
    )
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
        if best < 0:  # none left: some were in view by the prior alone
            break
        done[best] = True
        if found > 0 and not _foresee(
            R, p, P, tags, lens, best, limits[2], quads_n[best], quads_px[best], facts[best], s
        ):
            continue
        tried += 1
        k = found
        fate, wrong[k], margin[k] = track_tag(
            image, tags, best, lens, quads_n[best], facts[best, 1], facts[best, 0], limits,
            corners[k], sigma[k], s,
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
        s,
    )  # fmt: skip


@bare
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
    facts: Array, chi: Array, s: Scratch,
) -> tuple[int, int, float]:  # fmt: skip
    """The tags besides the anchors, about the pose (R, p, P) that these gave; see `track_image`."""
    count, _ = _in_view(R, p, P, tags, lens, limits[2], done, seen, quads_n, quads_px, facts, s)
    count = _spread_out(facts, quads_px, lens, seen, count, max(wanted - found, 0), size, order)
    for m in range(count):
        i, k = order[m], found
        fate, wrong[k], margin[k] = track_tag(
            image, tags, i, lens, quads_n[i], facts[i, 1], facts[i, 0], limits,
            corners[k], sigma[k], s,
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
