"""One frame of a scene as a camera in motion takes it, with all that lens, shutter and sensor do.

Geometry is exact: each sample of each pixel is a ray of its own, at its own time, met with the
tags as they truly lie. Surfaces are matt and flat; light is linear until the sensor's gamma.
"""

from functools import lru_cache
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np

from tagvo.camera.model import Camera, unproject
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.render import shutter
from tagvo.render.cells_hit import Array32, Samples, Surfaces
from tagvo.render.config import LensConfig
from tagvo.render.lighting import even_light, flicker, glare_grey, shaded_share
from tagvo.render.scanline import paint
from tagvo.render.scene import Scene
from tagvo.render.sensor import Image, defocused, develop, pad_of
from tagvo.render.shutter import PoseAt, Seen, Way
from tagvo.render.surfaces import Patches
from tagvo.render.texture import floor_factor
from tagvo.render.visibility import boxes_in_view, cells_from_rays

_GRID = 4  # [px] between the places where the light is computed
_LOW = np.array([True, False, True, False])  # of x0 x1 y0 y1
_MAX_MOMENTS = 16  # at which a blurred floor is looked at
_FAR = 1e4  # [m] along rays that miss the floor
_CLOSE = 0.05  # [m]: what is nearer has no say in how fast things move


def render_frame(
    scene: Scene,
    camera: Camera,
    pose_at: PoseAt,
    t_s: float,
    lens: LensConfig,
    rng: np.random.Generator,
) -> Image:
    """What the camera sees of the scene; -> (h, w) uint8.

    pose_at: times (k,) [s] -> R_WC (k, 3, 3), p_WC (k, 3) [m] of the true camera, asked at all
    times that the frame needs: half the read-out and half the exposure before and after t_s, the
    middle of the exposure of the image's middle row. rng: for the noise.
    """
    pad = pad_of(lens.defocus_px)
    view = _view(_key(camera, pad))
    rows = shutter.row_times(t_s, lens.readout_s, camera.resolution[1], pad)
    half = 0.5 * lens.exposure_s
    flown = shutter.way(pose_at, rows[0] - half, rows[-1] + half)
    light = _light(scene, view, flown, rows, t_s, lens)
    return develop(defocused(light, lens.defocus_px, pad), camera, lens, rng)


class View(NamedTuple):
    """A camera's pixels, a margin included: rays (h, 6, w), see `paint`; seen (h, w), 0 where the
    lens has no inverse; low, high (2,): range of normalised coordinates; corners_n (k, 2): rays
    spread over the picture."""

    camera: Camera
    rays: Array32
    seen: Array32
    low: Array
    high: Array
    corners_n: Array


_CameraKey: TypeAlias = tuple[str, tuple[float, ...], tuple[float, ...], tuple[int, int]]


def _key(camera: Camera, pad: int) -> _CameraKey:
    """What the rays depend on, so that equal cameras share them."""
    width, height = camera.resolution
    fu, fv, pu, pv = camera.intrinsics.tolist()
    inside = (fu, fv, pu + pad, pv + pad), tuple(camera.coeffs.tolist())
    return camera.model, *inside, (width + 2 * pad, height + 2 * pad)


@lru_cache(maxsize=4)
def _view(key: _CameraKey) -> View:
    model, intrinsics, coeffs, (width, height) = key
    camera = Camera(model, np.array(intrinsics), np.array(coeffs), (width, height))
    y, x = np.mgrid[:height, :width].astype(float)
    x_n, J, valid = unproject(camera, np.stack([x, y], axis=-1))
    d = np.linalg.inv(np.where(valid[..., None, None], J, np.eye(2))).reshape(height, width, 4)
    rays = np.ascontiguousarray(np.concatenate([x_n, d], axis=-1).transpose(0, 2, 1), np.float32)
    ends = (
        np.linspace(0, height - 1, 5).astype(int)[:, None],
        np.linspace(0, width - 1, 5).astype(int),
    )
    edge = np.abs(d).sum(axis=-1, keepdims=True)  # a pixel's rays reach this far at most
    low, high = (x_n - edge).min(axis=(0, 1)), (x_n + edge).max(axis=(0, 1))
    return View(camera, rays, valid.astype(np.float32), low, high, x_n[ends].reshape(-1, 2))


