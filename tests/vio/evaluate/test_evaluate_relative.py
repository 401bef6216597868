"""Drift as evo measures it, and the pairs over which it is measured."""

import numpy as np
import pytest
from evaluate_flights import MS, T0, estimate, make_truth
from numpy.testing import assert_allclose, assert_array_equal

from tagvo import geometry as geo
from vio.evaluate.relative import pairs_along_way, pairs_in_time, relative_errors
from vio.evaluate.truth import clean_truth


def test_pairs_in_time_are_as_far_apart_as_asked_and_none_over_a_gap():
    t_ns = np.array([0, 100, 200, 300, 900, 1000, 1100], dtype=np.int64) * MS
    assert_array_equal(pairs_in_time(t_ns, 0.2), [[0, 2], [1, 3], [4, 6]])
    assert pairs_in_time(t_ns, 5.0).shape == (0, 2)


def test_pairs_along_the_way_start_where_the_last_ended():
    p = np.zeros((9, 3))
    p[:, 1] = 0.4 * np.arange(9)
    assert_array_equal(pairs_along_way(p, 1.0), [[0, 3], [3, 6]])
    assert pairs_along_way(p, 50.0).shape == (0, 2)


@pytest.mark.parametrize(("unit", "delta"), [("frames", 1), ("frames", 10), ("meters", 0.7)])
def test_agrees_with_evo(unit, delta):
    trajectory = pytest.importorskip("evo.core.trajectory", reason="evo is not installed")
    from evo.core.metrics import RPE, PoseRelation, Unit

    truth = clean_truth(make_truth(300))
    x = estimate(truth.t_ns, np.random.default_rng(4), sigma=0.05)
    t_s = (truth.t_ns - T0) * 1e-9
    theirs = [
        trajectory.PoseTrajectory3D(p, geo.quat_from_matrix(R), t_s)
        for p, R in ((truth.p_WI, truth.R_WI), (x.p_WI, x.R_WI))
    ]
    if unit == "frames":
        rows = np.arange(0, len(truth) - delta, delta)
        pairs = np.stack([rows, rows + delta], axis=-1)
    else:
        pairs = pairs_along_way(truth.p_WI, delta)
    moved, turned = relative_errors(x.p_WI, x.R_WI, truth.p_WI, truth.R_WI, pairs)
    for relation, ours in (
        (PoseRelation.translation_part, moved),
        (PoseRelation.rotation_angle_rad, turned),
    ):
        rpe = RPE(relation, delta=delta, delta_unit=Unit[unit], pairs_from_reference=True)
        rpe.process_data(tuple(theirs))
        assert_allclose(ours, rpe.error, atol=1e-9)


def test_a_way_beyond_what_a_metre_can_be_added_to_ends():
    """A truth of 1e29 m: each row is a pair with the next, and no row is its own."""
    p = np.zeros((5, 3))
    p[2:, 0] = 1e29
    assert_array_equal(pairs_along_way(p, 1.0), [[0, 2], [2, 3], [3, 4]])
