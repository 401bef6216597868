"""Where printed maps are cut, against every other way to cut; outlines against their cells."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tagvo.errors import MapError
from tagvo.maps.printing.cutting import LONGEST, PAPERS, Paper, cut_lines, cut_plane, named_paper
from tagvo.maps.printing.outlines import black_outlines, tag_outlines
from tagvo.tags.families import FAMILIES

spans = st.lists(st.tuples(st.integers(0, 28), st.integers(1, 8)), min_size=1, max_size=8)


def crossed(line, squares):
    return sum(a < line - 1e-9 and b > line + 1e-9 for a, b in squares)


@given(spans, st.integers(9, 16))
def test_no_other_cuts_in_whole_mm_cross_fewer_tags(pairs, room):
    squares = np.array([[a, min(a + n, 30)] for a, n in pairs]) * 1e-3
    cuts = cut_lines(0.0, 0.030, room * 1e-3, squares)
    parts = len(cuts) - 1
    assert (np.diff(cuts) > 0.0).all()
    assert (np.diff(cuts) <= room * 1e-3 + 1e-9).all()
    assert parts == -(-30 // room)
    best = min(
        sum(crossed(1e-3 * line, squares) for line in lines)
        for lines in combinations(range(1, 30), parts - 1)
        if max(np.diff([0, *lines, 30])) <= room
    )
    assert sum(crossed(line, squares) for line in cuts[1:-1]) <= best


def test_cuts_run_through_the_middle_of_gaps():
    squares = np.array([[0.0, 0.1], [0.104, 0.2], [0.206, 0.3]])
    np.testing.assert_allclose(cut_lines(0.0, 0.3, 0.11, squares), [0, 0.102, 0.203, 0.3])


def test_a_length_that_leaves_no_choice_is_cut_evenly():
    cuts = cut_lines(0.05, 0.05 + 4 * 0.17777, 0.17777, np.array([[0.1, 0.5]]))
    np.testing.assert_allclose(np.diff(cuts), 0.17777, atol=1e-9)
    assert cut_lines(0.0, 0.1, 0.2, np.zeros((0, 2))).tolist() == [0.0, 0.1]


def squares_of(n=6, side=0.1, pitch=0.12):
    low = pitch * np.stack(np.meshgrid(np.arange(n), np.arange(n)), axis=-1).reshape(-1, 2)
    return np.stack([low, low + side], axis=1)


@pytest.mark.parametrize("name", PAPERS)
@pytest.mark.parametrize("turn", ["auto", "portrait", "landscape"])
def test_sheets_tile_the_plane_and_fit_the_paper(name, turn):
    squares = squares_of(17)
    low, high = squares.min(axis=(0, 1)), squares.max(axis=(0, 1))
    paper = Paper(name, *PAPERS[name], turn=turn)
    sheets = cut_plane(low, high, squares, paper).sheets
    area = sum(np.prod(s.high - s.low) for s in sheets)
    assert area == pytest.approx(np.prod(high - low))
    assert len({s.name for s in sheets}) == len(sheets)
    assert sheets[0].name == "A1"
    for s in sheets:
        assert sorted(s.paper) == sorted(PAPERS[name])
        assert turn == "auto" or (s.paper[0] > s.paper[1]) == (turn == "landscape")
        window_low, window_high = s.window
        assert (s.at - (s.low - window_low) >= 0.011 - 1e-9).all()  # margin and marks
        end = s.at + window_high - s.low
        assert (end <= np.array(s.paper) - 0.011 + 1e-9).all()


def test_auto_takes_no_more_sheets_than_either_way():
    squares = squares_of(9)
    low, high = squares.min(axis=(0, 1)), np.array([0.5, 1.06])
    count = {
        turn: len(cut_plane(low, high, squares, Paper("A3", *PAPERS["A3"], turn=turn)).sheets)
        for turn in ("auto", "portrait", "landscape")
    }
    assert count["auto"] == min(count.values())


def test_a_roll_is_as_long_as_is_needed_and_no_longer_than_a_pdf_may_be():
    squares = squares_of(60)
    low, high = squares.min(axis=(0, 1)), squares.max(axis=(0, 1))
    roll = Paper("roll", 0.914, LONGEST, roll=True)
    sheets = cut_plane(low, high, squares, roll).sheets
    assert max(max(s.paper) for s in sheets) <= LONGEST
    assert {min(s.paper) for s in sheets} == {0.914}
    few = cut_plane(low, np.array([0.7, 1.0]), squares, roll).sheets
    assert len(few) == 1
    assert few[0].paper == pytest.approx((0.914, 1.0 + 2 * 0.016 + 0.015))


def test_names_of_columns_go_on_after_z():
    squares = squares_of(2)
    sheets = cut_plane(
        np.zeros(2), np.array([8.0, 0.1]), squares, Paper("A4", *PAPERS["A4"])
    ).sheets
    assert [s.name for s in sheets][25:28] == ["Z1", "AA1", "AB1"]


def test_an_unknown_paper_is_named():
    assert named_paper("a3") == PAPERS["A3"]
    with pytest.raises(MapError, match="'B5'; choose one of A4"):
        named_paper("B5")


def winding(point, loops):
    """How often the loops run around a point, clockwise as the page is seen (y down)."""
    total = 0.0
    for loop in loops:
        d = loop - point
        angles = np.arctan2(d[:, 1], d[:, 0])
        steps = (np.roll(angles, -1) - angles + np.pi) % (2 * np.pi) - np.pi
        total += steps.sum() / (2 * np.pi)
    return round(float(total))


@given(arrays(np.uint8, (5, 6), elements=st.sampled_from([0, 255])))
def test_outlines_run_once_around_each_black_cell_and_around_no_white_one(cells):
    loops = black_outlines(cells)
    for row, column in np.ndindex(cells.shape):
        centre = np.array([column + 0.5, row + 0.5])
        assert winding(centre, loops) == (1 if cells[row, column] == 0 else 0)
    padded = np.pad(cells == 0, 1)
    edges = sum(int((np.diff(padded.astype(int), axis=axis) != 0).sum()) for axis in (0, 1))
    length = sum(np.abs(np.roll(loop, -1, axis=0) - loop).sum() for loop in loops)
    assert length == edges  # between black and white alone, never between two black cells
    for loop in loops:  # corners alone: no two edges in one direction, all of them upright or level
        step = np.roll(loop, -1, axis=0) - loop
        assert (np.count_nonzero(step, axis=1) == 1).all()
        assert ((step != 0) != (np.roll(step, 1, axis=0) != 0)).all()


def test_a_tags_outlines_fill_a_print_of_unit_width_upright():
    loops = tag_outlines(FAMILIES["tag36h11"], 0)
    points = np.concatenate(loops)
    np.testing.assert_allclose([points.min(), points.max()], [-0.4, 0.4])  # a white ring around
