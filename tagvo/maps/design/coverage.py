"""How many tags of use a camera sees from where over a map: the figure that map design maximises.

A tag is of use in a view where the whole print lies within the image and every side of its border
is at least `min_px` long there; so none is larger than the view. The views of a height: a level
camera over the middle of each cell of a grid of about 0.1 m on the map's rectangle, at each of two
headings (0 and 90 degrees).
"""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project, unproject
from tagvo.errors import MapError
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.maps.draw.views import View, frontal_view, surfaces_of
from tagvo.tags.tag_map import TagMap, tag_corners

MIN_PX = 20.0  # from here the usual decimation by 2 loses no tag
HEADINGS = (0.0, 0.5 * np.pi)  # [rad] of the image's x axis from the map's
POOREST = 0.2  # the share of the views of a height that its score is the mean of
STEP_M = 0.1  # between the places looked from
HEIGHT_COUNT = 12  # heights between the lowest and the highest
_PAIRS_AT_ONCE = 500_000  # of a view and a tag, which bounds the memory
_FLAT = 0.999  # cosine from which a tag counts as parallel to the image


@dataclass(frozen=True, slots=True, eq=False)
class AtHeight:
    """The views of one height [m]: median and 5th percentile of useful tags, share with none."""

    height: float
    median: float
    p5: float
    blind: float


def heights_between(low: float, high: float) -> Array:
    """The heights that a range stands for, evenly spread [m]; (h,)."""
    return np.linspace(low, high, 1 if high == low else HEIGHT_COUNT)


def score(counts: IntArray | Array) -> float:
    """The objective of map design over tags of use by height and view; (h, m) -> bits.

    At each height the mean of log2(1 + n) over the poorest fifth of its views; then the mean over
    the heights. A low quantile, so that no place starves; the logarithm, so that no height does:
    where there are few tags another one counts for more.
    """
    worth = np.log2(1.0 + counts)
    few = max(1, int(np.ceil(POOREST * worth.shape[1])))
    return float(np.partition(worth, few - 1, axis=1)[:, :few].mean())


def worth_in_tags(bits: float) -> float:
    """The number of tags which, seen in each of the poorest views, would have that score."""
    return float(2.0**bits - 1.0)


def by_height(heights: Array, counts: IntArray) -> list[AtHeight]:
    """The figure by height; heights (h,), counts (h, m)."""
    low = np.percentile(counts, 5.0, axis=1, method="inverted_cdf")
    return [
        AtHeight(float(h), float(np.median(row)), float(p5), float((row == 0).mean()))
        for h, row, p5 in zip(heights, counts, low, strict=True)
    ]


def cell_middles(low: float, high: float) -> Array:
    """Middles of cells of about `STEP_M` between two ends [m]; (k,)."""
    n = max(1, round((high - low) / STEP_M))
    return low + (high - low) * (np.arange(n) + 0.5) / n


def counts_in_view(
    tag_map: TagMap, camera: Camera, heights: Array, min_px: float = MIN_PX
) -> IntArray:
    """Tags of use in each view of the map's largest surface; heights (h,) [m] -> (h, m).

    The surface's rectangle is that of its printed tags; views run over x, then y, then heading.
    """
    rows = surfaces_of(tag_map)[0]
    view = frontal_view(tag_map, rows)
    outline = _outlines(tag_map)
    page = view.project(outline[rows].reshape(-1, 3))
    middles = [cell_middles(*ends) for ends in zip(page.min(axis=0), page.max(axis=0), strict=True)]
    places = np.stack(np.meshgrid(*middles, indexing="ij"), axis=-1).reshape(-1, 2)
    away = float((tag_map.p_WT[rows] @ view.towards).mean())
    counts = np.zeros((len(heights), len(places), len(HEADINGS)), dtype=np.int64)
    for i, height in enumerate(heights):
        p_WC = places @ view.page + (away + height) * view.towards
        for k, heading in enumerate(HEADINGS):
            R_WC = looking_at(view, heading)
            counts[i, :, k] = _count(tag_map, outline, camera, R_WC, p_WC, min_px)
    return counts.reshape(len(heights), -1)


def looking_at(view: View, heading: float) -> Array:
    """R_WC of a camera that faces a frontal view, its x axis at `heading` from the page's right."""
    right, up = view.page
    x_W = np.cos(heading) * right + np.sin(heading) * up
    return np.column_stack([x_W, np.cross(-view.towards, x_W), -view.towards])


