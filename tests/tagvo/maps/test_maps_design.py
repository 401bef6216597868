"""Designed floors: nothing overlaps, all is covered, ids suffice, the search finds better tiles."""

from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from simulated import arena, pinhole

from tagvo.errors import MapError
from tagvo.maps.check import check_map_data
from tagvo.maps.design.coverage import counts_in_view, heights_between, score
from tagvo.maps.design.plan import MapWish, lay_out, plan_map, search_tile, usual_shares
from tagvo.maps.design.tile import filled, mirrored_within, moved, packed, repeated
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import load_map, map_to_dict, save_map

HEIGHTS = heights_between(0.3, 2.5)


def designed(wish=None, seed=41, steps=0, **hooks):
    """A floor by a short search: plan, what was found, map."""
    wish, rng = wish or MapWish(), np.random.default_rng(seed)
    plan, start = plan_map(wish, rng)
    found = search_tile(plan, start, pinhole(), HEIGHTS, rng, steps=steps, **hooks)
    return plan, found, lay_out(wish, plan, found, rng)


@pytest.fixture(scope="module")
def floor():
    return designed(steps=600)


def test_the_default_floor_is_more_of_use_than_the_arena_by_a_short_search(floor):
    _, found, tag_map = floor
    counts = counts_in_view(tag_map, pinhole(), HEIGHTS)
    before = counts_in_view(arena(), pinhole(), HEIGHTS)
    assert score(counts) > score(before) + 0.4
    assert found.score > found.first_score + 0.1
    assert found.score == pytest.approx(score(counts), abs=0.02)  # the map's rim differs by 2 mm
    assert (np.percentile(counts, 5, axis=1) >= np.percentile(before, 5, axis=1)).all()


def test_every_unit_of_the_floor_is_covered_once(floor):
    plan, found, _ = floor
    layout = repeated(filled(found.placed, plan.tile, 3), plan.tile, found.turns)
    covered = np.zeros(plan.grid.shape, dtype=int)
    for x, y, side, kind in layout:
        assert side == plan.grid.side[kind]
        covered[x : x + side, y : y + side] += 1
    assert (covered == 1).all()
    assert len(layout) == plan.tags


def test_copies_of_the_tile_are_mirrored_or_turned_and_nothing_else(floor):
    plan, found, _ = floor
    tile = filled(found.placed, plan.tile, 3)
    layout = repeated(tile, plan.tile, found.turns)
    for (i, j), turn in np.ndenumerate(found.turns):
        low = np.array([i, j]) * plan.tile
        inside = ((layout[:, :2] >= low) & (layout[:, :2] < low + plan.tile)).all(axis=1)
        copy = layout[inside] - [*low, 0, 0]
        expected = mirrored_within(tile, plan.tile, bool(turn & 1), bool(turn & 2))
        assert sorted(map(tuple, copy.tolist())) == sorted(map(tuple, expected.tolist()))


def test_the_map_is_a_floor_without_a_fault(floor, tmp_path):
    plan, _, tag_map = floor
    assert check_map_data(map_to_dict(tag_map), "map") == []
    np.testing.assert_array_equal(tag_map.tag_id, np.arange(plan.tags))
    assert (np.diff(tag_map.size) <= 0).all()
    assert (tag_map.p_WT[:, 2] == 0.0).all()
    np.testing.assert_allclose(tag_map.R_WT[:, 2, 2], 1.0, atol=1e-9)
    assert tag_map.gravity is not None
    assert tag_map.gravity.dir == (0.0, 0.0, -1.0)
    half = 0.5 * tag_map.total_size[:, None]
    assert (tag_map.p_WT[:, :2] - half >= 0.0).all()
    assert (tag_map.p_WT[:, :2] + half <= (3.0, 5.0)).all()
    save_map(tag_map, tmp_path / "m.yaml")
    np.testing.assert_allclose(load_map(tmp_path / "m.yaml").p_WT, tag_map.p_WT, atol=1e-9)


@pytest.mark.parametrize("white", [0.0, 0.0035, 0.02])
def test_white_between_prints_is_at_least_what_was_asked(white):
    _, _, tag_map = designed(MapWish(size=(2.0, 2.5), quiet_zone=white))
    gap = np.abs(tag_map.p_WT[:, None, :2] - tag_map.p_WT[None, :, :2]).max(axis=-1)
    gap -= 0.5 * (tag_map.total_size[:, None] + tag_map.total_size[None])
    np.fill_diagonal(gap, np.inf)
    assert gap.min() == pytest.approx(white, abs=1e-6)


def test_sizes_that_do_not_double_take_whole_units():
    wish = MapWish(size=(2.0, 2.0), sizes=(0.05, 0.17, 0.08), shares=(2, 1, 1), quiet_zone=0.004)
    plan, _, tag_map = designed(wish)
    assert plan.grid.border == (0.17, 0.08, 0.05)
    assert plan.grid.side == (4, 2, 1)  # 0.31 / 0.094, 0.148 / 0.094, both rounded up
    assert check_map_data(map_to_dict(tag_map), "map") == []


def test_one_size_alone_is_a_plain_grid():
    _, found, tag_map = designed(
        MapWish(size=(1.0, 1.0), sizes=(0.1,), shares=(1.0,), quiet_zone=0.02), steps=20
    )
    assert set(tag_map.size.tolist()) == {0.1}
    assert len(tag_map) == 25  # 1 m / 0.2 m
    assert found.score >= found.first_score


