"""Truth as files really hold it: gaps, repeats, backward stamps, rows without numbers."""

import dataclasses

import numpy as np
import pytest
from evaluate_flights import MS, T0, Truth, make_truth, pose_at, stamps
from numpy.testing import assert_allclose, assert_array_equal

from tagvo import geometry as geo
from vio.errors import EvaluationError
from vio.evaluate.truth import clean_truth, differentiate, interpolate


def slow_interpolate(truth, t):
    """Pose at one stamp by walking through the rows, or None; rotation by the geodesic."""
    for i in range(len(truth)):
        if truth.t_ns[i] == t:
            return truth.p_WI[i], truth.R_WI[i]
    for i in range(len(truth) - 1):
        t0, t1 = int(truth.t_ns[i]), int(truth.t_ns[i + 1])
        if t0 < t < t1 and t1 - t0 <= 100 * MS:
            s = (t - t0) / (t1 - t0)
            R0, R1 = truth.R_WI[i], truth.R_WI[i + 1]
            p = truth.p_WI[i] + s * (truth.p_WI[i + 1] - truth.p_WI[i])
            return p, R0 @ geo.exp(s * geo.log(R0.T @ R1))
    return None


def test_interpolation_is_what_a_walk_through_the_rows_gives():
    rng = np.random.default_rng(0)
    t_ns = T0 + np.cumsum(rng.choice([20, 50, 99, 101, 400], size=60)) * MS
    p, R, _ = pose_at(t_ns)
    truth = clean_truth(Truth(t_ns, p, geo.quat_from_matrix(R)))
    asked = np.concatenate([t_ns[::7], rng.integers(t_ns[0] - 500 * MS, t_ns[-1] + 500 * MS, 300)])
    at = interpolate(truth, asked)
    expected = [slow_interpolate(truth, t) for t in asked]
    assert_array_equal(at.known, [e is not None for e in expected])
    assert 0 < at.known.sum() < len(asked)
    for i in np.flatnonzero(at.known):
        assert_allclose(at.p_WI[i], expected[i][0], atol=1e-12)
        assert_allclose(at.R_WI[i], expected[i][1], atol=1e-12)


def test_a_gap_of_a_tenth_of_a_second_is_bridged_and_a_longer_one_is_not():
    for gap_ms, bridged in ((100, True), (101, False)):
        truth = clean_truth(make_truth(2, gap_ms))
        assert interpolate(truth, truth.t_ns[:1] + 40 * MS).known[0] == bridged
        assert interpolate(truth, truth.t_ns).known.all()  # its own rows are always known


def test_nothing_is_extrapolated_but_a_rounded_stamp_still_meets_its_row():
    truth = clean_truth(make_truth(5, 350.0))
    ends = np.array([truth.t_ns[0] - 2 * MS, truth.t_ns[-1] + 2 * MS])
    assert not interpolate(truth, ends).known.any()
    assert interpolate(truth, truth.t_ns + 256).known.all()
    assert interpolate(truth, truth.t_ns - 256).known.all()


def test_quaternions_of_either_sign_turn_the_short_way():
    truth = make_truth(3)
    flipped = dataclasses.replace(truth, q_WI=truth.q_WI * [[1], [-1], [1]])
    t = truth.t_ns[:2] + 25 * MS
    a, b = (interpolate(clean_truth(x), t).R_WI for x in (truth, flipped))
    assert_allclose(a, b, atol=1e-12)


def test_bad_repeated_and_backward_rows_are_counted_and_do_no_harm():
    good = make_truth(20)
    p, q = good.p_WI.copy(), good.q_WI.copy()
    p[3] = np.nan
    q[4] = 0.0
    q[5, 2] = np.inf
    rows = np.r_[0:10, 9, 9, 12, 10, 11, 13:20]
    track = clean_truth(Truth(good.t_ns[rows], p[rows], q[rows]))
    assert (track.bad, track.repeated, track.backward) == (3, 2, 1)
    assert_array_equal(track.t_ns, np.delete(good.t_ns, [3, 4, 5]))
    assert_allclose(track.p_WI, np.delete(good.p_WI, [3, 4, 5], axis=0))


def test_of_equal_stamps_the_first_row_stays():
    one = make_truth(3)
    twice = Truth(one.t_ns[[0, 1, 1, 2]], one.p_WI[[0, 1, 2, 2]], one.q_WI[[0, 1, 2, 2]])
    assert_allclose(clean_truth(twice).p_WI, one.p_WI)


def test_truth_without_one_usable_row_is_refused():
    truth = make_truth(4)
    with pytest.raises(EvaluationError, match="none of 4 rows"):
        clean_truth(dataclasses.replace(truth, p_WI=truth.p_WI * np.nan))


def test_velocity_comes_from_the_file_where_it_has_one():
    truth = make_truth(10, velocity=True)
    assert_allclose(clean_truth(truth).v_WI, truth.v_WI)
    nothing = dataclasses.replace(truth, v_WI=np.full((10, 3), np.nan))
    assert np.isfinite(clean_truth(nothing).v_WI[1:-1]).all()


def test_derived_velocity_is_exact_for_a_parabola_at_uneven_steps():
    t_ns = T0 + np.cumsum(np.random.default_rng(1).integers(10, 60, size=30)) * MS
    t = (t_ns - T0)[:, None] * 1e-9
    v = differentiate(t_ns, 1.0 + 2.0 * t + 3.0 * t * t * [1, -1, 2])
    assert_allclose(v[1:-1], (2.0 + 6.0 * t * [1, -1, 2])[1:-1], atol=1e-9)
    assert np.isnan(v[[0, -1]]).all()


def test_no_velocity_is_derived_over_wide_steps():
    t_ns = stamps(10, 50.0)
    t_ns[5:] += 11 * MS
    v = differentiate(t_ns, pose_at(t_ns)[0])
    assert_array_equal(np.isnan(v).all(axis=1), [i in (0, 4, 5, 9) for i in range(10)])
    assert np.isnan(differentiate(t_ns[:2], np.ones((2, 3)))).all()
