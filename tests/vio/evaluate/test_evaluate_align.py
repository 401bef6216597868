"""Laws of the alignments: they find what moved the points and never make them worse."""

import numpy as np
import pytest
from evaluate_flights import estimate, stamps
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from vio.errors import EvaluationError
from vio.evaluate.align import ALIGN, Alignment, apply, estimate_alignment

seeds = st.integers(0, 2**32 - 1)


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def residual(alignment, p_E, p_W):
    return np.sum((geo.transform(alignment.R_WE, alignment.p_WE, p_E) - p_W) ** 2)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_se3_recovers_any_rigid_motion(seed):
    rng = np.random.default_rng(seed)
    p_E = rng.normal(size=(rng.integers(4, 40), 3)) * rng.uniform(0.1, 10.0)
    R_WE, p_WE = geo.exp(unit(rng) * rng.uniform(0, np.pi)), rng.normal(size=3) * 5
    found = estimate_alignment("se3", p_E, geo.transform(R_WE, p_WE, p_E))
    assert_allclose(found.R_WE, R_WE, atol=1e-7)
    assert_allclose(found.p_WE, p_WE, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(-3.1, 3.1))
def test_yaw_recovers_a_turn_about_its_axis(seed, angle):
    rng = np.random.default_rng(seed)
    axis = unit(rng)
    p_E, p_WE = rng.normal(size=(10, 3)), rng.normal(size=3)
    R_WE = geo.exp(angle * axis)
    found = estimate_alignment("yaw", p_E, geo.transform(R_WE, p_WE, p_E), tuple(3.0 * axis))
    assert_allclose(found.R_WE, R_WE, atol=1e-9)
    assert_allclose(found.p_WE, p_WE, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_more_freedom_never_leaves_more_error(seed):
    rng = np.random.default_rng(seed)
    p_E, p_W = rng.normal(size=(2, 12, 3))
    none, yaw, se3 = (
        residual(estimate_alignment(k, p_E, p_W), p_E, p_W) for k in ("none", "yaw", "se3")
    )
    assert se3 <= yaw * (1 + 1e-12) <= none * (1 + 2e-12)


@pytest.mark.parametrize("kind", ["yaw", "se3"])
def test_no_nearby_alignment_is_better(kind):
    rng = np.random.default_rng(3)
    p_E, p_W = rng.normal(size=(2, 12, 3))
    best = estimate_alignment(kind, p_E, p_W)
    for _ in range(50):
        turn = np.array([0.0, 0.0, rng.normal()]) if kind == "yaw" else rng.normal(size=3)
        R_WE = geo.exp(0.01 * turn) @ best.R_WE
        nearby = Alignment(R_WE, best.p_WE + 0.01 * rng.normal(size=3))
        assert residual(nearby, p_E, p_W) >= residual(best, p_E, p_W)


def test_se3_answers_a_mirror_image_with_a_rotation():
    p_E = np.random.default_rng(0).normal(size=(8, 3))
    assert np.linalg.det(estimate_alignment("se3", p_E, -p_E).R_WE) == pytest.approx(1.0)


def test_apply_moves_pose_velocity_and_the_position_part_of_the_covariance():
    rng = np.random.default_rng(5)
    x = estimate(stamps(4), rng, full=True)
    cov = np.tile(np.diag([1.0, 4.0, 9.0, 1.0, 2.0, 3.0]), (4, 1, 1))
    x = type(x)(x.name, x.t_ns, x.known_ns, x.p_WI, x.R_WI, x.v_WI, cov)
    R_WE, p_WE = geo.exp(np.array([0.0, 0.0, np.pi / 2])), np.array([1.0, 2.0, 3.0])
    y = apply(Alignment(R_WE, p_WE), x)
    for i in range(4):
        assert_allclose(y.p_WI[i], R_WE @ x.p_WI[i] + p_WE)
        assert_allclose(y.R_WI[i], R_WE @ x.R_WI[i])
        assert_allclose(y.v_WI[i], R_WE @ x.v_WI[i])
        assert_allclose(np.diagonal(y.cov[i]), [4.0, 1.0, 9.0, 1.0, 2.0, 3.0], atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "p"),
    [
        ("se3", np.outer(np.arange(9.0), [1, 2, 3])),  # a straight line
        ("se3", np.ones((9, 3))),
        ("se3", np.ones((1, 3))),
        ("yaw", np.outer(np.arange(9.0), [0, 0, 1])),  # straight up
        ("yaw", np.ones((1, 3))),
    ],
)
def test_places_that_do_not_fix_the_rotation_are_refused(kind, p):
    with pytest.raises(EvaluationError, match=rf"align {kind}: {len(p)} poses .* are needed"):
        estimate_alignment(kind, p, p)


def test_an_unknown_alignment_is_named_with_the_choices():
    with pytest.raises(EvaluationError, match="'sim3'; choose one of none, yaw, se3"):
        estimate_alignment("sim3", np.ones((3, 3)), np.ones((3, 3)))


@pytest.mark.parametrize("kind", ALIGN)
def test_nothing_to_align_leaves_things_alone(kind):
    found = estimate_alignment(kind, np.empty((0, 3)), np.empty((0, 3)))
    assert_allclose(found.R_WE, np.eye(3))
    assert_allclose(found.p_WE, 0.0)