@pytest.mark.parametrize(
    "family", [f for f in FAMILIES.values() if f.ids >= 30], ids=lambda f: f.name
)
def test_any_family_is_laid_by_its_own_print(family):
    wish = MapWish((0.9, 0.9), (0.2, 0.1), (1, 1), family, 0.01)
    plan, _, tag_map = designed(wish)
    assert plan.grid.total[0] == pytest.approx(0.2 * family.total_per_border())
    assert check_map_data(map_to_dict(tag_map), "map") == []


def test_classes_come_near_their_shares():
    wish = MapWish(shares=(1, 2, 3, 4))
    plan, _, _ = designed(wish)
    area = np.array([*plan.counts, plan.smallest]) * np.square(plan.grid.side)
    np.testing.assert_allclose(area / area.sum(), [0.1, 0.2, 0.3, 0.4], atol=0.06)


def test_tiles_are_cut_as_asked():
    plan, _, _ = designed(MapWish(tiles=(1, 3)))
    assert plan.repeats == (1, 3)
    assert plan.tile == (28, 15)


def test_the_same_seed_gives_the_same_map_and_another_another():
    a, b, c = (designed(seed=s, steps=30)[2] for s in (1, 1, 2))
    np.testing.assert_array_equal(a.p_WT, b.p_WT)
    np.testing.assert_array_equal(a.R_WT, b.R_WT)
    assert (a.p_WT != c.p_WT).any()


def test_the_search_can_be_stopped_and_keeps_the_best():
    calls = []
    plan, found, _ = designed(
        steps=500, step=lambda: calls.append(1), stop=lambda: len(calls) >= 40
    )
    assert len(calls) == 40
    assert found.score >= found.first_score
    assert len(found.placed) == sum(plan.counts)


def test_moves_keep_the_squares_and_never_overlap():
    rng, tile = np.random.default_rng(2), (12, 11)
    squares = [(4, 0)] * 2 + [(2, 1)] * 7
    placed = packed(squares, tile, rng)
    assert placed is not None
    changed = 0
    for _ in range(300):
        other = moved(placed, tile, rng)
        if other is None:
            continue
        covered = np.zeros(tile, dtype=int)
        for x, y, side, _ in other:
            assert min(x, y) >= 0
            assert x + side <= tile[0]
            assert y + side <= tile[1]
            covered[x : x + side, y : y + side] += 1
        assert covered.max() == 1
        assert Counter(s[2:] for s in other) == Counter(squares)
        changed += sorted(other) != sorted(placed)
        placed = other
    assert changed > 100


def test_a_full_tile_is_packed_in_order_where_chance_fails():
    rng = np.random.default_rng(0)
    placed = packed([(4, 0)] * 6, (12, 8), rng)
    assert placed is not None
    assert len(placed) == 6
    assert packed([(4, 0)] * 7, (12, 8), rng) is None


def test_mirroring_twice_is_no_mirroring():
    rng = np.random.default_rng(4)
    layout = filled(packed([(3, 0), (2, 1)], (7, 6), rng), (7, 6), 2)
    for along_x, along_y in product([False, True], repeat=2):
        once = mirrored_within(layout, (7, 6), along_x, along_y)
        np.testing.assert_array_equal(mirrored_within(once, (7, 6), along_x, along_y), layout)


REFUSED = {  # what is asked -> words of the error
    "ids run out": (
        {"family": FAMILIES["tag36h11"]}, ["1199 tags", "tag36h11 has 587", "smaller map"]),
    "few ids left": ({"first_id": 2000}, ["604 tags", "from 2000", "2115", "115 are left"]),
    "a hangar": ({"size": (1e6, 1e6)}, ["tagStandard41h12 has 2115"]),
    "no room": ({"size": (0.5, 3.0)}, ["0.46 m", "0.828 m printed", "0.5 x 3 m"]),
    "no tile": ({"size": (0.9, 0.9)}, ["no tile", "0.9 x 0.9 m", "fewer sizes"]),
    "tiles too small": ({"tiles": (9, 9)}, ["no tile", "tiles asked for"]),
    "nothing for the smallest": (
        {"shares": (0.9, 0.05, 0.03, 0.02)}, ["larger share for the smallest"]),
    "one size twice": ({"sizes": (0.2, 0.1, 0.1, 0.05)}, ["0.2, 0.1, 0.1, 0.05", "different"]),
    "no size": ({"sizes": (0.2, 0.1, 0.1, -0.05)}, ["-0.05", "positive"]),
    "shares of other sizes": ({"shares": (1.0, 2.0)}, ["1, 2", "4 positive numbers"]),
    "share of nothing": ({"shares": (1.0, 1.0, 0.0, 1.0)}, ["0", "positive"]),
    "no number": ({"size": (float("nan"), 5.0)}, ["nan", "positive metres"]),
    "negative white": ({"quiet_zone": -0.01}, ["-0.01", "positive"]),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_with_words(case):
    asked, words = REFUSED[case]
    with pytest.raises(MapError) as refused:
        plan_map(MapWish(**asked), np.random.default_rng(0))
    for word in words:
        assert word in str(refused.value)


def test_the_smallest_size_gets_twice_the_share():
    assert usual_shares((0.46, 0.23, 0.115, 0.0575)) == MapWish().shares
    assert usual_shares((0.1, 0.3)) == pytest.approx((2 / 3, 1 / 3))


def test_the_arena_stays_as_it_was_published():
    committed = Path(__file__).parents[3] / "configs/maps/arena.yaml"
    text = committed.read_text(encoding="utf-8")
    assert text.count("\n") == 418
    from tagvo.maps.design.paper_floor import arena_yaml

    assert arena_yaml() == text
