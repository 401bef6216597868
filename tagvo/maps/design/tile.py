"""Places squares of several sizes in a tile of units, and repeats the tile turned and mirrored.

A layout is an array of rows x, y, side [units] and whatever else a row carries along; x, y is the
lower left unit. Mirroring moves places, never what lies in them.
"""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np

from tagvo.geometry import BoolArray, IntArray

Square: TypeAlias = tuple[int, int, int, int]  # x, y, side, class
_TRIES = 50  # random packings before the orderly one
_NEAR = 2  # units that a short move goes


def mirrored_within(
    layout: IntArray, tile: tuple[int, int], along_x: bool, along_y: bool
) -> IntArray:
    """A layout mirrored along the axes of its tile (both: turned by 180 degrees); (n, 3 or more)"""
    out = np.array(layout)
    if along_x:
        out[:, 0] = tile[0] - layout[:, 2] - layout[:, 0]
    if along_y:
        out[:, 1] = tile[1] - layout[:, 2] - layout[:, 1]
    return out


def repeated(layout: IntArray, tile: tuple[int, int], turns: IntArray) -> IntArray:
    """A tile side by side; turns (nx, ny): 0 as it is, 1 mirrored along x, 2 along y, 3 both."""
    copies = [
        mirrored_within(layout, tile, bool(turn & 1), bool(turn & 2))
        + np.array([i * tile[0], j * tile[1]] + [0] * (layout.shape[1] - 2))
        for (i, j), turn in np.ndenumerate(turns)
    ]
    return np.vstack(copies)


def filled(placed: Sequence[Square], tile: tuple[int, int], fill: int) -> IntArray:
    """A tile's layout with every free unit taken by a square of class `fill`; (n, 4)."""
    free = np.argwhere(_free(placed, tile))
    ones = np.ones(len(free), dtype=np.int64)
    rest = np.column_stack([free, ones, fill * ones])
    return np.vstack([np.array(placed, dtype=np.int64).reshape(-1, 4), rest])


def packed(
    squares: Sequence[tuple[int, int]], tile: tuple[int, int], rng: np.random.Generator
) -> list[Square] | None:
    """Squares (side, class) at random places of an empty tile; None where they do not fit."""
    for _ in range(_TRIES):
        placed = _packed_around([], squares, tile, rng)
        if placed is not None:
            return placed
    return _packed_around([], squares, tile, None)


def moved(
    placed: Sequence[Square], tile: tuple[int, int], rng: np.random.Generator
) -> list[Square] | None:
    """A neighbour of a placing: one square elsewhere, those it hits at random places; or None."""
    x, y, side, kind = placed[chosen := int(rng.integers(len(placed)))]
    high = (tile[0] - side, tile[1] - side)
    if rng.random() < 0.5:
        x, y = (int(rng.integers(top + 1)) for top in high)
    else:
        step = rng.integers(-_NEAR, _NEAR + 1, size=2)
        x, y = (int(np.clip(a + d, 0, top)) for a, d, top in zip((x, y), step, high, strict=True))
    others = [square for i, square in enumerate(placed) if i != chosen]
    hit = [s for s in others if abs(2 * (s[0] - x) + s[2] - side) < s[2] + side
           and abs(2 * (s[1] - y) + s[2] - side) < s[2] + side]  # fmt: skip
    kept = [s for s in others if s not in hit]
    return _packed_around([*kept, (x, y, side, kind)], [s[2:] for s in hit], tile, rng)


def _free(placed: Sequence[Square], tile: tuple[int, int]) -> BoolArray:
    free = np.ones(tile, dtype=bool)
    for x, y, side, _ in placed:
        free[x : x + side, y : y + side] = False
    return free


def _packed_around(
    placed: Sequence[Square],
    squares: Sequence[tuple[int, int]],
    tile: tuple[int, int],
    rng: np.random.Generator | None,
) -> list[Square] | None:
    """Squares put beside those placed, the largest first; without `rng` each at the first place."""
    free, out = _free(placed, tile), list(placed)
    for side, kind in sorted(squares, reverse=True):
        places = _places(free, side)
        if not len(places):
            return None
        x, y = places[0 if rng is None else int(rng.integers(len(places)))].tolist()
        free[x : x + side, y : y + side] = False
        out.append((x, y, side, kind))
    return out


def _places(free: BoolArray, side: int) -> IntArray:
    """Lower left units x, y at which a square of that side lies on free units alone; (k, 2)."""
    if side > min(free.shape):
        return np.zeros((0, 2), dtype=np.int64)
    total = np.pad(free.astype(np.int64).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    within = (
        total[side:, side:] - total[:-side, side:] - total[side:, :-side] + total[:-side, :-side]
    )
    return np.argwhere(within == side * side)
