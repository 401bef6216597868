"""Rotation kernels against geometry's, which have their own laws."""

import numpy as np
from hypothesis import given
from numpy.testing import assert_allclose
from strategies import rotvecs

from tagvo import geometry as geo
from tagvo.kernels import so3


@given(rotvecs, rotvecs)
def test_rotated_quaternion_and_matrix_agree_with_geometry(a, b):
    R, out, q = geo.exp(a), np.empty((3, 3)), np.empty(4)
    so3.rotated(R, b, out)
    assert_allclose(out, R @ geo.exp(b), atol=1e-12)
    so3.quaternion(R, q)
    assert_allclose(q * np.sign(q @ geo.quat_from_matrix(R)), geo.quat_from_matrix(R), atol=1e-7)
    so3.matrix_into(out, *q)
    assert_allclose(out, R, atol=1e-12)


@given(rotvecs, rotvecs)
def test_exponential_turn_and_hat_product_agree_with_geometry(a, b):
    R, out, x = geo.exp(a), np.empty((3, 3)), np.zeros(6)
    x[1:5] = geo.quat_from_matrix(R)
    so3.turn_quat(x, 1, so3.exp_quat(*b))
    assert_allclose(geo.matrix_from_quat(x[1:5]), R @ geo.exp(b), atol=1e-9)
    so3.times_hat(out, R, b, -2.0)
    assert_allclose(out, -2.0 * R @ geo.hat(b), atol=1e-12)


@given(rotvecs, rotvecs)
def test_orthonormalizing_comes_nearer_to_the_rotation_by_squares(a, b):
    true, E = geo.exp(a), np.empty((3, 3))
    R = true @ (np.eye(3) + 1e-4 * np.outer(b, b) / (1.0 + b @ b))
    before = so3.not_orthonormal(R, E)
    assert_allclose(E, R.T @ R - np.eye(3), atol=1e-12)
    so3.orthonormalize(R, E)
    assert so3.not_orthonormal(R, E) <= 3.0 * before**2 + 1e-14  # 3 (E^2 - E^3 / 3) / 4, by element


@given(rotvecs, rotvecs)
def test_distance_of_poses_is_chord_and_shift(a, b):
    R_a, R_b = geo.exp(a), geo.exp(b)
    chord2 = 0.5 * np.sum((R_a - R_b) ** 2)
    got = so3.pose_distance2(R_a, a, R_b, b, 2.0)
    assert_allclose(got, chord2 + 0.25 * np.sum((a - b) ** 2), atol=1e-12)
