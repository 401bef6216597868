"""Group laws over the hard places, scipy as the second way, derivatives by differences."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from oracles.vision import central_difference
from scipy.spatial.transform import Rotation
from strategies import away_from_pi, near_pi_rotvecs, points, rotvecs, tiny_rotvecs

from tagvo import geometry as geo

angles = st.floats(-np.pi, np.pi)


@given(rotvecs)
def test_exp_is_the_matrix_exponential(phi):
    assert_allclose(geo.exp(phi), scipy.linalg.expm(geo.hat(phi)), atol=1e-13)
    assert_allclose(geo.exp(phi) @ geo.exp(phi).T, np.eye(3), atol=1e-14)


@given(away_from_pi)
def test_log_undoes_exp(phi):
    assert_allclose(geo.log(geo.exp(phi)), phi, atol=1e-12, rtol=1e-9)


@given(tiny_rotvecs)
def test_tiny_rotations_keep_their_digits(phi):
    back = geo.log(geo.exp(phi))
    size = np.linalg.norm(phi)
    assert np.linalg.norm(back - phi) <= 1e-9 * size + 1e-16 * (size < 1e-15)


@given(rotvecs)
def test_exp_undoes_log(phi):
    R = Rotation.from_rotvec(phi).as_matrix()
    assert_allclose(geo.exp(geo.log(R)), R, atol=1e-12)
    assert_allclose(geo.angle(R), np.linalg.norm(Rotation.from_matrix(R).as_rotvec()), atol=1e-7)
    assert np.linalg.norm(geo.log(R)) <= np.pi + 1e-12


@given(near_pi_rotvecs)
def test_log_near_pi_finds_the_axis(phi):
    back = geo.log(geo.exp(phi))
    assert_allclose(min(np.linalg.norm(back - phi), np.linalg.norm(back + phi)), 0.0, atol=1e-7)


@given(away_from_pi, points)
def test_jacobians_by_differences(phi, d):
    R = geo.exp(phi)
    right = central_difference(lambda e: geo.log(R.T @ geo.exp(phi + e)), 3)
    left = central_difference(lambda e: geo.log(geo.exp(phi + e) @ R.T), 3)
    assert_allclose(geo.right_jacobian(phi), right, atol=1e-8)
    assert_allclose(geo.left_jacobian(phi), left, atol=1e-8)


@given(rotvecs, points)
def test_hat_is_the_cross_product(phi, x):
    assert_allclose(geo.hat(phi) @ x, np.cross(phi, x), atol=1e-12)


@given(rotvecs)
def test_quaternions_agree_with_scipy(phi):
    R = geo.exp(phi)
    q = geo.quat_from_matrix(R)
    expected = Rotation.from_matrix(R).as_quat(canonical=False, scalar_first=True)
    assert_allclose(abs(q @ expected), 1.0, atol=1e-12)
    assert q[0] >= 0.0
    assert_allclose(np.linalg.norm(q), 1.0, atol=1e-14)
    assert_allclose(geo.matrix_from_quat(q), R, atol=1e-12)
    assert_allclose(geo.matrix_from_quat(-3.0 * q), R, atol=1e-12)
    assert_allclose(geo.exp(geo.log_quat(-q)), R, atol=1e-12)


@given(rotvecs, rotvecs)
def test_quaternion_products_are_rotation_products(a, b):
    q = geo.multiply_quat(*(geo.quat_from_matrix(geo.exp(v)) for v in (a, b)))
    assert_allclose(geo.matrix_from_quat(q), geo.exp(a) @ geo.exp(b), atol=1e-12)


@given(rotvecs)
def test_quaternion_exponential_is_that_of_the_matrix_and_the_conjugate_undoes_it(phi):
    q = geo.exp_quat(phi)
    assert_allclose(geo.matrix_from_quat(q), geo.exp(phi), atol=1e-12)
    undone = geo.multiply_quat(geo.conjugate_quat(q), q)
    assert_allclose(undone, [1.0, 0.0, 0.0, 0.0], atol=1e-12)


@given(away_from_pi, points)
def test_se3_is_the_matrix_exponential(phi, rho):
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = geo.hat(phi), rho
    R, p = geo.exp_se3(np.concatenate([rho, phi]))
    T = scipy.linalg.expm(twist)
    scale = 1.0 + np.linalg.norm(rho)
    assert_allclose(R, T[:3, :3], atol=1e-12)
    assert_allclose(p, T[:3, 3], atol=1e-12 * scale)


@given(rotvecs, points, points)
def test_inverse_and_composition(phi, p, x):
    R = geo.exp(phi)
    R_BA, p_BA = geo.invert(R, p)
    assert_allclose(geo.transform(R_BA, p_BA, geo.transform(R, p, x)), x, atol=1e-10)
    identity = geo.compose(R, p, R_BA, p_BA)
    assert_allclose(identity[0], np.eye(3), atol=1e-13)
    assert_allclose(identity[1], 0.0, atol=1e-11)


@given(angles, st.one_of(st.floats(-1.57, 1.57), st.sampled_from([-np.pi / 2, np.pi / 2])), angles)
def test_rpy_is_zyx_and_survives_the_gimbal(roll, pitch, yaw):
    R = geo.matrix_from_rpy(roll, pitch, yaw)
    assert_allclose(R, Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix(), atol=1e-13)
    assert_allclose(geo.matrix_from_rpy(*geo.rpy_from_matrix(R)), R, atol=1e-7)
    if abs(pitch) > 1.5707963:
        assert geo.rpy_from_matrix(R)[0] == 0.0 or np.hypot(R[0, 0], R[1, 0]) > 1e-9


@given(rotvecs, st.integers(0, 2**31))
def test_projection_finds_the_nearest_rotation(phi, seed):
    rng = np.random.default_rng(seed)
    noisy = geo.exp(phi) + 0.05 * rng.standard_normal((3, 3))
    R = geo.project_to_so3(noisy)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    assert_allclose(geo.project_to_so3(R), R, atol=1e-12)
    for d in 0.01 * rng.standard_normal((5, 3)):
        other = R @ geo.exp(d)
        assert np.linalg.norm(noisy - R) <= np.linalg.norm(noisy - other) + 1e-12


def test_projection_of_a_reflection_is_still_a_rotation():
    assert_allclose(np.linalg.det(geo.project_to_so3(np.diag([1.0, 1.0, -1.0]))), 1.0)


@pytest.mark.parametrize("batch", [(), (0,), (5,), (2, 3)])
def test_batches_are_what_single_calls_give(batch):
    rng = np.random.default_rng(1)
    phi, p = rng.standard_normal((*batch, 3)), rng.standard_normal((*batch, 3))
    R = geo.exp(phi)
    calls = {
        "exp": (geo.exp, (phi,)),
        "log": (geo.log, (R,)),
        "quat": (geo.quat_from_matrix, (R,)),
        "matrix": (geo.matrix_from_quat, (geo.quat_from_matrix(R),)),
        "jr": (geo.right_jacobian, (phi,)),
        "rpy": (geo.rpy_from_matrix, (R,)),
        "transform": (geo.transform, (R, p, p)),
        "so3": (geo.project_to_so3, (R,)),
        "angle": (geo.angle, (R,)),
    }
    for name, (function, args) in calls.items():
        whole = function(*args)
        assert whole.shape[: len(batch)] == batch, name
        for at in np.ndindex(*batch):
            assert_allclose(whole[at], function(*(a[at] for a in args)), atol=1e-14, err_msg=name)
