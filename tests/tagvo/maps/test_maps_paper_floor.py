"""The arena's floor: as committed, without gaps or overlaps, each size where it belongs."""

from collections import Counter
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

from tagvo.maps.design.paper_floor import (
    ARENA_SIZE,
    arena_layout,
    arena_map,
    arena_yaml,
    mirrored,
    tile_layout,
)
from tagvo.tags.tag_map import load_map

ARENA = Path(__file__).parents[3] / "configs" / "maps" / "arena.yaml"


@pytest.fixture(scope="module")
def arena():
    return load_map(ARENA)


def test_the_committed_map_is_what_the_generator_makes():
    assert ARENA.read_text(encoding="utf-8") == arena_yaml()


def test_the_map_has_the_papers_sizes_and_ids(arena):
    assert arena.family.name == "tagStandard41h12"
    np.testing.assert_allclose(arena.classes, [0.0575, 0.115, 0.23, 0.46])
    np.testing.assert_allclose(arena.level, np.round(arena.level), atol=1e-9)
    assert Counter(arena.size.tolist()) == {0.46: 8, 0.23: 16, 0.115: 64, 0.0575: 320}
    assert len(set(arena.tag_id.tolist())) == len(arena)
    assert arena.tag_id.max() < 2115
    assert arena.gravity is not None
    assert arena.gravity.dir == (0.0, 0.0, -1.0)


def test_every_tag_lies_face_up_on_the_floor_within_the_arena(arena):
    np.testing.assert_allclose(arena.R_WT[:, :, 2], np.tile([0, 0, 1], (len(arena), 1)), atol=1e-9)
    assert (arena.p_WT[:, 2] == 0.0).all()
    half = arena.total_size[:, None] / 2
    assert (arena.p_WT[:, :2] - half >= 0.0).all()
    assert (arena.p_WT[:, :2] + half <= ARENA_SIZE).all()


def test_no_two_tags_overlap(arena):
    gap = np.abs(arena.p_WT[:, None, :2] - arena.p_WT[None, :, :2]).max(axis=-1)
    least = (arena.total_size[:, None] + arena.total_size[None]) / 2
    np.fill_diagonal(gap, np.inf)
    assert (gap > least - 1e-6).all()


def test_the_tiles_leave_no_gap():
    layout = arena_layout()
    covered = np.zeros((28, 48), dtype=int)
    for x, y, side in layout:
        covered[x : x + side, y : y + side] += 1
    assert (covered == 1).all()


def test_each_large_tag_of_a_tile_touches_other_sizes():
    layout = tile_layout()

    def neighbours(i):
        x, y, side = layout[i]
        gap_x = np.maximum(layout[:, 0] - x - side, x - layout[:, 0] - layout[:, 2])
        gap_y = np.maximum(layout[:, 1] - y - side, y - layout[:, 1] - layout[:, 2])
        beside = np.maximum(gap_x, gap_y) == 0
        return Counter(layout[beside & (np.arange(len(layout)) != i), 2].tolist())

    large = [neighbours(i) for i in np.flatnonzero(layout[:, 2] == 4)]
    assert all(len(seen) >= 3 for seen in large)
    assert all(a != b for a, b in pairwise(large))


def test_mirroring_twice_is_no_mirroring():
    for along_x, along_y in product([False, True], repeat=2):
        once = mirrored(tile_layout(), along_x, along_y)
        assert (once.min(axis=0) >= 0).all()
        np.testing.assert_array_equal(mirrored(once, along_x, along_y), tile_layout())


def test_the_seed_turns_the_tags_and_nothing_else():
    a, b, c = (arena_map(np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.R_WT, b.R_WT)
    assert (a.R_WT != c.R_WT).any()
    np.testing.assert_array_equal(a.p_WT, c.p_WT)
    turns = np.round(np.degrees(np.arctan2(a.R_WT[:, 1, 0], a.R_WT[:, 0, 0]))).astype(int) % 360
    assert set(turns.tolist()) == {0, 90, 180, 270}
