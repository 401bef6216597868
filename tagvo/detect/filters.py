"""Which detections may be trusted: pure masks, and one function that applies and counts them."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from pydantic import BaseModel, Field

from tagvo.detect.edges import side_vectors, signed_area
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import Detections
from tagvo.tagmap import TagMap

Resolution: TypeAlias = tuple[int, int]
_MIN_SINE = 0.05  # below 3 deg between neighbouring sides a quad is a line for all purposes


class FilterConfig(BaseModel, frozen=True, extra="forbid"):
    """Limits of the detection filters.

    max_hamming: corrected bits; min_side_px: shortest side [px]; edge_px: least distance of a
    corner from the image's rim [px], negative: off (tags cut by the rim decode with corners off
    by up to 11 px; of 4,796 rendered tags of 36h11 that lie 6 px inside none was off by 0.5);
    min_margin: decision margin, 0 is off (a gate of 30 throws away real tags in dim rooms);
    duplicate_px: finds of one id that agree so well are one tag.
    """

    max_hamming: int = Field(1, ge=0)
    min_side_px: float = Field(6.0, ge=0.0)
    edge_px: float = Field(6.0, allow_inf_nan=False)
    min_margin: float = Field(0.0, ge=0.0)
    duplicate_px: float = Field(2.0, ge=0.0)


def finite(corners_px: Array) -> BoolArray:
    """True where all corners are finite numbers; (n, 4, 2) -> (n,)."""
    return np.asarray(np.isfinite(corners_px).all(axis=(1, 2)))


def convex(corners_px: Array) -> BoolArray:
    """True where the corners run clockwise in the image around a convex quad; (n, 4, 2) -> (n,).

    So do those of every tag seen from its printed face.
    """
    side, length, _ = side_vectors(corners_px)
    before, length_before = side[:, [3, 0, 1, 2]], length[:, [3, 0, 1, 2]]
    turn = before[..., 0] * side[..., 1] - before[..., 1] * side[..., 0]
    sine = turn / (length * length_before)
    return np.asarray((sine > _MIN_SINE).all(axis=1) & (signed_area(corners_px) > 0.0))


def large_enough(corners_px: Array, min_side_px: float) -> BoolArray:
    """True where no side is shorter than the limit [px]; (n, 4, 2) -> (n,)."""
    return np.asarray(side_vectors(corners_px)[1].min(axis=1, initial=np.inf) >= min_side_px)


def away_from_edge(corners_px: Array, resolution: Resolution, edge_px: float) -> BoolArray:
    """True where every corner lies at least edge_px inside the image's rim; (n, 4, 2) -> (n,).

    The rim runs half a pixel outside the centres of the outermost pixels.
    """
    low, high = edge_px - 0.5, np.array(resolution) - 0.5 - edge_px
    return np.asarray(((corners_px >= low) & (corners_px <= high)).all(axis=(1, 2)))


def unambiguous(det: Detections, duplicate_px: float) -> BoolArray:
    """True for the one find to keep of each id; none where finds of one id disagree; (n,).

    Two finds with all corners within duplicate_px are one tag found twice: the one with fewer
    corrected bits, then the larger margin, stays. Further apart, one of them is false or the id
    is laid twice, and nothing here tells which: a wrong tag costs more than a missing one.
    """
    keep = np.ones(len(det), dtype=bool)
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

    resolution: width, height [px]. A detection counts once, under the first cause met; the causes
    are not_on_map, hamming, low_margin, not_finite, not_convex, too_small, at_edge, duplicate.
    """
    rows = tag_map.rows(det.tag_id)
    filters: tuple[tuple[str, Callable[[Detections], BoolArray]], ...] = (
        ("hamming", lambda d: d.hamming <= limits.max_hamming),
        ("low_margin", lambda d: ~(d.margin < limits.min_margin)),  # NaN: unknown, passes
        ("not_finite", lambda d: finite(d.corners_px)),
        ("not_convex", lambda d: convex(d.corners_px)),
        ("too_small", lambda d: large_enough(d.corners_px, limits.min_side_px)),
        ("at_edge", lambda d: away_from_edge(d.corners_px, resolution, limits.edge_px)),
        ("duplicate", lambda d: unambiguous(d, limits.duplicate_px)),
    )
    counts = {"not_on_map": int((rows < 0).sum())}
    left = np.flatnonzero(rows >= 0)
    for cause, passes in filters:
        kept = left[passes(det[left])]
        counts[cause] = len(left) - len(kept)
        left = kept
    return det[left], rows[left], counts
