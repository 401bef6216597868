"""Which detections may be trusted: one test a cause, and a function that applies and counts."""

from typing import TypeAlias

import numpy as np

from tagvo.config import FilterConfig
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.kernels.jit import bare, njit
from tagvo.records import Detections
from tagvo.tags.tag_map import TagMap

Resolution: TypeAlias = tuple[int, int]
_MIN_SINE = 0.05  # below 3 deg between neighbouring sides a quad is a line for all purposes
CAUSES = (
    "not_on_map", "hamming", "low_margin", "not_finite", "not_convex", "too_small", "at_edge",
    "duplicate",
)  # fmt: skip


@bare
def _runs_clockwise(quad: Array) -> bool:
    """Whether corners (4, 2) run clockwise in the image (y down) around a convex quad.

    So do those of every tag seen from its printed face.
    """
    for k in range(4):
        ax, ay = quad[k, 0] - quad[k - 1, 0], quad[k, 1] - quad[k - 1, 1]
        bx, by = quad[(k + 1) % 4, 0] - quad[k, 0], quad[(k + 1) % 4, 1] - quad[k, 1]
        lengths = np.sqrt((ax * ax + ay * ay) * (bx * bx + by * by))
        if not ax * by - ay * bx > _MIN_SINE * max(lengths, 1e-12):
            return False
    d1x, d1y = quad[2, 0] - quad[0, 0], quad[2, 1] - quad[0, 1]
    d2x, d2y = quad[3, 0] - quad[1, 0], quad[3, 1] - quad[1, 1]
    return bool(d1x * d2y - d1y * d2x > 0.0)


@bare
def _shortest_side(quad: Array) -> float:
    shortest = np.inf
    for k in range(4):
        x, y = quad[k, 0] - quad[k - 1, 0], quad[k, 1] - quad[k - 1, 1]
        shortest = min(shortest, np.sqrt(x * x + y * y))
    return shortest


@njit
def _within(quad: Array, width: float, height: float, edge_px: float) -> bool:
    low, right, bottom = edge_px - 0.5, width - 0.5 - edge_px, height - 0.5 - edge_px
    inside = True
    for k in range(4):
        inside = inside and low <= quad[k, 0] <= right and low <= quad[k, 1] <= bottom
    return inside


@njit
def _first_causes(
    rows: IntArray, corners_px: Array, hamming: IntArray, margin: Array, limits: Array
) -> IntArray:
    """Index in CAUSES of the first filter that each of n tags falls to, -1: none; (n,).

    limits: max_hamming, min_margin, min_side_px, width, height, edge_px.
    """
    cause = np.full(len(rows), -1, dtype=np.int64)
    for i in range(len(rows)):
        quad = corners_px[i]
        if rows[i] < 0:
            cause[i] = 0
        elif hamming[i] > limits[0]:
            cause[i] = 1
        elif margin[i] < limits[1]:  # NaN: unknown, passes
            cause[i] = 2
        elif not np.isfinite(quad).all():
            cause[i] = 3
        elif not _runs_clockwise(quad):
            cause[i] = 4
        elif _shortest_side(quad) < limits[2]:
            cause[i] = 5
        elif not _within(quad, limits[3], limits[4], limits[5]):
            cause[i] = 6
    return cause


def unambiguous(det: Detections, duplicate_px: float) -> BoolArray:
    """True for the one find to keep of each id; none where finds of one id disagree; (n,).

    Two finds with all corners within duplicate_px are one tag found twice: the one with fewer
    corrected bits, then the larger margin, stays. Further apart, one of them is false or the id
    is laid twice, and nothing here tells which: a wrong tag costs more than a missing one.
    """
    keep = np.ones(len(det), dtype=bool)
    if len(set(det.tag_id.tolist())) == len(det):
        return keep
    ids, counts = np.unique(det.tag_id, return_counts=True)
    for tag_id in ids[counts > 1]:
        rows = np.flatnonzero(det.tag_id == tag_id)
        keep[rows] = False
        spread = np.ptp(det.corners_px[rows], axis=0).max()
        if spread <= duplicate_px:
            margin = np.nan_to_num(det.margin[rows], nan=-np.inf)
            keep[rows[np.lexsort((-margin, det.hamming[rows]))[0]]] = True
    return keep


def filter_detections(
    det: Detections, tag_map: TagMap, limits: FilterConfig, resolution: Resolution
) -> tuple[Detections, IntArray, dict[str, int]]:
    """Detections that pass every filter, their rows in the map, and how many fell to each cause.

    resolution: width, height [px]. A detection counts once, under the first of CAUSES met.
    """
    rows = tag_map.rows(det.tag_id)
    bounds = np.array(
        [limits.max_hamming, limits.min_margin, limits.min_side_px, *resolution, limits.edge_px],
        dtype=float,
    )
    cause = _first_causes(rows, det.corners_px, det.hamming, det.margin, bounds)
    counts = dict.fromkeys(CAUSES, 0)
    left = np.flatnonzero(cause < 0)
    if len(left) < len(det):
        for k in cause[cause >= 0].tolist():
            counts[CAUSES[k]] += 1
        det, rows = det[left], rows[left]
    keep = unambiguous(det, limits.duplicate_px)
    counts["duplicate"] = len(keep) - int(np.count_nonzero(keep))
    if counts["duplicate"]:
        det, rows = det[keep], rows[keep]
    return det, rows, counts
