"""Tags of use in view: against brute force, the search's matrices, and what a detector finds."""

import numpy as np
import pytest
from simulated import DOWN, corners_seen, pinhole

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.detect.apriltag import AprilTagDetector
from tagvo.errors import MapError
from tagvo.maps.design.coverage import (
    HEADINGS,
    MIN_PX,
    by_height,
    cell_middles,
    counts_in_view,
    heights_between,
    score,
    worth_in_tags,
)
from tagvo.maps.design.plan import MapWish, lay_out, plan_map
from tagvo.maps.design.search import Found, counts_of, sight_of
from tagvo.maps.design.tile import filled, repeated
from tagvo.render.view import render_view
from tagvo.tags.tag_map import map_from_dict

HEIGHTS = np.array([0.3, 0.55, 1.2, 2.5])


def design(seed=3, **wish):
    """A small floor by chance: its plan, tile and map."""
    rng = np.random.default_rng(seed)
    wanted = MapWish(**{"size": (1.5, 2.0), **wish})
    plan, placed = plan_map(wanted, rng)
    turns = rng.integers(4, size=plan.repeats)
    return plan, placed, turns, lay_out(wanted, plan, Found(placed, turns, 0.0, 0.0), rng)


def places_of(tag_map):
    """Where the views are taken from, by the printed outline of an upright map."""
    half = 0.5 * tag_map.total_size[:, None]
    low = (tag_map.p_WT[:, :2] - half).min(axis=0)
    high = (tag_map.p_WT[:, :2] + half).max(axis=0)
    return [cell_middles(*ends) for ends in zip(low, high, strict=True)]


def brute_force(tag_map, camera, height, surface=None):
    """Counts of one height, a view at a time, by the projection that other tests rest on."""
    out = []
    xs, ys = places_of(surface or tag_map)
    for x in xs:
        for y in ys:
            for heading in HEADINGS:
                R_WC = geo.exp(np.array([0.0, 0.0, heading])) @ DOWN
                rows, pixels = corners_seen(tag_map, camera, R_WC, np.array([x, y, height]))
                sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=-1).min(axis=1)
                out.append(int((sides[rows] >= MIN_PX).sum()))
    return out


@pytest.mark.parametrize(
    "camera",
    [
        pinhole(),
        pinhole(f=300.0, width=400, height=300),
        Camera("radtan", np.array([500.0, 510, 300, 260]), np.array([-0.3, 0.1, 0.001, -0.002]),
               (640, 480)),
        Camera("equidistant", np.array([280.0, 281, 330, 230]), np.array([0.01, -0.01, 0, 0]),
               (640, 480)),
    ],
    ids=["pinhole", "wide", "radtan", "fisheye"],
)  # fmt: skip
def test_counts_are_those_of_brute_force(camera):
    _, _, _, tag_map = design(size=(1.0, 1.2), sizes=(0.23, 0.115, 0.0575), shares=(1, 1, 2))
    counts = counts_in_view(tag_map, camera, np.array([0.4, 1.1]))
    for height, row in zip((0.4, 1.1), counts, strict=True):
        assert row.tolist() == brute_force(tag_map, camera, height)
    assert counts.max() > 5


def test_tags_of_other_surfaces_and_tilted_ones_are_counted_as_they_are_seen():
    tags = [{"id": i, "size": 0.1, "p": [0.25 * i, 0.0, 0.0], "q": [1, 0, 0, 0]} for i in range(4)]
    wall = geo.quat_from_matrix(geo.matrix_from_rpy(0.0, 0.5 * np.pi, 0.0)).tolist()
    tags += [
        {"id": 4, "size": 0.1, "p": [0.4, 0.3, 0.02], "q": [0.9800666, 0.1986693, 0, 0]},
        {"id": 5, "size": 0.1, "p": [-0.3, 0.0, 0.3], "q": wall},
        {"id": 6, "size": 0.1, "p": [0.1, 0.3, 0.0], "q": [0, 1, 0, 0]},  # face down
    ]
    tag_map = map_from_dict({"family": "tagStandard41h12", "tags": tags}, "mixed")
    floor = tag_map.only(np.arange(4))
    counts = counts_in_view(tag_map, pinhole(), np.array([0.9]))[0]
    assert counts.tolist() == brute_force(tag_map, pinhole(), 0.9, floor)
    assert (counts > counts_in_view(floor, pinhole(), np.array([0.9]))[0]).any()  # the tilted one