def _light(
    scene: Scene, view: View, flown: Way, rows: Array, t_s: float, lens: LensConfig
) -> Array32:
    """Light on each pixel in grey levels; (h, w)."""
    near = may_show(scene.patches, view, flown)
    seen = Seen(view.camera, view.corners_n, _nearest(scene.patches, near, flown))
    flown = shutter.thinned(flown, seen)
    blur, points = shutter.motion(seen, flown, t_s, lens.exposure_s)
    pattern = shutter.pattern(lens.supersample, lens.sub_exposures, blur)
    samples = in_time(pattern, points, lens.exposure_s / flown.step_s)
    surfaces = visible(scene.patches, near, seen, view, flown)
    grey = scene.grey.astype(np.float32)
    light, bare = paint(view.rays, flown.knot(rows).astype(np.float32), samples, surfaces, grey)
    light += _floor(scene, view, flown, rows, bare, blur, lens.exposure_s)
    lit = _lighting(scene, view, flown, rows, lens.exposure_s)
    if lit is not None:
        light = light * lit[0] + lit[1]
    return light * view.seen


def in_time(pattern: Array, points: int, exposure_knots: float) -> Samples:
    """The pattern between the points in time of an exposure that lasts so many knots."""
    if points == 1:
        time, j, ahead = np.zeros(1), np.zeros(len(pattern), int), np.zeros(len(pattern))
    else:
        time = np.linspace(-0.5, 0.5, points)
        at = (pattern[:, 2] + 0.5) * (points - 1)
        j = np.minimum(at.astype(int), points - 2)
        ahead = at - j
    of = np.searchsorted(j, np.arange(max(points, 2)))
    x, y = np.ascontiguousarray(pattern[:, :2].T, np.float32)
    return Samples(x, y, ahead.astype(np.float32), of, (exposure_knots * time).astype(np.float32))


def may_show(patches: Patches, view: View, flown: Way) -> IntArray:
    """A quick look: which patches touch the cone around all that the camera sees; (k,)."""
    k = len(flown.p_WC) // 2
    axis, origin = flown.R_WC[k][:, 2], flown.p_WC[k]
    turned = np.arccos(np.clip(flown.R_WC[:, :, 2] @ axis, -1.0, 1.0)).max()
    half = np.arctan(np.hypot(*np.maximum(-view.low, view.high))) + turned
    to = patches.p_WP - origin
    distance = np.maximum(np.linalg.norm(to, axis=1), 1e-9)
    moved = np.linalg.norm(flown.p_WC - origin, axis=1).max()
    size = 0.5 * np.hypot(*patches.side.T) + moved
    wide = np.arcsin(np.minimum(size / distance, 1.0))
    angle = np.arccos(np.clip(to @ axis / distance, -1.0, 1.0))
    return np.flatnonzero((distance <= size) | (angle <= half + wide))


def _nearest(patches: Patches, rows: IntArray, flown: Way) -> float:
    """Least depth at which these patches' middles lie in mid-frame [m]."""
    k = len(flown.p_WC) // 2
    depth = (patches.p_WP[rows] - flown.p_WC[k]) @ flown.R_WC[k][:, 2]
    return float(np.min(depth[depth > _CLOSE], initial=_FAR))


def visible(patches: Patches, rows: IntArray, seen: Seen, view: View, flown: Way) -> Surfaces:
    """Those of the patches of these rows that can show at some time of the frame."""
    box, shows = _boxes(patches, rows, seen, view, flown)
    rows = rows[shows]
    return Surfaces(
        box[shows], _homographies(patches, rows, flown), patches.kind[rows], patches.count[rows],
        patches.first[rows], patches.cells, patches.outline[rows],
    )  # fmt: skip


def _boxes(
    patches: Patches, rows: IntArray, seen: Seen, view: View, flown: Way
) -> tuple[IntArray, BoolArray]:
    """x0 x1 y0 y1 [px] of all that patches can cover during the frame, (n, 4); which do, (n,).

    Looked for at the start and the end; in between the way is nearly straight.
    """
    R_PW, found = np.swapaxes(patches.R_WP[rows], -1, -2), []
    for k in sorted({0, len(flown.p_WC) - 1}):
        p_PC = np.einsum("nij,nj->ni", R_PW, flown.p_WC[k] - patches.p_WP[rows])
        R_PC = R_PW @ flown.R_WC[k]
        boxes = boxes_in_view(view.camera, (view.low, view.high), R_PC, p_PC, patches.side[rows])
        found.append(boxes)
    margin = int(np.ceil(shutter.wander_px(seen, flown)))
    low = np.min([boxes.px for boxes in found], axis=0) - margin
    high = np.max([boxes.px for boxes in found], axis=0) + margin
    width, height = view.camera.resolution
    box = np.where(_LOW, np.maximum(low, 0), np.minimum(high, [width, width, height, height]))
    return box.astype(np.int64), np.any([boxes.shows for boxes in found], axis=0)


