"""Outlines of a tag's black cells: whole areas to fill, so that no hairline parts their cells."""

from functools import lru_cache

import numpy as np

from tagvo.geometry import Array, BoolArray
from tagvo.tags.bitmaps import Cells, tag_bitmap
from tagvo.tags.families import Family

_RIGHT, _DOWN, _LEFT, _UP = (1, 0), (0, 1), (-1, 0), (0, -1)


@lru_cache(maxsize=4096)
def tag_outlines(family: Family, tag_id: int, border_bits: int = 1) -> tuple[Array, ...]:
    """Closed outlines of the black areas in T, the whole print being 1 wide; each (k, 2), y up."""
    cells = tag_bitmap(family, tag_id, border_bits)
    scale = np.array([1.0, -1.0]) / len(cells)
    return tuple((loop - 0.5 * len(cells)) * scale for loop in black_outlines(cells))


def black_outlines(cells: Cells) -> list[Array]:
    """Outlines around the black cells (0), in cells from the top left, y down; each (k, 2).

    The black lies to the right of the way round, so that holes run the other way; areas that touch
    at a corner alone stay apart. Only the vertices are listed, the first not again at the end.
    """
    ends = _edges(np.asarray(cells) == 0)
    loops = []
    while ends:
        at = start = next(iter(ends))
        heading = ends[start][0]
        loop: list[tuple[int, int]] = []
        while not loop or at != start:
            loop.append(at)
            ways = ends[at]
            heading = _turn(heading, ways)
            ways.remove(heading)
            if not ways:
                del ends[at]
            at = (at[0] + heading[0], at[1] + heading[1])
        loops.append(_corners(np.array(loop, dtype=float)))
    return loops


def _edges(black: BoolArray) -> dict[tuple[int, int], list[tuple[int, int]]]:
    """Directions of the unit edges that leave each point, black on their right (y down)."""
    padded = np.pad(black, 1)
    inside = padded[1:-1, 1:-1]
    sides = (
        (padded[:-2, 1:-1], (0, 0), _RIGHT),
        (padded[1:-1, 2:], (1, 0), _DOWN),
        (padded[2:, 1:-1], (1, 1), _LEFT),
        (padded[1:-1, :-2], (0, 1), _UP),
    )
    ends: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for beside, (dx, dy), way in sides:
        for y, x in np.argwhere(inside & ~beside).tolist():
            ends.setdefault((x + dx, y + dy), []).append(way)
    return ends


def _turn(heading: tuple[int, int], ways: list[tuple[int, int]]) -> tuple[int, int]:
    """The way on; of two the one to the right (y down), which stays with the area on that side."""
    right = (-heading[1], heading[0])
    return right if right in ways else ways[0]


def _corners(loop: Array) -> Array:
    """A loop without points between two edges of one direction."""
    before, after = loop - np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0) - loop
    return np.asarray(loop[before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]])
