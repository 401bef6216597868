"""Where flat rectangles show in an image: their pixel boxes, and the homography to their cells.

A rectangle has a frame P as a tag has: x right, y up, z out of its face, the origin in its middle.
"""

from typing import NamedTuple

import numpy as np

from tagvo.camera.model import Camera, project
from tagvo.geometry import Array, BoolArray, IntArray

_NEAR = 1e-3  # [m] along z of C: a rectangle reaching nearer has no outline to trust
_MARGIN = 2  # [px] around an outline
_POINTS_PER_EDGE = 8


class Boxes(NamedTuple):
    """Of n rectangles: box (n, 4) x0 x1 y0 y1 [px], high ends excluded; what shows at all (n,);
    what lies in front of the camera with its whole outline (n,)."""

    px: IntArray
    shows: BoolArray
    in_front: BoolArray


def boxes_in_view(
    camera: Camera, view: tuple[Array, Array], R_PC: Array, p_PC: Array, side: Array
) -> Boxes:
    """Boxes of rectangles seen from R_PC (n, 3, 3), p_PC (n, 3) [m]; side (n, 2) [m].

    view: lowest and highest normalised coordinates of the image, (2,) each. A rectangle shows
    from its face only.
    """
    t = np.linspace(-0.5, 0.5, _POINTS_PER_EDGE, endpoint=False)
    half, flat = np.full_like(t, 0.5), np.zeros_like(t)
    edges = [(t, half), (half, -t), (-t, -half), (-half, t)]
    unit = np.concatenate([np.stack([x, y, flat], axis=-1) for x, y in edges])
    p_P = np.insert(side, 2, 0.0, axis=1)[:, None] * unit
    p_C = (p_P - p_PC[:, None]) @ R_PC
    front = p_C[..., 2] > _NEAR
    x_n = p_C[..., :2] / np.where(front, p_C[..., 2], np.nan)[..., None]
    in_front = front.all(axis=1)
    beside = in_front & ((x_n.max(1) < view[0]) | (x_n.min(1) > view[1])).any(axis=1)
    pixels, valid = project(camera, p_C)
    pixels = np.clip(pixels, -1e6, 1e6)  # far aside the distortion's polynomial runs away
    low = np.floor(pixels.min(axis=1)).astype(int) - _MARGIN
    high = np.ceil(pixels.max(axis=1)).astype(int) + _MARGIN + 1
    low[~valid.all(axis=1)], high[~valid.all(axis=1)] = 0, camera.resolution
    low, high = np.maximum(low, 0), np.minimum(high, camera.resolution)
    shows = (p_PC[:, 2] > 0.0) & front.any(axis=1) & ~beside & (low < high).all(axis=1)
    box = np.stack([low[:, 0], high[:, 0], low[:, 1], high[:, 1]], axis=1)
    return Boxes(box, shows, in_front)


def cells_from_rays(R_PC: Array, p_PC: Array, side: Array, cells: IntArray) -> Array:
    """Homographies from normalised coordinates to (column, row), 0 at the upper left corner.

    R_PC (..., 3, 3), p_PC (..., 3) [m], side (..., 2) [m], cells (...) a side -> (..., 3, 3). The
    third row gives -p_z / depth: negative where a ray meets the plane in front of the camera.
    """
    H = np.empty_like(R_PC)
    H[..., 2, :] = R_PC[..., 2, :]
    for axis, sign in ((0, 1.0), (1, -1.0)):
        k = (sign * cells / side[..., axis])[..., None]
        across = p_PC[..., axis, None] * R_PC[..., 2, :] - p_PC[..., 2, None] * R_PC[..., axis, :]
        H[..., axis, :] = k * across + (0.5 * cells)[..., None] * R_PC[..., 2, :]
    return H
