from dataclasses import replace

import numpy as np
import pytest
from track_views import CAMERA, MAP, TRACK, prior_of, view

from tagvo.config import TrackConfig
from tagvo.detect.protocol import no_detections
from tagvo.pipeline import TagVO
from tagvo.records import Frame
from tagvo.track import Tracker
from tagvo.track.policy import (
    GateState,
    decimate_needed,
    looks_mosaic,
    strip_due,
    tracking_failed,
)


@pytest.mark.parametrize("height", [480, 481, 720, 1232])
@pytest.mark.parametrize("hz", [10.0, 30.0, 60.0])
def test_strips_cover_the_image_within_a_sweep(height, hz):
    config, state, seen = TrackConfig(mode="on"), GateState(), np.zeros(height, dtype=bool)
    for k in range(round(hz * config.sweep_s)):
        strip = strip_due(state, config, 10**18 + round(k / hz * 1e9), height, 40)
        if strip is not None:
            state = replace(state, strip=strip.index)
            seen[strip.top : strip.bottom] = True
    assert seen.all()
    assert strip_due(state, TrackConfig(sweep_s=0.0), 0, height, 40) is None


def test_a_raw_mosaic_is_seen_and_no_grey_image_is_taken_for_one():
    for seed, height in enumerate((0.5, 0.8, 1.2, 2.0)):
        image = view(seed, height)[0]
        raw = image.copy()
        raw[::2, ::2] = raw[::2, ::2] * 0.7
        assert not looks_mosaic(image)
        assert looks_mosaic(raw)
    stripes = np.tile(np.array([[0, 255]], dtype=np.uint8), (480, 320))
    assert not looks_mosaic(stripes)
    assert not looks_mosaic(np.ascontiguousarray(stripes.T))


def test_too_little_tracked_is_no_tracking():
    config = TrackConfig(min_tags=3, min_share=0.5)
    assert tracking_failed(0, 0, config) == "none_in_view"
    assert tracking_failed(2, 2, config) == "too_few"
    assert tracking_failed(4, 9, config) == "too_small_a_share"
    assert tracking_failed(5, 9, config) is None


def test_decimation_follows_the_tags_that_are_needed():
    sides, size = np.full(20, 18.0), np.full(20, 0.0575)
    assert decimate_needed(np.zeros(0), np.zeros(0), False) is None
    assert decimate_needed(sides, size, False) == 1.5
    assert decimate_needed(2.0 * sides, size, False) == 3.0
    both = np.r_[sides, 45.0, 90.0], np.r_[size, 0.23, 0.46]
    assert decimate_needed(*both, False) == 1.5  # eight tags are needed
    assert decimate_needed(*both, True) == 3.0  # the two largest sizes alone


def asking(asked):
    """A search that finds nothing and keeps what decimation it was asked for."""

    def search(part, decimate):
        asked.append(decimate)
        return no_detections()

    return search


@pytest.mark.parametrize(
    ("seed", "height", "decimate"), [(5, 0.5, 4.0), (5, 0.8, 3.0), (3, 0.8, 2.0)]
)
def test_strips_are_decimated_by_what_the_prior_puts_into_the_image(seed, height, decimate):
    image, R_WC, p_WC, _ = view(seed, height)
    asked, tracker = [], Tracker(CAMERA, MAP, TrackConfig(mode="on", strips=1))
    got = tracker(image, 0, prior_of(R_WC, p_WC), asking(asked))
    assert got.counts["strips"] == 1
    assert asked == [decimate]


def test_a_search_without_a_prior_learns_from_the_last_how_far_to_decimate():
    """Large tags; then none are found, and the search is as fine as at first."""
    large = view(5, 0.5)[0]
    vo, asked = TagVO(CAMERA, MAP, TRACK), []
    inner = vo._search

    def search(gray, decimate=None):
        asked.append(decimate)
        return inner(gray, decimate)

    vo._search = search
    for k, image in enumerate((large, large, np.zeros_like(large), large)):
        trace = vo.trace(Frame(k, image))
        assert trace.counts["search_no_prior"] == 1
    assert asked == [None, 4.0, 4.0, None]
    assert trace.pose is not None
