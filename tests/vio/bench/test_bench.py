import json

import numpy as np
import pytest
from simulated import corners_seen, grid_map, pinhole, pose_above

from tagvo.detect.peers import PlainAruco, PyAprilTags
from tagvo.records import Detections, PosePrior
from tagvo.render.view import render_view
from vio.bench.measure import REFERENCE, Score, _compare, figures, measure
from vio.bench.scenes import View, in_view


def scene(seed=1):
    tag_map, camera, rng = grid_map(n=3), pinhole(), np.random.default_rng(seed)
    R_WC, p_WC = pose_above(rng, 0.7, np.zeros(2), np.zeros(2))
    image = render_view(tag_map, camera, R_WC, p_WC)
    rows, corners = in_view(tag_map, camera, R_WC, p_WC)
    prior = PosePrior(0, p_WC, R_WC, 1e-6 * np.eye(6))
    return tag_map, camera, View(image, tag_map.tag_id[rows], corners, p_WC, prior)


def test_what_is_in_view_agrees_with_the_independent_projection():
    tag_map, camera, view = scene()
    rows, pixels = corners_seen(tag_map, camera, view.prior.R_WC, view.p_WC)
    assert np.array_equal(tag_map.tag_id[rows], view.tag_id)
    np.testing.assert_allclose(view.corners_px, pixels[rows], atol=1e-9)


@pytest.mark.parametrize("peer", ["aruco", "pyapriltags"])
def test_peers_hand_out_corners_in_our_order(peer):
    if peer == "pyapriltags":
        pytest.importorskip("pyapriltags")
    tag_map, _, view = scene()
    made = PlainAruco(tag_map.family) if peer == "aruco" else PyAprilTags(tag_map.family, 1.0)
    found = made.detect(view.image)
    at = {t: k for k, t in enumerate(found.tag_id.tolist())}  # tags cut by the rim among them
    rows = np.array([at[t] for t in view.tag_id.tolist()])
    assert np.abs(found.corners_px[rows] - view.corners_px).max() < 1.2


def test_a_score_counts_hits_misses_and_what_is_off():
    _, _, view = scene()
    moved = view.corners_px.copy()
    moved[0] += 0.3
    moved[1] += 7.0
    score = Score()
    _compare(score, view, Detections.of(view.tag_id[:-1], moved[:-1]))
    assert score.false == 1
    assert score.found.sum() == len(view.tag_id) - 2
    assert score.there.sum() == len(view.tag_id)
    left = 4 * (len(view.tag_id) - 2)
    assert len(score.square_px) == left
    assert np.sqrt(np.mean(score.square_px)) == pytest.approx(np.sqrt(4 * 0.18 / left))


def test_ratios_are_of_the_reference_and_every_way_sees_every_view():
    tag_map, camera, view = scene()
    calls = {"a": 0, REFERENCE: 0}

    def way(name):
        def find(seen):
            calls[name] += 1
            return Detections.of(seen.tag_id, seen.corners_px)

        return find

    views = [view] * 3
    made = {name: way(name) for name in calls}
    scores = measure(views, tag_map, camera, made, lambda: None, lambda: False)
    assert calls == {"a": 4, REFERENCE: 4}  # once to warm up
    row = figures(scores["a"], scores[REFERENCE])
    assert row["frames"] == row["frames_with_pose"] == 3
    assert row["corner_rms_px"] == 0.0
    assert row["pose_median_mm"] < 1e-3
    assert row["recall_by_px"]["40"] == 1.0
    json.dumps(row)
    assert figures(scores["a"], None)["faster_cpu_p50"] is None