def _outlines(tag_map: TagMap) -> Array:
    """Corners of the printed tags in W [m]; (n, 4, 3)."""
    corners_T = tag_corners(tag_map.total_size)
    return geo.transform(tag_map.R_WT[:, None], tag_map.p_WT[:, None], corners_T)


def edge_rays(camera: Camera) -> Array:
    """Normalised coordinates of pixels on the image's edge; (k, 2).

    Raises MapError where the camera's model has no inverse anywhere on the edge.
    """
    w, h = (float(n - 1) for n in camera.resolution)
    t = np.linspace(0.0, 1.0, 33)
    x = np.concatenate([w * t, w * t, 0.0 * t, w + 0.0 * t])
    y = np.concatenate([0.0 * t, h + 0.0 * t, h * t, h * t])
    rays, _, valid = unproject(camera, np.stack([x, y], axis=-1))
    if not valid.any():
        raise MapError(f"{camera.source}: no ray of the image's edge can be told from its model")
    return rays[valid]


def _sharpest(camera: Camera) -> float:
    """The most pixels that a metre at one metre's depth can take, anywhere in the image."""
    w, h = (np.linspace(0.0, n - 1.0, 17) for n in camera.resolution)
    _, J, valid = unproject(camera, np.stack(np.meshgrid(w, h), axis=-1).reshape(-1, 2))
    return float(np.linalg.norm(J[valid], ord=2, axis=(-2, -1)).max())


def _count(
    tag_map: TagMap, outline: Array, camera: Camera, R_WC: Array, p_WC: Array, min_px: float
) -> IntArray:
    """Tags of use from each place p_WC (m, 3) [m] with one attitude; (m,)."""
    counts = np.zeros(len(p_WC), dtype=np.int64)
    step = max(1, _PAIRS_AT_ONCE // len(tag_map))
    for start in range(0, len(p_WC), step):
        place, tag = _perhaps(tag_map, camera, R_WC, p_WC[start : start + step], min_px)
        place += start
        seen = _in_view(camera, (outline[tag] - p_WC[place, None]) @ R_WC)
        place, tag = place[seen], tag[seen]
        border_C = (tag_map.corners_W[tag] - p_WC[place, None]) @ R_WC
        useful = _long_enough(camera, border_C, min_px)
        facing = np.einsum("ki,ki->k", p_WC[place] - tag_map.p_WT[tag], tag_map.R_WT[tag, :, 2])
        counts += np.bincount(place[useful & (facing > 0.0)], minlength=len(p_WC))
    return counts


def _perhaps(
    tag_map: TagMap, camera: Camera, R_WC: Array, p_WC: Array, min_px: float
) -> tuple[IntArray, IntArray]:
    """Pairs (k,), (k,) of a place and a tag that a cheap bound cannot rule out."""
    rays = edge_rays(camera)
    p_C, place_C = tag_map.p_WT @ R_WC, p_WC @ R_WC
    flat = np.abs(tag_map.R_WT[:, :, 2] @ R_WC[:, 2]) > _FLAT
    nearest = p_C[:, 2] - place_C[:, 2].max()
    large = _sharpest(camera) * tag_map.size * 1.05 >= min_px * nearest
    some = np.flatnonzero(large | ~flat)  # of tilted tags no more than the centre is looked at
    across = np.abs(R_WC.T @ tag_map.R_WT[some])[:, :2, :2].sum(axis=-1)
    half = 0.475 * tag_map.total_size[some, None] * across * flat[some, None]
    off = p_C[some][None] - place_C[:, None]
    xy, depth = off[..., :2], off[..., 2:]
    inside = (xy - half >= depth * rays.min(axis=0)) & (xy + half <= depth * rays.max(axis=0))
    place, tag = np.nonzero(inside.all(axis=-1) & (depth[..., 0] > 0.0))
    return place, some[tag]


def _in_view(camera: Camera, corners_C: Array) -> BoolArray:
    """Whether all four corners are in the image; (k, 4, 3) -> (k,)."""
    pixels, good = project(camera, corners_C)
    high = np.array(camera.resolution) - 1.0
    inside = ((pixels >= 0.0) & (pixels <= high)).all(axis=-1) & good
    return np.asarray(inside.all(axis=-1))


def _long_enough(camera: Camera, corners_C: Array, min_px: float) -> BoolArray:
    """Whether each side of the border is at least so long in the image; (k, 4, 3) -> (k,)."""
    pixels, _ = project(camera, corners_C)
    sides = np.roll(pixels, -1, axis=-2) - pixels
    return np.asarray(np.sqrt(np.square(sides).sum(axis=-1)).min(axis=-1) >= min_px - 1e-9)
