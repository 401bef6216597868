"""Searches for the tile whose repetition shows a camera the most tags of use, by annealing.

For a level camera over an upright grid, whether a tag lies within a view is whether it does along
x and along y: counting tags is a product of small matrices, a thousand layouts a second. The view
is the largest upright rectangle of the camera's undistorted image, exact for a lens without
distortion; what comes out is judged by `tagvo.mapviews` through the camera as it is.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tagvo.camera.model import Camera
from tagvo.errors import MapError
from tagvo.geometry import Array, IntArray
from tagvo.maps.design.coverage import HEADINGS, MIN_PX, cell_middles, edge_rays, score
from tagvo.maps.design.tile import Square, filled, moved, repeated

Array32: TypeAlias = NDArray[np.float32]

_HOT, _COLD = 0.02, 1e-5  # bits: losses that are taken at the start and at the end
_TURNS = 0.1  # share of the moves that turn one of the tiles


@dataclass(frozen=True, slots=True)
class Grid:
    """Units across a map, their pitch [m], and of each class border, print [m] and side [units]."""

    shape: tuple[int, int]
    pitch: float
    border: tuple[float, ...]
    total: tuple[float, ...]
    side: tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What is seen from where: of each class (v, places along x, nx) and (v, ny, places along y).

    v runs over heights, then headings; an entry is 1 where a tag whose lower left unit lies there
    is within the view and large enough; `heights` counts them.
    """

    along_x: tuple[Array32, ...]
    along_y: tuple[Array32, ...]
    shape: tuple[int, int]
    heights: int


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The best tile: its larger squares, how its copies are turned, score at first and at last."""

    placed: list[Square]
    turns: IntArray
    first_score: float
    score: float


def sight_of(grid: Grid, camera: Camera, heights: Array, min_px: float = MIN_PX) -> Sight:
    """Tables of what a camera sees of a grid from places on it; heights (h,) [m]."""
    low, high = _view_rectangle(camera)
    focal = float(camera.intrinsics[:2].min())
    tables: tuple[list[Array32], list[Array32]] = ([], [])
    for border, total, side in zip(grid.border, grid.total, grid.side, strict=True):
        large = focal * border / heights >= min_px - 1e-9
        for axis in (0, 1):
            n = grid.shape[axis]
            begin = grid.pitch * np.arange(n) + 0.5 * (side * grid.pitch - total)
            eye = cell_middles(0.0, n * grid.pitch)
            seen = np.zeros((len(heights), len(HEADINGS), len(eye), n), dtype=np.float32)
            for k, (below, above) in enumerate(_across(low, high, axis)):
                near = eye[None, :, None] + heights[:, None, None] * below - 1e-9 <= begin
                far = begin + total <= eye[None, :, None] + heights[:, None, None] * above + 1e-9
                seen[:, k] = near & far & large[:, None, None]
            views = seen.reshape(-1, len(eye), n)
            tables[axis].append(views if axis == 0 else np.swapaxes(views, 1, 2).copy())
    return Sight(tuple(tables[0]), tuple(tables[1]), grid.shape, len(heights))


def _view_rectangle(camera: Camera) -> tuple[Array, Array]:
    """Ends (2,), (2,) of the largest rectangle of normalised coordinates within the image's edge.

    Of the edge's rays those of its left, right, top and bottom bound it, each where it comes in
    farthest. Raises MapError where the camera looks past its own axis.
    """
    rays = edge_rays(camera)
    steep = np.abs(rays[:, 0] * camera.resolution[1]) > np.abs(rays[:, 1] * camera.resolution[0])
    sides = [rays[steep, 0], rays[~steep, 1]]
    low = np.array([s[s < 0.0].max(initial=-np.inf) for s in sides])
    high = np.array([s[s > 0.0].min(initial=np.inf) for s in sides])
    if not np.isfinite([low, high]).all():
        raise MapError(f"{camera.source}: the optical axis lies outside the image")
    return low, high


def _across(low: Array, high: Array, axis: int) -> list[tuple[float, float]]:
    """Ends of the view along x or y of the map at each heading, at a height of 1 m.

    At heading 0 the image's x is the map's x and its y the map's -y; at 90 degrees its x is the
    map's y and its y the map's x.
    """
    x, down = (low[0], high[0]), (low[1], high[1])
    up = (-high[1], -low[1])
    return [x, down] if axis == 0 else [up, x]


def counts_of(sight: Sight, layout: IntArray) -> Array:
    """Tags of use in each view of a layout of rows x, y, side, class; (heights, views)."""
    total = np.zeros(1, dtype=np.float32)
    for kind, (along_x, along_y) in enumerate(zip(sight.along_x, sight.along_y, strict=True)):
        there = np.zeros(sight.shape, dtype=np.float32)
        rows = layout[layout[:, 3] == kind]
        there[rows[:, 0], rows[:, 1]] = 1.0
        total = np.asarray(total + (along_x @ there) @ along_y)
    return np.asarray(total, dtype=float).reshape(sight.heights, -1)


def anneal(
    sight: Sight,
    start: Sequence[Square],
    tile: tuple[int, int],
    repeats: tuple[int, int],
    steps: int,
    rng: np.random.Generator,
    step: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Found:
    """The best of `steps` neighbours of a start (simulated annealing on `mapviews.score`).

    A move puts one square elsewhere and what it hits where there is room, or turns one copy of the
    tile. `step` is called after each; where `stop` says so the search ends with what it has.
    Source: Kirkpatrick et al., Optimization by Simulated Annealing, Science 220 (1983).
    """
    fill = len(sight.along_x) - 1

    def worth(placed: Sequence[Square], turns: IntArray) -> float:
        return score(counts_of(sight, repeated(filled(placed, tile, fill), tile, turns)))

    placed, turns = list(start), rng.integers(4, size=repeats)
    now = worth(placed, turns)
    best = Found(placed, turns, now, now)
    for i in range(steps if placed or turns.size > 1 else 0):
        if stop():
            break
        step()
        hot = _COLD + _HOT * (1.0 - i / steps) ** 2
        other, turned = _neighbour(placed, turns, tile, rng)
        if other is None:
            continue
        then = worth(other, turned)
        if then >= now or rng.random() < np.exp((then - now) / hot):
            placed, turns, now = other, turned, then
            if now > best.score:
                best = Found(placed, turns, best.first_score, now)
    return best


def _neighbour(
    placed: list[Square], turns: IntArray, tile: tuple[int, int], rng: np.random.Generator
) -> tuple[list[Square] | None, IntArray]:
    if not placed or (turns.size > 1 and rng.random() < _TURNS):
        turned = turns.copy()
        turned.flat[rng.integers(turns.size)] = rng.integers(4)
        return placed, turned
    return moved(placed, tile, rng), turns
