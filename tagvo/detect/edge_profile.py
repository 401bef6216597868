"""Looks at the sides of tags in the image itself: where each edge runs and how wide it is.

Everything is batched over tags. Side k of a tag runs from its corner k to corner k+1; the corners
run clockwise in the image (y down), so that the outward normal of a side is on its left.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tagvo.geometry import Array

Gray: TypeAlias = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
Single: TypeAlias = NDArray[np.float32]  # pixels have 8 bits; half the memory traffic

MARGIN = 0.12  # share of a side left out at either end: there the neighbouring side blurs in
_ROUNDS = ((0.9, 8, 13), (0.7, 16, 11), (0.7, 16, 11))  # reach in cells, scan lines, samples each
_SEARCH_PX = 3.0  # how far from a rough corner the edge is looked for


def sample(image: Gray, x: Single, y: Single) -> Single:
    """Bilinear grey values of an image (h, w) at x, y (...) [px]; outside: those of its rim."""
    h, w = image.shape
    x, y = np.fmin(np.fmax(x, 0), w - 1), np.fmin(np.fmax(y, 0), h - 1)  # NaN: 0
    x0 = np.minimum(x.astype(np.int32), max(w - 2, 0))
    y0 = np.minimum(y.astype(np.int32), max(h - 2, 0))
    x -= x0
    y -= y0
    right, down = min(1, w - 1), w * min(1, h - 1)
    flat = image.reshape(-1)
    at = y0 * w + x0
    top, below = flat.take(at).astype(np.float32), flat.take(at + down).astype(np.float32)
    top += x * (flat.take(at + right) - top)
    below += x * (flat.take(at + (right + down)) - below)
    return top + y * (below - top)


def side_vectors(corners_px: Array) -> tuple[Array, Array, Array]:
    """Of each side: the vector along it, its length, its outward unit normal [px].

    corners_px (n, 4, 2) -> (n, 4, 2), (n, 4), (n, 4, 2).
    """
    side = corners_px[:, [1, 2, 3, 0]] - corners_px
    length = np.maximum(np.sqrt(np.einsum("nki,nki->nk", side, side)), 1e-6)
    normal = np.stack([side[..., 1], -side[..., 0]], axis=-1) / length[..., None]
    return side, length, normal


def signed_area(corners_px: Array) -> Array:
    """Area of quads [px^2], positive where the corners run clockwise in the image; (n,)."""
    d = corners_px[:, 2:] - corners_px[:, :2]
    return np.asarray(0.5 * (d[:, 0, 0] * d[:, 1, 1] - d[:, 0, 1] * d[:, 1, 0]))


def cell_width(corners_px: Array, cells: int) -> Array:
    """Width of one cell across each side [px], foreshortening included; (n, 4, 2) -> (n, 4)."""
    _, length, _ = side_vectors(corners_px)
    return np.asarray(np.abs(signed_area(corners_px))[:, None] / (length * cells))


def edge_profiles(
    image: Gray, corners_px: Array, reach_px: Array, scans: int, steps: int
) -> Single:
    """Grey values across the sides; corners (n, 4, 2) -> (n, 4, scans, steps).

    reach_px (n, 4): samples run from -reach (inside) to +reach (outside) along the normal.
    """
    side, _, normal = side_vectors(corners_px)
    along = np.linspace(MARGIN, 1.0 - MARGIN, scans, dtype=np.float32)[:, None]
    across = np.linspace(-1.0, 1.0, steps, dtype=np.float32)
    a, d, r = (
        v.astype(np.float32)[:, :, None, None]
        for v in (corners_px, side, reach_px[..., None] * normal)
    )
    x = (a[..., 0] + along * d[..., 0]) + across * r[..., 0]
    y = (a[..., 1] + along * d[..., 1]) + across * r[..., 1]
    return sample(image, x, y)


def rising(profiles: Single) -> Single:
    """Steps between neighbouring samples, those against the tag's own sense set to 0.

    profiles (n, 4, ..., steps) -> (n, 4, ..., steps - 1); the sense (dark or bright inside) is
    that of the whole tag.
    """
    step = np.diff(profiles, axis=-1)
    gain = (profiles[..., -1] - profiles[..., 0]).reshape(len(step), -1).sum(axis=-1)
    sense = np.where(gain < 0.0, np.float32(-1), np.float32(1))
    return np.maximum(step * sense.reshape(-1, *([1] * (step.ndim - 1))), 0)


def refit_corners(image: Gray, corners_px: Array, cells: int) -> Array:
    """Corners as crossings of lines fitted to the four edges; rough corners (n, 4, 2) -> same.

    cells: cells across the square that the corners span. A tag whose corner would move further
    than the edges are looked for keeps its rough corners.
    """
    if not len(corners_px) or not image.size:
        return corners_px
    width = cell_width(corners_px, cells)
    corners = corners_px
    for share, scans, steps in _ROUNDS:
        reach = np.clip(share * width, 1.0, _SEARCH_PX)
        start, end = _edge_lines(edge_profiles(image, corners, reach, scans, steps), reach)
        corners = _crossings(corners, start, end)
    moved = np.square(corners - corners_px).sum(axis=-1).max(axis=1)
    good = moved <= _SEARCH_PX**2  # not where NaN
    return np.where(good[:, None, None], corners, corners_px)


def _edge_lines(profiles: Single, reach_px: Array) -> tuple[Array, Array]:
    """Offsets [px] of the fitted line from each side at its two ends; (n, 4) and (n, 4)."""
    scans, steps = profiles.shape[2:]
    weight = np.square(rising(profiles))
    middle = np.linspace(-1.0, 1.0, 2 * steps - 1, dtype=np.float32)[1::2]
    mass = weight.sum(axis=-1)
    place = reach_px[..., None] * (weight @ middle / np.maximum(mass, 1e-9))  # (n, 4, scans)
    along = np.linspace(MARGIN, 1.0 - MARGIN, scans)
    start, end = _line(along, place, mass)
    residual = np.abs(place - start[..., None] - along * (end - start)[..., None])
    limit = 3.0 * np.median(residual, axis=-1, keepdims=True) + 0.03
    return _line(along, place, mass * (residual < limit))


def _line(along: Array, place: Array, weight: Array) -> tuple[Array, Array]:
    """Weighted straight line through place (..., scans): its values at along = 0 and 1."""
    total = np.maximum(weight.sum(axis=-1), 1e-9)
    x = (weight * along).sum(axis=-1) / total
    y = (weight * place).sum(axis=-1) / total
    dx, dy = along - x[..., None], place - y[..., None]
    slope = (weight * dx * dy).sum(axis=-1) / np.maximum((weight * dx * dx).sum(axis=-1), 1e-9)
    return y - slope * x, y + slope * (1.0 - x)


def _crossings(corners_px: Array, start: Array, end: Array) -> Array:
    """Corners (n, 4, 2) where neighbouring sides cross once moved outward by start and end."""
    side, _, normal = side_vectors(corners_px)
    a = corners_px + start[..., None] * normal
    d = side + (end - start)[..., None] * normal
    a0, d0 = a[:, [3, 0, 1, 2]], d[:, [3, 0, 1, 2]]  # the side that ends in this corner
    det = d0[..., 0] * d[..., 1] - d0[..., 1] * d[..., 0]
    gap = a - a0
    flat = np.abs(det) < 1e-9
    t = (gap[..., 0] * d[..., 1] - gap[..., 1] * d[..., 0]) / np.where(flat, np.nan, det)
    return np.asarray(a0 + t[..., None] * d0)
