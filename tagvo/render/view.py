"""Pictures of a tag map by exact geometry: the truth that detectors and pipelines are tested on.

`render_view` draws a clean map; `render_frame` (of `tagvo.render.frame`) a whole scene through a
moving camera, with all that goes wrong there. Here grey values are proportional to light (no
gamma), so that averaging over a pixel's area and over the exposure is averaging grey values. Pixel
centres lie at integer coordinates; each pixel is the mean of supersample^2 rays spread over its
area so that no two share a column or a row of the finer grid: an edge along the pixels is resolved
to 1/supersample^2 px.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from tagvo import geometry as geo
from tagvo.camera.model import Camera, unproject
from tagvo.geometry import Array, IntArray
from tagvo.render.frame import render_frame as render_frame
from tagvo.render.scene import displaced as displaced
from tagvo.render.sensor import Image as Image
from tagvo.render.visibility import boxes_in_view, cells_from_rays
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.tag_map import TagMap

Image32: TypeAlias = NDArray[np.float32]

_ROWS_AT_ONCE = 16  # rows of pixels unprojected together, which bounds the memory
_TO_CENTRES = np.array([[1.0, 0.0, -0.5], [0.0, 1.0, -0.5], [0.0, 0.0, 1.0]])  # of cells
_WAVES = np.array(  # of the floor's pattern [rad/m]
    [[2.3, 1.1], [-3.7, 2.9], [7.1, 9.7], [-17.3, 5.9], [23.9, -29.3], [41.1, 37.7]], np.float32
)


@dataclass(frozen=True, slots=True)
class Look:
    """Grey levels (0..255) of ink, paper and floor, and the gain on all three.

    texture: amplitude of a fixed pattern on the floor, the plane z = 0 of W.
    """

    black: float = 25.0
    white: float = 225.0
    floor: float = 128.0
    texture: float = 0.0
    gain: float = 1.0


def render_view(
    tag_map: TagMap,
    camera: Camera,
    R_WC: Array,
    p_WC: Array,
    *,
    look: Look | None = None,
    supersample: int = 4,
    noise_sigma: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Image:
    """What the camera sees of the map, every tag from its face only; -> (h, w) uint8.

    R_WC (3, 3), p_WC (3,) [m]; or (k, 3, 3), (k, 3): sub-exposures to be averaged (motion blur,
    see `exposure_poses`). noise_sigma: Gaussian noise in grey levels, drawn from `rng`.
    """
    if noise_sigma > 0.0 and rng is None:
        raise ValueError("noise_sigma > 0 needs an rng")
    look = look or Look()
    rays = _rays(_key(camera), supersample)
    R, p = np.reshape(R_WC, (-1, 3, 3)), np.reshape(p_WC, (-1, 3))
    light = _exposed(tag_map, camera, rays, R[0], p[0], look)
    for R_k, p_k in zip(R[1:], p[1:], strict=True):
        light += _exposed(tag_map, camera, rays, R_k, p_k, look)
    light *= look.gain / len(R)
    light *= rays.seen
    if noise_sigma > 0.0 and rng is not None:
        light += noise_sigma * rng.standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(light), 0, 255).astype(np.uint8)


def exposure_poses(
    R_WC: Array, p_WC: Array, twist_C: Array, exposure_s: float, count: int
) -> tuple[Array, Array]:
    """Poses R (count, 3, 3), p (count, 3) evenly over an exposure whose middle is the given pose.

    twist_C (6,): velocity [m/s] and rotation rate [rad/s] of the camera, written in C.
    """
    t = ((np.arange(count) + 0.5) / count - 0.5) * exposure_s
    return geo.compose(R_WC, p_WC, *geo.exp_se3(t[:, None] * twist_C))


_CameraKey: TypeAlias = tuple[str, tuple[float, ...], tuple[float, ...], tuple[int, int]]


@dataclass(frozen=True, slots=True, eq=False)
class _Rays:
    """Rays of one camera: x_n (h s, w s, 2) normalised; seen (h, w) share with an inverse.

    low, high (2,): range of x_n.
    """

    x_n: Image32
    seen: Image32
    low: Array
    high: Array
    supersample: int


def _key(camera: Camera) -> _CameraKey:
    """What the rays depend on, so that equal cameras share them."""
    numbers = tuple(camera.intrinsics.tolist()), tuple(camera.coeffs.tolist())
    return camera.model, *numbers, camera.resolution


@lru_cache(maxsize=4)
def _rays(key: _CameraKey, s: int) -> _Rays:
    """Normalised coordinates of every sub-pixel, exactly, by the camera's own model."""
    model, intrinsics, coeffs, (width, height) = key
    camera = Camera(model, np.array(intrinsics), np.array(coeffs), (width, height))
    i, j = np.mgrid[:s, :s]
    offset_x, offset_y = (np.array([j * s + i, i * s + j]) + 0.5) / s**2 - 0.5
    x_n = np.empty((height, s, width, s, 2), dtype=np.float32)
    seen = np.empty((height, width), dtype=np.float32)
    for top in range(0, height, _ROWS_AT_ONCE):
        rows = slice(top, min(top + _ROWS_AT_ONCE, height))
        y, x = np.mgrid[rows, :width].astype(float)
        px_x = x[:, None, :, None] + offset_x[:, None, :]
        px_y = y[:, None, :, None] + offset_y[:, None, :]
        found, _, valid = unproject(camera, np.stack([px_x, px_y], axis=-1))
        x_n[rows] = found
        seen[rows] = valid.mean(axis=(1, 3))
    fine = x_n.reshape(height * s, width * s, 2)
    return _Rays(fine, seen, fine.min(axis=(0, 1)), fine.max(axis=(0, 1)), s)


