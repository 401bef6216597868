"""Lays out floor maps: the paper's four sizes packed without gaps in one tile, repeated.

A tile is a grid of square units, each as wide as the smallest printed tag; larger tags take 2, 4
or 8 units a side, and what they leave is filled with the smallest. Mirroring moves the places of
the tags, never the tags themselves.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray
from tagvo.maps.design.tile import mirrored_within
from tagvo.tags.families import FAMILIES, Family
from tagvo.tags.tag_map import TagMap, map_from_dict, map_to_yaml
from tagvo.textfile import write_atomic

ARENA_SEED = 41
ARENA_SIZE = (3.0, 5.0)  # [m] along x and y of W
_FAMILY = FAMILIES["tagStandard41h12"]
_SMALLEST = 0.0575  # border side of class S [m]
_REPEATS = (2, 4)  # tiles along x and y
_TILE = (14, 12)  # units along x and y
_PLACED = np.array(  # x, y of the lower left unit, units a side
    [
        *[(0, 0, 8)],  # XL
        *[(8, 0, 4), (3, 8, 4)],  # L: one beside the XL and S, one below M and S
        *[(12, 0, 2), (8, 4, 2), (12, 4, 2), (10, 6, 2)],  # M
        *[(7, 8, 2), (12, 8, 2), (1, 10, 2), (10, 10, 2)],
    ]
)


def tile_layout() -> IntArray:
    """Lower left unit x, y and units a side of each tag of one tile; (n, 3)."""
    free = np.ones(_TILE, dtype=bool)
    for x, y, side in _PLACED:
        free[x : x + side, y : y + side] = False
    smallest = np.argwhere(free)
    return np.vstack([_PLACED, np.column_stack([smallest, np.ones(len(smallest), dtype=int)])])


def mirrored(layout: IntArray, along_x: bool, along_y: bool) -> IntArray:
    """The tile's places mirrored along its axes (both: turned by 180 degrees); (n, 3)."""
    return mirrored_within(layout, _TILE, along_x, along_y)


def arena_layout() -> IntArray:
    """The tile repeated over the arena, each row and column mirrored to its last; (n, 3)."""
    tile = tile_layout()
    places = [
        mirrored(tile, j % 2 == 1, i % 2 == 1) + np.array([i * _TILE[0], j * _TILE[1], 0])
        for i in range(_REPEATS[0])
        for j in range(_REPEATS[1])
    ]
    layout = np.vstack(places)
    return np.asarray(layout[np.lexsort((layout[:, 0], layout[:, 1], -layout[:, 2]))])


def arena_map(rng: np.random.Generator) -> TagMap:
    """The paper's floor of 3 m x 5 m, tags facing up, W at its corner; `rng` turns each tag.

    Ids run from the largest tags to the smallest; each tag is turned by a multiple of 90 degrees.
    """
    unit = _SMALLEST * _FAMILY.total_per_border()
    layout = arena_layout()
    margin = (np.array(ARENA_SIZE) - unit * np.array(_TILE) * _REPEATS) / 2
    centre = margin + unit * (layout[:, :2] + layout[:, 2:] / 2)
    return floor_map(_FAMILY, np.asarray(_SMALLEST * layout[:, 2]), centre, rng, "arena")


def floor_map(
    family: Family,
    border: Array,
    centre: Array,
    rng: np.random.Generator,
    where: str,
    first_id: int = 0,
) -> TagMap:
    """A level floor of tags that face up, z = 0, each turned by `rng` by a multiple of 90 degrees.

    border (n,) border sides [m]; centre (n, 2) in W [m]; ids in that order from `first_id` on;
    laying sigmas are the defaults, gravity is -z. `where` names the map in errors.
    """
    yaw = np.pi / 2 * rng.integers(4, size=len(border))
    q_WT = geo.quat_from_matrix(geo.matrix_from_rpy(0.0, 0.0, yaw))
    tags: list[dict[str, Any]] = [
        {
            "id": first_id + i,
            "size": round(float(border[i]), 9),
            "p": [*np.round(centre[i], 9).tolist(), 0.0],
            "q": q_WT[i].tolist(),
        }
        for i in range(len(border))
    ]
    gravity = {"dir": [0, 0, -1], "sigma_deg": 1}
    return map_from_dict({"family": family.name, "gravity": gravity, "tags": tags}, where)


def arena_yaml(seed: int = ARENA_SEED) -> str:
    """Text of `configs/maps/arena.yaml`."""
    head = (
        "# The floor of the paper's arena, 3 m x 5 m: x, y along the floor, z up, W at a corner.\n"
        "# tagStandard41h12, border sides 0.46, 0.23, 0.115 and 0.0575 m, printed without gaps.\n"
        "# Made by: python -m tagvo.maps.design.paper_floor configs/maps/arena.yaml\n"
    )
    return head + map_to_yaml(arena_map(np.random.default_rng(seed)))


if __name__ == "__main__":
    write_atomic(Path(sys.argv[1]), arena_yaml())
