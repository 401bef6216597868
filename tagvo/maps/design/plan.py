"""Designs floors of tags of several sizes: what is asked for, the tile that holds it, the map.

The unit of the grid is the smallest print and the white between tags; a larger tag takes as many
units as its print and that white need, for sizes that double 2, 4, 8. The white scales with it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from tagvo.camera.model import Camera
from tagvo.errors import MapError
from tagvo.geometry import Array
from tagvo.maps.design.coverage import MIN_PX
from tagvo.maps.design.paper_floor import floor_map
from tagvo.maps.design.search import Found, Grid, anneal, sight_of
from tagvo.maps.design.tile import Square, filled, packed, repeated
from tagvo.tags.families import FAMILIES, Family
from tagvo.tags.tag_map import TagMap

SIZES = (0.46, 0.23, 0.115, 0.0575)  # border sides, the paper's [m]
QUIET_ZONE = 0.0035  # white that has room for an id in print [m]
_SMALL_TILE = 0.01  # what a tile costs, a share of the area, for each square of the largest tag's
_TILES_TRIED = 20


@dataclass(frozen=True, slots=True)
class MapWish:
    """What a floor shall be: size along x and y of W, border sides and white between tags [m].

    shares: of the area by class, in the order of `sizes`, of any sum; tiles: how many along x and
    y, None: to be chosen.
    """

    size: tuple[float, float] = (3.0, 5.0)
    sizes: tuple[float, ...] = SIZES
    shares: tuple[float, ...] = (0.2, 0.2, 0.2, 0.4)
    family: Family = FAMILIES["tagStandard41h12"]
    quiet_zone: float = QUIET_ZONE
    first_id: int = 0
    tiles: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class Plan:
    """How a wish can be met: grid (classes from the largest), tile [units], repeats, counts a tile.

    `counts` leaves out the smallest class, which takes what is free.
    """

    grid: Grid
    tile: tuple[int, int]
    repeats: tuple[int, int]
    counts: tuple[int, ...]

    @property
    def smallest(self) -> int:
        """Tags of the smallest class in a tile."""
        taken = sum(n * s * s for n, s in zip(self.counts, self.grid.side[:-1], strict=True))
        return self.tile[0] * self.tile[1] - taken

    @property
    def tags(self) -> int:
        """Tags of the whole map."""
        return self.repeats[0] * self.repeats[1] * (sum(self.counts) + self.smallest)


def usual_shares(sizes: tuple[float, ...]) -> tuple[float, ...]:
    """Shares of the area (sum 1): the smallest size twice as much as each other one.

    From low down nothing else is seen whole, and each view wants one.
    """
    parts = [2.0 if s == min(sizes) else 1.0 for s in sizes]
    return tuple(p / sum(parts) for p in parts)


def plan_map(wish: MapWish, rng: np.random.Generator) -> tuple[Plan, list[Square]]:
    """The tile that meets a wish best and a first random placing of its larger tags.

    A tile costs the share of the map that it leaves bare, by how much of its area the classes miss
    their shares, and 1 % for each square of the largest tag that it measures, which keeps it small.
    Raises MapError where nothing fits or the family has too few ids; each says what would do.
    """
    units, pitch, shares = _units(wish)
    area = units.shape[0] * units.shape[1]
    about = sum(s * area / k**2 for s, k in zip(shares, units.side, strict=True))
    if about > 2 * wish.family.ids:  # far too many: no need to look for tiles
        _refuse_too_many(wish, round(about))
    plans = [p for p in _plans(wish, units, pitch, shares) if p[0] < np.inf]
    if not plans:
        raise MapError(
            f"map: no tile of {_metres(wish.sizes)} m with shares"
            f" {', '.join(f'{s:.3g}' for s in shares)} fits {wish.size[0]:g} x {wish.size[1]:g} m"
            f"{'' if wish.tiles is None else ' cut into the tiles asked for'}; a larger map, other"
            " shares or fewer sizes are needed"
        )
    plans.sort(key=lambda p: p[0])
    _refuse_too_many(wish, plans[0][1].tags)
    for _, plan in plans[:_TILES_TRIED]:
        squares = [
            (side, kind)
            for kind, (side, n) in enumerate(zip(plan.grid.side, plan.counts, strict=False))
            for _ in range(n)
        ]
        start = packed(squares, plan.tile, rng)
        if start is not None:
            _refuse_too_many(wish, plan.tags)
            return plan, start
    raise MapError(
        f"map: the shares {', '.join(f'{s:.3g}' for s in shares)} of {_metres(wish.sizes)} m leave"
        " no way to place the larger tags in one tile; a larger share for the smallest is needed"
    )


def _refuse_too_many(wish: MapWish, tags: int) -> None:
    family, left = wish.family, wish.family.ids - wish.first_id
    if tags > left:
        raise MapError(
            f"map: {tags} tags need as many ids from {wish.first_id} on; {family.name} has"
            f" {family.ids} (0 to {family.ids - 1}), {max(left, 0)} are left. A smaller map, larger"
            " tags or larger shares for them need fewer"
        )


def _metres(sizes: tuple[float, ...]) -> str:
    return ", ".join(f"{s:g}" for s in sizes)


def _units(wish: MapWish) -> tuple[Grid, float, tuple[float, ...]]:
    """The grid with classes from the largest on, its pitch [m], and their shares (sum 1)."""
    sizes, shares = wish.sizes, wish.shares
    if not sizes or not all(0.0 < s < np.inf for s in sizes) or len(set(sizes)) < len(sizes):
        raise MapError(f"map sizes: {_metres(sizes)}; different positive metres are needed")
    if len(shares) != len(sizes) or not all(0.0 < s < np.inf for s in shares):
        raise MapError(
            f"map shares: {', '.join(f'{s:g}' for s in shares)}; {len(sizes)} positive numbers are"
            f" needed, one for each of the sizes {_metres(sizes)} m"
        )
    if not all(0.0 < s < np.inf for s in wish.size) or not 0.0 <= wish.quiet_zone < np.inf:
        raise MapError(f"map: {wish.size[0]:g} x {wish.size[1]:g} m with {wish.quiet_zone:g} m"
                       " of white between tags; positive metres are needed")  # fmt: skip
    order = sorted(range(len(sizes)), key=lambda i: -sizes[i])
    border = tuple(sizes[i] for i in order)
    total = tuple(b * wish.family.total_per_border() for b in border)
    pitch = total[-1] + wish.quiet_zone
    side = tuple(int(np.ceil((t + wish.quiet_zone) / pitch - 1e-6)) for t in total)
    shape = tuple(int(np.floor(s / pitch + 1e-6)) for s in wish.size)
    if min(shape) < side[0]:
        raise MapError(
            f"map: a tag of {border[0]:g} m border is {total[0]:.4g} m printed and takes"
            f" {side[0] * pitch:.4g} m with its white; {wish.size[0]:g} x {wish.size[1]:g} m have"
            " no room for it"
        )
    grid = Grid((shape[0], shape[1]), pitch, border, total, side)
    return grid, pitch, tuple(shares[i] / sum(shares) for i in order)


def _plans(
    wish: MapWish, units: Grid, pitch: float, shares: tuple[float, ...]
) -> list[tuple[float, Plan]]:
    """Every way to cut the map into equal tiles, with what it costs (inf: it cannot be)."""
    largest = units.side[0]
    most = [n // largest for n in units.shape]
    ways = [wish.tiles] if wish.tiles else product(range(1, most[0] + 1), range(1, most[1] + 1))
    return [_plan(units, pitch, shares, (way[0], way[1])) for way in ways]


def _plan(
    units: Grid, pitch: float, shares: tuple[float, ...], repeats: tuple[int, int]
) -> tuple[float, Plan]:
    tile = (units.shape[0] // repeats[0], units.shape[1] // repeats[1])
    area = tile[0] * tile[1]
    squares = [s * s for s in units.side]
    counts = tuple(
        max(1, round(share * area / square))
        for share, square in zip(shares[:-1], squares, strict=False)
    )
    shape = (tile[0] * repeats[0], tile[1] * repeats[1])
    grid = Grid(shape, pitch, units.border, units.total, units.side)
    plan = Plan(grid, tile, repeats, counts)
    if min(tile) < units.side[0] or plan.smallest < 1:
        return np.inf, plan
    taken = np.array([*counts, plan.smallest]) * squares / area
    bare = 1.0 - shape[0] * shape[1] / (units.shape[0] * units.shape[1])
    missed = 0.5 * float(np.abs(taken - shares).sum())
    return bare + missed + _SMALL_TILE * area / squares[0], plan


def search_tile(
    plan: Plan,
    start: list[Square],
    camera: Camera,
    heights: Array,
    rng: np.random.Generator,
    *,
    steps: int,
    min_px: float = MIN_PX,
    step: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Found:
    """The best tile of a plan for a camera at heights (h,) [m]; the rest as `mapsearch.anneal`."""
    sight = sight_of(plan.grid, camera, heights, min_px)
    return anneal(sight, start, plan.tile, plan.repeats, steps, rng, step, stop)


def lay_out(wish: MapWish, plan: Plan, found: Found, rng: np.random.Generator) -> TagMap:
    """The map of a tile: W at a corner of the floor, the tags in its middle, largest ids first."""
    grid = plan.grid
    tile = filled(found.placed, plan.tile, len(grid.side) - 1)
    layout = repeated(tile, plan.tile, found.turns)
    layout = layout[np.lexsort((layout[:, 0], layout[:, 1], layout[:, 3]))]
    margin = 0.5 * (np.array(wish.size) - grid.pitch * np.array(grid.shape))
    centre = margin + grid.pitch * (layout[:, :2] + 0.5 * layout[:, 2:3])
    border = np.array(grid.border)[layout[:, 3]]
    return floor_map(wish.family, border, centre, rng, "map", wish.first_id)