def _exposed(
    tag_map: TagMap, camera: Camera, rays: _Rays, R_WC: Array, p_WC: Array, look: Look
) -> Image32:
    """Light on each pixel at one instant in grey levels; (h, w)."""
    width, height = camera.resolution
    s = rays.supersample
    fine = _floor(rays, R_WC, p_WC, look)
    R_TC = np.swapaxes(tag_map.R_WT, -1, -2) @ R_WC
    p_TC = np.einsum("nji,nj->ni", tag_map.R_WT, p_WC - tag_map.p_WT)
    for i, (x0, x1, y0, y1), in_front in _visible(tag_map, camera, rays, R_TC, p_TC):
        box = slice(y0 * s, y1 * s), slice(x0 * s, x1 * s)
        cells = tag_bitmap(tag_map.family, int(tag_map.tag_id[i]), tag_map.border_bits)
        ink = np.where(cells > 0, look.white, look.black).astype(np.float32)
        side = np.repeat(tag_map.total_size[i], 2)
        H = _TO_CENTRES @ cells_from_rays(R_TC[i], p_TC[i], side, np.array(len(cells)))
        where = np.asarray(cv2.perspectiveTransform(rays.x_n[box], H), dtype=np.float32)
        if not in_front:  # rays that leave the tag's plane would see it mirrored
            where[rays.x_n[box] @ R_TC[i, 2, :2] + R_TC[i, 2, 2] >= 0.0] = -9.0
        _paint(fine[box], ink, where)
    return np.asarray(cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _paint(fine: Image32, ink: Image32, where: Image32) -> None:
    """Set each ray that hits a tag to the ink of its cell; `where` (..., 2) column, row."""
    nearest, keep = cv2.INTER_NEAREST, cv2.BORDER_TRANSPARENT
    cv2.remap(ink, where, None, nearest, dst=fine, borderMode=keep)  # type: ignore[call-overload]


def _visible(
    tag_map: TagMap, camera: Camera, rays: _Rays, R_TC: Array, p_TC: Array
) -> list[tuple[int, tuple[int, int, int, int], bool]]:
    """Row, pixel box (x0, x1, y0, y1) and "wholly in front" of tags that may show, far to near."""
    side = np.repeat(tag_map.total_size[:, None], 2, axis=1)
    boxes = boxes_in_view(camera, (rays.low, rays.high), R_TC, p_TC, side)
    rows: IntArray = np.flatnonzero(boxes.shows)
    far_first = rows[np.argsort(-np.linalg.norm(p_TC[rows], axis=1), kind="stable")]
    px = boxes.px.tolist()
    return [(int(i), tuple(px[i]), bool(boxes.in_front[i])) for i in far_first]


def _floor(rays: _Rays, R_WC: Array, p_WC: Array, look: Look) -> Image32:
    """The background on the fine grid; (h s, w s)."""
    fine = np.full(rays.x_n.shape[:2], look.floor, dtype=np.float32)
    s = rays.supersample
    if look.texture > 0.0:
        R, p = R_WC.astype(np.float32), p_WC.astype(np.float32)
        d_W = rays.x_n[::s, ::s] @ R[:, :2].T + R[:, 2]
        hits = d_W[..., 2] * p[2] < -1e-6
        depth = np.where(hits, -p[2] / np.where(hits, d_W[..., 2], 1.0), 0.0)
        xy_W = p[:2] + depth[..., None] * d_W[..., :2]
        pattern = np.sin(xy_W @ _WAVES.T).mean(axis=-1) * hits
        by_pixel = fine.reshape(pattern.shape[0], s, pattern.shape[1], s)
        by_pixel += look.texture * pattern[:, None, :, None]
    return fine
