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
