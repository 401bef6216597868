"""The flat things that a rendered scene is made of: tags, torn ones, and objects lying on them.

Every thing is a rectangle in a frame P (x right, y up, z out of its face) filled with cells of
codes, and may be cut to an outline: one side of a jagged tear, or a closed curve.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.render.cells_hit import BARE, BLACK, BLOB, CELLS, FIRST_OBJECT, KNOTS, TORN, WHITE, Codes
from tagvo.render.config import OccluderConfig
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.tag_map import TagMap

_SHADES = np.array([1.0, 0.75, 0.5])  # an object's three codes: top, bright and dark sides
_TEAR_AT = (0.0, 0.22)  # of the half side, from the middle: every family's border is cut
_TEAR_JAG, _TEAR_RIM = 0.05, 0.02  # of the half side: depth of the jags, width of the bare paper
_ABOVE_M = 2e-3  # of flat objects over the highest tag below them
_GREYS = (15.0, 235.0)
_TRIES = 40


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """m rectangles: R_WP (m, 3, 3), p_WP (m, 3) [m], side (m, 2) [m]; kind, count, first (m,);
    cells (k,) codes; outline (m, KNOTS + 5).

    outline of TORN: profile, then cos, sin and distance of the tear's line, width of its rim,
    bound of the profile; of BLOB: radii all around, then three unused, least and largest radius;
    all in half sides.
    """

    R_WP: Array
    p_WP: Array
    side: Array
    kind: IntArray
    count: IntArray
    first: IntArray
    cells: Codes
    outline: NDArray[np.float32]

    def only(self, mask: BoolArray) -> "Patches":
        """Those of a mask (m,); all cells are kept."""
        return replace(
            self, R_WP=self.R_WP[mask], p_WP=self.p_WP[mask], side=self.side[mask],
            kind=self.kind[mask], count=self.count[mask], first=self.first[mask],
            outline=self.outline[mask],
        )  # fmt: skip


def tag_patches(tag_map: TagMap, torn: BoolArray, rng: np.random.Generator) -> Patches:
    """The map's tags in the order of its rows; torn (n,): a part of these is ripped off."""
    n = len(tag_map)
    bitmaps = [tag_bitmap(tag_map.family, int(t), tag_map.border_bits) for t in tag_map.tag_id]
    codes = [np.where(cells > 0, WHITE, BLACK).astype(np.uint8).ravel() for cells in bitmaps]
    count = np.array([len(cells) for cells in bitmaps], dtype=np.int64)
    outline = np.zeros((n, KNOTS + 5), dtype=np.float32)
    for i in range(n):  # all are drawn, so that a tag tears alike whatever the share
        tear = _tear(rng)
        if torn[i]:
            outline[i] = tear
    return Patches(
        tag_map.R_WT, tag_map.p_WT, np.repeat(tag_map.total_size[:, None], 2, axis=1),
        np.where(torn, TORN, CELLS).astype(np.int64), count, np.cumsum(count**2) - count**2,
        np.concatenate([*codes, np.zeros(0, np.uint8)]), outline,
    )  # fmt: skip


