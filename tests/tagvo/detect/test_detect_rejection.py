"""Each filter alone, and the function that applies them all and counts by cause."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from pydantic import ValidationError

from tagvo.config import FilterConfig
from tagvo.detect import rejection
from tagvo.detect.rejection import filter_detections
from tagvo.records import Detections
from tagvo.tags.tag_map import map_from_dict

SQUARE = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])  # clockwise, y down
SIZE = (640, 480)
CAUSES = {
    "not_on_map",
    "hamming",
    "low_margin",
    "not_finite",
    "not_convex",
    "too_small",
    "at_edge",
    "duplicate",
}


def tag_map(ids=range(20)):
    tags = [{"id": i, "size": 0.1, "p": [float(i), 0.0, 0.0], "q": [1, 0, 0, 0]} for i in ids]
    return map_from_dict({"family": "tag36h11", "tags": tags}, "test")


def detections(quads, ids=None, **fields):
    quads = np.asarray(quads, dtype=float).reshape(-1, 4, 2)
    return Detections.of(np.arange(len(quads)) if ids is None else np.array(ids), quads, **fields)


def run(det, limits=None, ids=range(20)):
    return filter_detections(det, tag_map(ids), limits or FilterConfig(), SIZE)


def test_a_good_tag_passes_and_finds_its_row():
    kept, rows, counts = run(detections([SQUARE + 100, SQUARE + 200], ids=[7, 5]), ids=[5, 6, 7])
    assert_array_equal(kept.tag_id, [7, 5])
    assert_array_equal(rows, [2, 0])
    assert counts == dict.fromkeys(CAUSES, 0)


nan_corner = SQUARE + 100.0
nan_corner = np.where(np.arange(4)[:, None] == 2, np.nan, nan_corner)


@pytest.mark.parametrize(
    ("cause", "det", "limits"),
    [
        ("not_on_map", detections([SQUARE + 100], ids=[99]), {}),
        ("hamming", detections([SQUARE + 100], hamming=np.array([2])), {}),
        ("low_margin", detections([SQUARE + 100], margin=np.array([9.0])), {"min_margin": 10}),
        ("not_finite", detections([nan_corner]), {}),
        ("not_finite", detections([SQUARE + np.inf]), {}),
        ("not_convex", detections([SQUARE[::-1] + 100]), {}),
        ("not_convex", detections([SQUARE[[0, 2, 1, 3]] + 100]), {}),
        ("not_convex", detections([np.array([[0, 0], [20, 0], [5, 5], [0, 20]]) + 100]), {}),
        ("not_convex", detections([np.zeros((4, 2)) + 100]), {}),
        ("not_convex", detections([SQUARE * [1, 0] + 100]), {}),
        ("too_small", detections([SQUARE * 0.25 + 100]), {}),
        ("too_small", detections([SQUARE * [1, 0.25] + 100]), {}),
        ("at_edge", detections([SQUARE + np.array([5.0, 100.0])]), {}),
        ("at_edge", detections([SQUARE + np.array([100.0, 455.0])]), {}),
        ("at_edge", detections([SQUARE + np.array([-3.0, 100.0])]), {}),
    ],
)
def test_each_cause_is_told(cause, det, limits):
    kept, rows, counts = run(det, FilterConfig(**limits))
    assert len(kept) == len(rows) == 0
    assert counts == dict.fromkeys(CAUSES, 0) | {cause: 1}


def test_unknown_margins_pass():
    limits = FilterConfig(min_margin=10.0)
    assert len(run(detections([SQUARE + 100]), limits)[0]) == 1  # NaN: the source has none


def test_the_edge_is_half_a_pixel_outside_the_outermost_centres():
    def kept(quad):
        return len(run(detections(quad), FilterConfig(edge_px=0.0))[0])

    quad = SQUARE[None] - 0.5  # two corners on the rim itself
    assert kept(quad) == 1
    assert kept(quad - np.array([0.01, 0.0])) == 0
    right = SQUARE[None] + [639.5 - 20.0, 100.0]
    assert kept(right) == 1
    assert kept(right + np.array([0.01, 0.0])) == 0
    assert len(run(detections(SQUARE[None] - 10), FilterConfig(edge_px=-100.0))[0]) == 1


def test_agreeing_duplicates_keep_the_best():
    quads = SQUARE + 100.0 + np.array([0.0, 0.5, 1.0, 0.2])[:, None, None]
    det = detections(
        quads,
        ids=[3, 3, 3, 4],
        hamming=np.array([1, 0, 0, 0]),
        margin=np.array([90.0, 20.0, 50.0, 10.0]),
    )
    assert_array_equal(rejection.unambiguous(det, 2.0), [False, False, True, True])
    unknown = detections(quads[:2], ids=[3, 3], margin=np.array([np.nan, 1.0]))
    assert_array_equal(rejection.unambiguous(unknown, 2.0), [False, True])


def test_duplicates_that_disagree_are_all_dropped():
    det = detections([SQUARE + 100, SQUARE + 300, SQUARE + 200], ids=[3, 3, 4])
    kept, _, counts = run(det)
    assert_array_equal(kept.tag_id, [4])
    assert counts["duplicate"] == 2


def test_a_false_find_does_not_take_the_true_one_with_it():
    """What other filters drop is no rival: a bad second find of the id leaves the good one."""
    det = detections([SQUARE + 100, SQUARE * 0.1 + 300], ids=[3, 3])
    kept, _, counts = run(det)
    assert_array_equal(kept.tag_id, [3])
    assert (counts["too_small"], counts["duplicate"]) == (1, 0)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 30))
def test_every_detection_is_kept_or_counted_once(seed, n):
    rng = np.random.default_rng(seed)
    quads = SQUARE * rng.uniform(0, 2, (n, 1, 1)) + rng.uniform(-30, 660, (n, 1, 2))
    quads += rng.normal(0, rng.choice([0.1, 10.0]), quads.shape)
    quads[rng.random(n) < 0.1] = np.nan
    det = detections(quads, ids=rng.integers(0, 25, n), hamming=rng.integers(0, 3, n))
    kept, rows, counts = run(det)
    assert len(kept) + sum(counts.values()) == n
    assert set(counts) == CAUSES
    assert_array_equal(tag_map().tag_id[rows], kept.tag_id)
    assert len(set(kept.tag_id.tolist())) == len(kept)


def test_no_detections():
    kept, rows, counts = run(detections(np.zeros((0, 4, 2))))
    assert len(kept) == len(rows) == sum(counts.values()) == 0


def test_limits_are_frozen_and_strict():
    limits = FilterConfig()
    assert (limits.max_hamming, limits.edge_px, limits.min_margin) == (1, 6.0, 0.0)
    with pytest.raises(ValidationError):
        limits.edge_px = 3.0
    with pytest.raises(ValidationError):
        FilterConfig(edge=3.0)
    with pytest.raises(ValidationError):
        FilterConfig(max_hamming=-1)
    with pytest.raises(ValidationError):
        FilterConfig(edge_px=float("nan"))
