"""MEF: both means against a search, against each other, and the cases that void the closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from oracles.vision import chordal_mean as searched
from strategies import rotvecs, seeds

from tagvo import geometry as geo
from tagvo.pose.fusion import MEAN, WEIGHT, fuse

means = st.sampled_from(sorted(MEAN))


def spread_rotations(seed, spread, n=6):
    rng = np.random.default_rng(seed)
    R = geo.exp(rng.standard_normal(3)) @ geo.exp(spread * rng.standard_normal((n, 3)))
    return R, 2.0 ** rng.integers(0, 4, n), rng


def degrees(R_a, R_b):
    return float(np.degrees(geo.angle(R_a.T @ R_b)))


@given(seeds)
def test_both_means_agree_at_three_degrees(seed):
    """Rotations at most 3 degrees from the middle; what is left is of third order in that."""
    _, w, rng = spread_rotations(seed, 0.0)
    turns = rng.standard_normal((6, 3))
    turns *= np.radians(rng.uniform(0.0, 3.0, (6, 1))) / np.linalg.norm(turns, axis=1)[:, None]
    R = geo.exp(rng.standard_normal(3)) @ geo.exp(turns)
    p = rng.standard_normal((6, 3))
    quick, slow = fuse(p, R, w, "QL2"), fuse(p, R, w, "CL2")
    assert degrees(quick[1], slow[1]) < 1e-3
    assert_allclose(quick[0], slow[0])


@settings(max_examples=8)
@given(seeds, st.sampled_from([0.02, 0.2]))
def test_cl2_is_the_least_chordal_distance(seed, spread):
    R, w, _ = spread_rotations(seed, spread, n=4)
    _, mean, _ = fuse(np.zeros((4, 3)), R, w, "CL2")
    assert degrees(mean, searched(geo.quat_from_matrix(R), w)) < 1e-3


@given(seeds, means)
def test_signs_of_quaternions_do_not_matter(seed, mean):
    R, w, rng = spread_rotations(seed, 0.3)
    q = geo.quat_from_matrix(R)
    flipped = q * rng.choice([-1.0, 1.0], (6, 1))
    a, b = MEAN[mean](q, w)[0], MEAN[mean](flipped, w)[0]
    assert_allclose(abs(a @ b), 1.0, atol=1e-12)


@given(rotvecs, seeds, means)
def test_the_mean_of_one_pose_many_times_is_that_pose(phi, seed, mean):
    R = geo.exp(phi)
    w = np.random.default_rng(seed).uniform(0.1, 9.0, 5)
    p_mean, R_mean, flags = fuse(np.tile([1.0, -2.0, 3.0], (5, 1)), np.tile(R, (5, 1, 1)), w, mean)
    assert_allclose(R_mean, R, atol=1e-7)
    assert_allclose(p_mean, [1.0, -2.0, 3.0])
    assert flags == ()


@given(seeds, means)
def test_order_and_scale_of_weights_do_not_matter(seed, mean):
    R, w, rng = spread_rotations(seed, 0.1)
    w = w + rng.uniform(0.0, 0.1, 6)
    p = rng.standard_normal((6, 3))
    order = rng.permutation(6)
    one, other = fuse(p, R, w, mean), fuse(p[order], R[order], 7.0 * w[order], mean)
    assert_allclose(one[0], other[0], atol=1e-12)
    assert_allclose(one[1], other[1], atol=1e-12)
    assert_allclose(one[0], np.average(p, axis=0, weights=w), atol=1e-12)


@given(seeds, means, rotvecs)
def test_turning_the_world_turns_the_mean(seed, mean, phi):
    R, w, _ = spread_rotations(seed, 0.1)
    turn, p = geo.exp(phi), np.zeros((6, 3))
    assert degrees(fuse(p, turn @ R, w, mean)[1], turn @ fuse(p, R, w, mean)[1]) < 1e-5


def test_ninety_degrees_apart_is_flagged_and_taken_by_cl2():
    R = geo.exp(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.radians(91.0)], [0.0, 0.1, 0.0]]))
    w = np.array([4.0, 1.0, 1.0])
    _, mean, flags = fuse(np.zeros((3, 3)), R, w, "QL2")
    assert flags == ("wide_spread",)
    assert_allclose(mean, fuse(np.zeros((3, 3)), R, w, "CL2")[1], atol=1e-12)
    R = geo.exp(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.radians(89.0)]]))
    assert fuse(np.zeros((2, 3)), R, np.ones(2), "QL2")[2] == ()


@pytest.mark.parametrize(
    ("name", "expected"), [("W1", [1, 4, 16, 64]), ("W2", [1, 2, 4, 8]), ("uniform", [1, 1, 1, 1])]
)
def test_weights_of_the_four_classes(name, expected):
    assert_allclose(WEIGHT[name](np.arange(4.0)), expected)
