"""Tracks the tags of one image: anchors first, then all others about the pose that they give.

Compiled as one call, so that no interpreter runs between tags.
"""

import math

import numpy as np

from tagvo.geometry import IntArray
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.projection import corner_covariance
from tagvo.track.predict import (
    extent,
    inside,
    largest_sigma,
    laying_px,
    may_be_seen,
    posterior,
    project_tag,
)  # fmt: skip
from tagvo.track.tag_fit import OUTLIER, TRACKED, Scratch, scratch, track_tag
from tagvo.track.tag_model import Belief, Foreseen, Gray, Lens, Limits, MapArrays, Task, TrackedTags

_EDGE_PX = 4.0  # least distance of a predicted corner from the rim
_ANCHORS = 3
_TRIES = 8  # tags looked for before the prior is given up
_ENOUGH, _USEFUL_PX = 12, 18.0  # tags, beyond which those with shorter sides are left out
_OUTLIER = 5.0  # rms of a tag's residual over its sigma


@njit
def _nothing_foreseen(n: int) -> Foreseen:
    return Foreseen(
        np.empty((n, 4, 2)), np.empty((n, 4, 2)), np.empty(n), np.empty(n), np.empty(n),
        np.empty(n), np.zeros(n, dtype=np.bool_),
    )  # fmt: skip


@bare
def _foresee(task: Task, camera: Belief, i: int, out: Foreseen, s: Scratch) -> bool:
    """Predict tag i; False: it is of no use."""
    R_WC, p_WC, P = camera
    tags, lens, quad_px = task.tags, task.lens, out.quads_px[i]
    least = task.limits.min_side_px
    if not project_tag(R_WC, p_WC, tags, i, lens, out.quads_n[i], quad_px, s.J):
        return False
    if not inside(quad_px, lens, _EDGE_PX):
        return False
    side, height = extent(quad_px)
    if side < least or height < 0.5 * least:
        return False
    corner_covariance(s.J, P, s.spread)
    lay = laying_px(R_WC, p_WC, tags, i, lens)
    out.sigma_px[i] = math.sqrt(largest_sigma(s.spread) ** 2 + lay * lay)
    out.cell_px[i] = min(side, height) / tags.border
    out.side_px[i], out.laying_px[i] = side, lay
    return True


@bare
def _in_view(
    task: Task, camera: Belief, out: Foreseen, seen: IntArray, s: Scratch
) -> tuple[int, float]:
    """Foresee all tags but those done; into seen those in view -> how many, largest sigma [px]."""
    count, largest, least = 0, 0.0, task.limits.min_side_px
    for i in range(len(seen)):
        if out.done[i] or not may_be_seen(camera.R_WC, camera.p_WC, task.tags, i, task.lens, least):
            continue
        if _foresee(task, camera, i, out, s):
            seen[count] = i
            count += 1
            largest = max(largest, out.sigma_px[i])
    return count, largest


@njit
def _spread_out(
    task: Task, expected: Foreseen, seen: IntArray, wanted: int, order: IntArray
) -> int:
    """The most useful `wanted` of the tags seen, into order; -> how many.

    Worth is the square of the side over that of the corners' error, laying included, divided among
    the tags already taken from the same twelfth of the image; the two largest sizes in view come
    first, since the selection of the paper lives on them. Small tags are left out once there are
    enough.
    """
    count, size, frame = len(seen), task.tags.size, task.lens.size
    side, lay = expected.side_px, expected.laying_px
    taken, crowd = np.zeros(count, dtype=np.bool_), np.zeros(12)
    place, n = np.empty(count, dtype=np.int64), min(wanted, count)
    for m in range(count):
        q = expected.quads_px[seen[m]]
        u = 0.25 * (q[0, 0] + q[1, 0] + q[2, 0] + q[3, 0]) / frame[0]
        v = 0.25 * (q[0, 1] + q[1, 1] + q[2, 1] + q[3, 1]) / frame[1]
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
            w = side[i] ** 2 / ((0.01 + lay[i] ** 2) * (1.0 + crowd[place[m]]))
            if size[i] > 0.999 * second:
                w *= 1e6
            if w > worth:
                best, worth = m, w
        if chosen >= _ENOUGH and side[seen[best]] < _USEFUL_PX:
            taken[best] = True  # small beside those there are: not worth the time
            continue
        taken[best] = True
        crowd[place[best]] += 1.0
        order[chosen] = seen[best]
        chosen += 1
    return chosen