def in_the_order_of_the_matrices(counts, shape):
    """Counts by place, then heading, as by heading, then place."""
    return counts.reshape(len(counts), *shape, len(HEADINGS)).transpose(0, 3, 1, 2)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_searchs_matrices_count_as_the_projection_does(seed):
    plan, placed, turns, tag_map = design(seed, quiet_zone=0.0)
    tile = filled(placed, plan.tile, len(plan.grid.side) - 1)
    sight = sight_of(plan.grid, pinhole(), HEIGHTS)
    fast = counts_of(sight, repeated(tile, plan.tile, turns))
    slow = counts_in_view(tag_map, pinhole(), HEIGHTS)
    shape = [len(middles) for middles in places_of(tag_map)]
    slow = in_the_order_of_the_matrices(slow, shape).reshape(len(HEIGHTS), -1)
    np.testing.assert_array_equal(fast, slow)
    assert fast.max() > 20


def test_the_searchs_view_lies_within_that_of_a_lens_that_distorts():
    plan, placed, turns, tag_map = design(5, quiet_zone=0.0)
    camera = Camera("radtan", pinhole().intrinsics, np.array([-0.2, 0.05, 0, 0]), (640, 480))
    tile = filled(placed, plan.tile, len(plan.grid.side) - 1)
    fast = counts_of(sight_of(plan.grid, camera, HEIGHTS), repeated(tile, plan.tile, turns))
    shape = [len(middles) for middles in places_of(tag_map)]
    exact = counts_in_view(tag_map, camera, HEIGHTS)
    exact = in_the_order_of_the_matrices(exact, shape).reshape(len(HEIGHTS), -1)
    near = HEIGHTS < 1.0  # farther off the smallest tags come near min_px, which distorts as well
    assert (fast[near] <= exact[near]).all()
    assert fast[near].sum() > 0.7 * exact[near].sum()


def test_a_detector_finds_the_tags_of_use():
    _, _, _, tag_map = design(7, size=(2.0, 2.0))
    camera, rng = pinhole(), np.random.default_rng(1)
    detector = AprilTagDetector(tag_map.family)
    useful = found = 0
    for height in (0.4, 0.8, 1.5, 2.4):
        R_WC = geo.exp(np.array([0.0, 0.0, rng.choice(HEADINGS)])) @ DOWN
        p_WC = np.array([*rng.uniform(0.6, 1.4, 2), height])
        rows, pixels = corners_seen(tag_map, camera, R_WC, p_WC)
        sides = np.linalg.norm(pixels - np.roll(pixels, 1, axis=1), axis=-1).min(axis=1)
        wanted = set(tag_map.tag_id[rows[sides[rows] >= MIN_PX]].tolist())
        image = render_view(tag_map, camera, R_WC, p_WC, noise_sigma=3.0, rng=rng)
        useful, found = (
            useful + len(wanted),
            found + len(wanted & set(detector.detect(image).tag_id.tolist())),
        )
    assert useful > 50
    assert found >= 0.98 * useful


def test_score_is_the_mean_over_heights_of_the_poorest_fifth():
    rng = np.random.default_rng(0)
    counts = rng.integers(0, 30, size=(5, 40))
    by_hand = [np.mean(sorted(np.log2(1 + row))[:8]) for row in counts]
    assert score(counts) == pytest.approx(np.mean(by_hand))
    assert score(np.full((3, 7), 6)) == pytest.approx(np.log2(7.0))
    assert worth_in_tags(score(np.full((3, 7), 6))) == pytest.approx(6.0)


def test_plenty_elsewhere_does_not_make_up_for_a_place_that_starves():
    even, starved = np.full((1, 10), 5), np.array([[0, 0] + [50] * 8])
    assert score(starved) < score(even)
    assert score(np.array([[1, 1] + [50] * 8])) > score(starved)


def test_by_height_says_median_low_quantile_and_blind_share():
    counts = np.array([np.arange(100), np.zeros(100)], dtype=np.int64)
    first, second = by_height(np.array([0.5, 1.0]), counts)
    assert (first.height, first.median, first.p5, first.blind) == (0.5, 49.5, 4.0, 0.01)
    assert (second.median, second.p5, second.blind) == (0.0, 0.0, 1.0)


def test_heights_are_evenly_spread_and_one_is_one():
    np.testing.assert_allclose(heights_between(0.3, 2.5), 0.3 + 0.2 * np.arange(12))
    assert heights_between(1.0, 1.0).tolist() == [1.0]


def test_a_camera_that_looks_past_its_axis_is_refused():
    plan, *_ = design()
    camera = Camera("none", np.array([530.0, 530, 900, 240]), np.zeros(0), (640, 480))
    with pytest.raises(MapError, match="optical axis"):
        sight_of(plan.grid, camera, HEIGHTS)