def _tear(rng: np.random.Generator) -> Array:
    """Outline of a straight tear with jags, by halving and displacing its profile."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    profile = np.zeros(KNOTS + 1)
    step, jag = KNOTS, 1.0
    while step > 1:
        middle = np.arange(step // 2, KNOTS, step)
        mean = 0.5 * (profile[middle - step // 2] + profile[middle + step // 2])
        profile[middle] = mean + jag * rng.uniform(-1.0, 1.0, len(middle))
        step, jag = step // 2, 0.6 * jag
    profile *= _TEAR_JAG / max(np.abs(profile).max(), 1e-9)
    line = [np.cos(angle), np.sin(angle), rng.uniform(*_TEAR_AT), _TEAR_RIM, _TEAR_JAG]
    return np.concatenate([profile[:KNOTS], line])


def object_patches(
    config: OccluderConfig, ground: TagMap, rng: np.random.Generator
) -> tuple[list[Patches], Array]:
    """Objects on the ground's tags, and the greys (3 count,) of their codes.

    They lie within the rectangle of the tags and, as far as there is room, not on one another.
    """
    low, high = ground.corners_W.min(axis=(0, 1)), ground.corners_W.max(axis=(0, 1))
    size = config.size_m * rng.uniform(0.5, 1.5, (config.count, 2))
    greys = (rng.uniform(*_GREYS, config.count)[:, None] * _SHADES).ravel()
    taken: list[tuple[Array, float]] = []
    parts: list[Patches] = []
    for i in range(config.count):
        reach = 0.5 * float(np.hypot(*size[i]))
        spot = _free_spot(low, high, reach, taken, rng)
        taken.append((spot, reach))
        yaw = geo.exp(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
        base = np.array([*spot, _height_under(ground, spot, reach)])
        code = FIRST_OBJECT + 3 * i
        height = config.height_m * rng.uniform(0.7, 1.3)
        outline = _closed_curve(rng)
        if config.height_m > 0.0:
            parts.append(_box(base, yaw, np.array([*size[i], height]), code))
        else:
            base[2] += _ABOVE_M
            parts.append(_flat(base, yaw, size[i], code, outline))
    return parts, greys


def _free_spot(
    low: Array,
    high: Array,
    reach: float,
    taken: list[tuple[Array, float]],
    rng: np.random.Generator,
) -> Array:
    """A place (2,) uniform over the map that keeps off the others, if one is found."""
    spot = rng.uniform(low[:2], high[:2])
    for _ in range(_TRIES):
        if all(np.hypot(*(spot - other)) > reach + far for other, far in taken):
            break
        spot = rng.uniform(low[:2], high[:2])
    return spot


def _height_under(ground: TagMap, spot: Array, reach: float) -> float:
    """z of the highest tag within reach of a place; 0, the floor, where there is none."""
    centre, half = ground.p_WT[:, :2], 0.5 * ground.total_size * np.sqrt(2.0)
    near = np.hypot(*(centre - spot).T) < reach + half
    return float(np.max(ground.corners_W[near][..., 2], initial=0.0))


def _box(base: Array, R_WO: Array, size: Array, code: int) -> Patches:
    """Top and sides of a box that stands on `base`, x, y, z of O along its edges."""
    x, y, z = 0.5 * size
    up = R_WO[:, 2]
    top = [(R_WO, base + 2 * z * up, (2 * x, 2 * y), code)]
    sides = []
    for k, (out, wide) in enumerate(((x, 2 * y), (y, 2 * x), (x, 2 * y), (y, 2 * x))):
        normal = R_WO @ geo.exp(np.array([0.0, 0.0, 0.5 * np.pi * k]))[:, 0]
        R_WP = np.stack([np.cross(up, normal), up, normal], axis=1)
        sides.append((R_WP, base + out * normal + z * up, (wide, 2 * z), code + 1 + k % 2))
    R, p, side, codes = zip(*top, *sides, strict=True)
    n = len(codes)
    return Patches(
        np.array(R), np.array(p), np.array(side), np.full(n, CELLS), np.ones(n, dtype=np.int64),
        np.arange(n), np.array(codes, dtype=np.uint8), np.zeros((n, KNOTS + 5), np.float32),
    )  # fmt: skip


def _flat(base: Array, R_WO: Array, size: Array, code: int, outline: Array) -> Patches:
    """A flat thing of irregular outline that lies on `base`."""
    return Patches(
        R_WO[None], base[None], size[None], np.array([BLOB]), np.ones(1, dtype=np.int64),
        np.zeros(1, dtype=np.int64), np.array([code], np.uint8), outline[None].astype(np.float32),
    )  # fmt: skip


def _closed_curve(rng: np.random.Generator) -> Array:
    """Outline of a blob that fills about its rectangle: a circle with a few harmonics."""
    turn = np.linspace(0.0, 4.0, KNOTS)  # as `tagvo.trace` counts, along a square on its tip
    x, y = np.abs(turn - 2.0) - 1.0, 1.0 - np.abs(np.mod(turn + 1.0, 4.0) - 2.0)
    angle = np.arctan2(y, x)
    k = np.arange(2, 8)[:, None]
    amplitude = 0.25 * rng.standard_normal((len(k), 1)) / k
    waves = amplitude * np.cos(k * angle + rng.uniform(0.0, 2.0 * np.pi, (len(k), 1)))
    radius = np.maximum(1.0 + waves.sum(axis=0), 0.2)
    radius /= radius.max()
    return np.concatenate([radius, [0.0, 0.0, 0.0, radius.min(), radius.max()]])


def joined(parts: list[Patches]) -> Patches:
    """Patches one after the other, after one bare cell for rays that miss."""
    shift = np.cumsum([1, *(len(part.cells) for part in parts[:-1])])
    return Patches(
        R_WP=np.concatenate([part.R_WP for part in parts]),
        p_WP=np.concatenate([part.p_WP for part in parts]),
        side=np.concatenate([part.side for part in parts]),
        kind=np.concatenate([part.kind for part in parts]),
        count=np.concatenate([part.count for part in parts]),
        first=np.concatenate([part.first + s for part, s in zip(parts, shift, strict=True)]),
        cells=np.concatenate([np.array([BARE], np.uint8), *(part.cells for part in parts)]),
        outline=np.concatenate([part.outline for part in parts]),
    )
