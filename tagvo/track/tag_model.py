"""What the tracker knows of every tag on the map: its printed cells and its geometry, as arrays."""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from tagvo.camera.model import MODELS, Camera, unproject
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.families import Family
from tagvo.tags.tag_map import TagMap

Cells: TypeAlias = NDArray[np.int8]
Gray: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
FLAT = -1
_RIM_STEPS = 64  # looks along each side of the image for what its rim shows
_IDS_LOOKED_AT = 24  # to find the cells of a family that no id uses


class Lens(NamedTuple):
    """A camera as the kernels take it; intrinsics (4,), coeffs (8,), size (2,) width, height.

    reach (4,): least and largest normalised x and y that fall into the image; model FLAT:
    normalised coordinates are pixels already.
    """

    model: int
    intrinsics: Array
    coeffs: Array
    size: Array
    max_radius: float
    reach: Array


class MapArrays(NamedTuple):
    """A map of n tags as the kernels take it.

    R_WT (n, 3, 3), p_WT (n, 3), corners_T (n, 4, 3), laying (n, 6): of the map; cells (n, c, c):
    the whole print upright, white 1, black -1, 0: may be anything; border: cells across the square
    that the corners span; sense: sign of the grey step from inside to outside across its edge;
    size (n,) [m].
    """

    R_WT: Array
    p_WT: Array
    corners_T: Array
    laying: Array
    cells: Cells
    border: int
    sense: float
    size: Array


class Belief(NamedTuple):
    """A camera pose R_WC (3, 3), p_WC (3,) and the covariance P (6, 6) of its error."""

    R_WC: Array
    p_WC: Array
    P: Array


class Limits(NamedTuple):
    """What is tried and taken, see `TrackConfig`."""

    min_contrast: float
    max_errors: int
    min_side_px: float
    max_sigma_px: float
    max_tags: int


class Task(NamedTuple):
    """What is looked at, for what, through what, within what limits."""

    image: Gray
    tags: MapArrays
    lens: Lens
    limits: Limits


class Foreseen(NamedTuple):
    """What is expected of each of n tags.

    quads_n (n, 4, 2) normalised; quads_px (n, 4, 2); sigma_px, cell_px, side_px, laying_px (n,):
    uncertainty of a corner, width of a cell, shortest side, what a laying error does; done (n,):
    it was tried.
    """

    quads_n: Array
    quads_px: Array
    sigma_px: Array
    cell_px: Array
    side_px: Array
    laying_px: Array
    done: BoolArray


class TrackedTags(NamedTuple):
    """Tags that were found, in the first places.

    rows (k,) of the map; corners_px (k, 4, 2); sigma_px (k, 4); wrong (k,): cells that read wrong;
    margin (k,); fates (6,): how many of those tried met which.
    """

    rows: IntArray
    corners_px: Array
    sigma_px: Array
    wrong: IntArray
    margin: Array
    fates: IntArray


def printed_cells(family: Family, tag_ids: NDArray[np.int64], border_bits: int) -> Cells:
    """Cells of tags (n,) -> (n, c, c): 1 white, -1 black, 0 where nothing is promised.

    Nothing is promised of cells outside the black and white rings that no id of the family sets
    (the corners of circular tags), nor of a white margin (on AprilGrids squares touch it).
    """
    ids = tag_ids.tolist()
    signs = np.array([tag_bitmap(family, i, border_bits) for i in ids]).astype(np.int16) // 255
    cells = (2 * signs - 1).astype(np.int8)
    few = np.linspace(0, family.ids - 1, min(_IDS_LOOKED_AT, family.ids)).astype(int).tolist()
    seen = np.array([tag_bitmap(family, i, border_bits) for i in few])
    unused = (seen == seen[0]).all(axis=0)
    outside = np.ones_like(unused)
    pad = (family.total_cells - family.border_cells) // 2
    ring = pad - 1 if family.reversed_border else pad
    outside[ring : len(unused) - ring, ring : len(unused) - ring] = False
    cells[:, outside & unused] = 0
    return cells


def map_arrays(tag_map: TagMap) -> MapArrays:
    """The arrays of a map; draws the cells of all its tags once."""
    family, bits = tag_map.family, tag_map.border_bits
    return MapArrays(
        np.ascontiguousarray(tag_map.R_WT),
        np.ascontiguousarray(tag_map.p_WT),
        np.ascontiguousarray(tag_map.corners_T),
        np.ascontiguousarray(tag_map.laying_sigma),
        printed_cells(family, tag_map.tag_id, bits),
        family.border_cells + 2 * (bits - 1),
        -1.0 if family.reversed_border else 1.0,
        np.ascontiguousarray(tag_map.size, dtype=float),
    )


def lens_of(camera: Camera) -> Lens:
    """The arrays of a camera."""
    return Lens(
        MODELS[camera.model],
        np.array(camera.intrinsics, dtype=float),
        np.array(camera.kernel_coeffs, dtype=float),
        np.array(camera.resolution, dtype=float),
        float(min(camera.max_radius, 1e3)),
        _view(camera),
    )


def _view(camera: Camera) -> Array:
    """Normalised bounds of what the image shows; (4,). The rim shows the farthest."""
    s = np.linspace(0.0, 1.0, _RIM_STEPS)
    zero, one = np.zeros_like(s), np.ones_like(s)
    rim = np.concatenate(
        [np.stack(side, axis=1) for side in ((s, zero), (s, one), (zero, s), (one, s))]
    )
    x_n, _, valid = unproject(camera, rim * (np.array(camera.resolution) - 1.0))
    reach = float(min(camera.max_radius, 1e3))
    if not valid.all():  # the lens bends back within the image
        return np.array([-reach, reach, -reach, reach])
    slack = 0.02 * float(np.abs(x_n).max())
    low, high = x_n.min(axis=0) - slack, x_n.max(axis=0) + slack
    return np.array([low[0], high[0], low[1], high[1]])