def _homographies(patches: Patches, rows: IntArray, flown: Way) -> Array32:
    """Of each patch at each knot, with -p_z as a tenth number; (m, knots, 10)."""
    R_PW = np.swapaxes(patches.R_WP[rows], -1, -2)
    R_PC = R_PW[:, None] @ flown.R_WC
    away = flown.p_WC - patches.p_WP[rows][:, None]
    p_PC = np.einsum("nij,nkj->nki", R_PW, away)
    H = cells_from_rays(R_PC, p_PC, patches.side[rows][:, None], patches.count[rows][:, None])
    return np.concatenate([H.reshape(*H.shape[:2], 9), -p_PC[..., 2:]], axis=-1).astype(np.float32)


def _floor(
    scene: Scene, view: View, flown: Way, rows: Array, bare: Array32, blur: float, exposure_s: float
) -> Array32:
    """What the bare floor adds in grey levels; (h, w)."""
    grey = np.float32(scene.config.floor_grey)
    if scene.texture is None:
        return bare * grey
    moments = min(max(1, int(np.ceil(blur))), _MAX_MOMENTS)
    t = rows[:, None] + ((np.arange(moments) + 0.5) / moments - 0.5) * exposure_s
    R, p = flown.pose(t)
    poses = np.concatenate([R.reshape(*t.shape, 9), p], axis=-1).astype(np.float32)
    factor = np.ones_like(bare)
    floor_factor(view.rays, bare, poses, scene.texture.levels, factor)
    return bare * grey * factor


def _lighting(
    scene: Scene, view: View, flown: Way, rows: Array, exposure_s: float
) -> tuple[Array32, Array32] | None:
    """Factor on the light and what glare adds, (h, w) each; None where light is even."""
    light, glare, shadow = scene.config.light, scene.config.glare, scene.config.shadow
    if not (
        light.hot_spot_share or light.gradient_share or light.flicker_share
        or glare.peak_grey or shadow.darkness_share
    ):  # fmt: skip
        return None
    y, x = (np.append(np.arange(0, n - 1, _GRID), n - 1) for n in view.seen.shape)
    R, p = flown.pose(rows[y])
    X_W = _floor_places(view.rays[y[:, None, None], [0, 1], x[:, None]].astype(float), R, p)
    factor = scene.light_scale * even_light(light, scene.places, scene.lamps, X_W)
    added = np.zeros_like(factor)
    lit = np.ones((*factor.shape, len(scene.lamps)))
    if shadow.darkness_share > 0.0:
        lit -= shaded_share(shadow, scene.lamps, R, p, X_W)
        factor = factor * (1.0 - shadow.darkness_share * (1.0 - lit.mean(axis=-1)))
    if glare.peak_grey > 0.0:
        added = (glare_grey(glare, scene.lamps, p, X_W) * lit).sum(axis=-1)
    factor = factor * flicker(light, rows[y], exposure_s)[:, None]
    return _enlarged(factor, x, y), _enlarged(added, x, y)


def _floor_places(x_n: Array, R_WC: Array, p_WC: Array) -> Array:
    """Where rays x_n (h, w, 2) of rows at their poses (h, 3, 3), (h, 3) meet z = 0; (h, w, 3)."""
    ray_W = x_n @ np.swapaxes(R_WC[..., :2], 1, 2) + R_WC[:, None, :, 2]
    height = p_WC[:, None, 2]
    meets = ray_W[..., 2] * height < 0.0
    depth = np.where(meets, -height / np.where(meets, ray_W[..., 2], 1.0), _FAR)
    return np.asarray(p_WC[:, None] + np.minimum(depth, _FAR)[..., None] * ray_W)


def _enlarged(values: Array, x: Array, y: Array) -> Array32:
    """Values on the grid of columns x and rows y at every pixel, bilinearly."""
    at_x = np.interp(np.arange(x[-1] + 1), x, np.arange(len(x))).astype(np.float32)
    at_y = np.interp(np.arange(y[-1] + 1), y, np.arange(len(y))).astype(np.float32)
    map_x, map_y = np.broadcast_arrays(at_x, at_y[:, None])
    large = cv2.remap(
        values.astype(np.float32), np.ascontiguousarray(map_x), np.ascontiguousarray(map_y),
        cv2.INTER_LINEAR,
    )  # fmt: skip
    return np.asarray(large, dtype=np.float32)