@njit
def track_image(
    image: Gray, tags: MapArrays, lens: Lens, prior: Belief, limits: Limits, out: TrackedTags
) -> tuple[int, int, float]:
    """Every tag of the map that the prior puts into the image, as far as it is there.

    Writes out; -> how many were tracked, how many tried, largest sigma of the prior among tags in
    view [px].
    """
    n, task = len(tags.p_WT), Task(image, tags, lens, limits)
    s = scratch(tags.cells.shape[1], limits.max_sigma_px)
    expected, seen = _nothing_foreseen(n), np.empty(n, dtype=np.int64)
    camera = Belief(prior.R_WC.copy(), prior.p_WC.copy(), prior.P.copy())
    count, largest = _in_view(task, camera, expected, seen, s)
    if count == 0 or largest > limits.max_sigma_px:
        return 0, count, largest
    found, tried = _anchors(task, prior, camera, expected, seen[:count], out, s)
    if found < 0:
        return 0, count, largest
    if found == 0:
        return 0, tried, largest
    count, _ = _in_view(task, camera, expected, seen, s)
    order = np.empty(n, dtype=np.int64)
    wanted = max(limits.max_tags - found, 0)
    count = _spread_out(task, expected, seen[:count], wanted, order)
    for m in range(count):
        fate = track_tag(task, order[m], expected, out, found, s)
        if fate == TRACKED:
            out.rows[found] = order[m]
            found += 1
        out.fates[fate] += 1
    kept = _without_outliers(task, prior, camera, out, found)
    return kept, tried + count, largest


@njit
def _anchors(
    task: Task, prior: Belief, camera: Belief, expected: Foreseen, seen: IntArray,
    out: TrackedTags, s: Scratch,
) -> tuple[int, int]:  # fmt: skip
    """A few tags far apart, each sought about the pose that those before give, into camera.

    -> how many were found (-1: no pose comes of them), how many tried.
    """
    found, tried, chi = 0, 0, np.empty(_ANCHORS)
    while found < _ANCHORS and tried < min(_TRIES, len(seen)):
        best, worth = -1, -1.0
        for i in seen:
            if not expected.done[i]:
                w = _anchor_worth(expected, i, out.rows[:found])
                if w > worth:
                    best, worth = i, w
        if best < 0:  # none left: some were in view by the prior alone
            break
        expected.done[best] = True
        if found > 0 and not (
            may_be_seen(
                camera.R_WC, camera.p_WC, task.tags, best, task.lens, task.limits.min_side_px
            )
            and _foresee(task, camera, best, expected, s)
        ):
            continue
        tried += 1
        fate = track_tag(task, best, expected, out, found, s)
        out.fates[fate] += 1
        if fate != TRACKED:
            continue
        out.rows[found] = best
        found += 1
        if not posterior(prior, task.tags, task.lens, out, found, camera, chi):
            return -1, tried
    return found, tried


@bare
def _anchor_worth(expected: Foreseen, i: int, rows: IntArray) -> float:
    """How good an anchor tag i is: large for its uncertainty, far from the anchors there are."""
    worth = expected.cell_px[i] / (expected.sigma_px[i] + 1.0) * min(expected.side_px[i], 150.0)
    nearest, quad_px = 1e3, expected.quads_px[i]
    for row in rows:
        q = expected.quads_px[row]
        nearest = min(nearest, math.hypot(quad_px[0, 0] - q[0, 0], quad_px[0, 1] - q[0, 1]))
    return float(worth * min(nearest, 300.0))


@njit
def _without_outliers(
    task: Task, prior: Belief, camera: Belief, out: TrackedTags, found: int
) -> int:
    """Drop the tags that the pose of all contradicts, which goes into camera; -> how many stay."""
    chi = np.empty(found)
    if not posterior(prior, task.tags, task.lens, out, found, camera, chi):
        return 0
    kept = 0
    for k in range(found):
        if chi[k] > _OUTLIER:
            out.fates[TRACKED] -= 1
            out.fates[OUTLIER] += 1
            continue
        if kept != k:
            out.rows[kept], out.wrong[kept], out.margin[kept] = (
                out.rows[k], out.wrong[k], out.margin[k],
            )  # fmt: skip
            out.corners_px[kept], out.sigma_px[kept] = out.corners_px[k], out.sigma_px[k]
        kept += 1
    return kept
