"""Both planar poses against OpenCV's IPPE, the minimum by scipy, covariance by trial."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from oracles.vision import central_difference, least_tag_pose, pixels_of, turned
from scipy.stats import chi2
from simulated import DOWN, pinhole
from strategies import seeds, tilts

from tagvo import geometry as geo
from tagvo.camera.model import project, unproject
from tagvo.kernels import projection
from tagvo.pose.ippe import homography_at_centre, solve_tags
from tagvo.records import Observations
from tagvo.tags.tag_map import tag_corners

CAMERA = pinhole()


def observations(corners_px, camera=CAMERA, sigma=0.3):
    corners_px = np.asarray(corners_px, dtype=float)
    n = len(corners_px)
    corners_n, J, valid = unproject(camera, corners_px)
    assert valid.all()
    ids = np.arange(n)
    return Observations(ids, ids, corners_px, corners_n, J, np.full((n, 4), sigma))


def tag_view(rng, tilt, size=0.1, depth=0.7):
    """Pose of a tag in the camera, leaning by `tilt` against the line of sight."""
    about = np.array([np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0.0])
    p_CT = depth * np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
    sight = p_CT / np.linalg.norm(p_CT)
    z = np.array([0.0, 0.0, 1.0])
    axis = np.cross(z, sight)
    turn = geo.exp(axis / np.linalg.norm(axis) * np.arccos(sight[2]))
    R_CT = turn @ geo.exp(tilt * about) @ DOWN @ geo.exp(np.array([0, 0, rng.uniform(-3, 3)]))
    return R_CT, p_CT, tag_corners(np.array([size]))


def seen(R_CT, p_CT, corners_T, camera=CAMERA):
    return project(camera, corners_T @ R_CT.T + p_CT)[0]


@given(seeds, tilts)
def test_exact_corners_give_the_exact_pose_first(seed, tilt):
    R_CT, p_CT, X = tag_view(np.random.default_rng(seed), tilt)
    poses = solve_tags(observations(seen(R_CT, p_CT, X)), X, np.array([0.1]), 1)
    assert poses.rms_px[0, 0] < 1e-4
    assert poses.rms_px[0, 0] <= poses.rms_px[0, 1]
    loose = 1e-6 if tilt > 0.04 else 1e-2  # head-on both solutions meet: a double root
    errors = [geo.angle(poses.R_CT[0, s].T @ R_CT) for s in range(2)]
    assert min(errors) < loose
    if tilt > 0.04:
        assert errors[0] < loose
        assert_allclose(poses.p_CT[0, 0], p_CT, atol=1e-6)


@settings(max_examples=100)
@given(seeds, tilts, st.sampled_from([0.0, 0.3]))
def test_unrefined_poses_are_opencvs(seed, tilt, noise):
    rng = np.random.default_rng(seed)
    R_CT, p_CT, X = tag_view(rng, tilt)
    corners = seen(R_CT, p_CT, X) + noise * rng.standard_normal((1, 4, 2))
    ours = solve_tags(observations(corners), X, np.array([0.1]), 0)
    fu, fv, pu, pv = CAMERA.intrinsics
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])
    _, rvecs, tvecs, errors = cv2.solvePnPGeneric(
        X[0], corners[0], K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    if len(rvecs) < 2 or (tilt < 0.04 and noise == 0.0):
        return  # one root: the rotation is defined to the square root of the precision only
    theirs = [geo.exp(r.ravel()) for r in rvecs]
    clear = abs(errors[1, 0] - errors[0, 0]) > 1e-3
    for s in range(2):
        angles = [geo.angle(ours.R_CT[0, s].T @ R) for R in theirs]
        k = s if clear else int(np.argmin(angles))
        assert angles[k] < 2e-3
        assert_allclose(ours.p_CT[0, s], tvecs[k].ravel(), atol=2e-3)


@settings(max_examples=15)
@given(seeds, st.floats(0.2, 1.1))
def test_the_refined_pose_is_a_minimum(seed, tilt):
    rng = np.random.default_rng(seed)
    R_CT, p_CT, X = tag_view(rng, tilt)
    corners = seen(R_CT, p_CT, X) + 0.3 * rng.standard_normal((1, 4, 2))
    poses = solve_tags(observations(corners), X, np.array([0.1]), 10)
    start = poses.R_CT[0, 0], poses.p_CT[0, 0]
    R, p, cost = least_tag_pose(CAMERA, corners[0], X[0], *start, np.full(4, 0.3))
    assert 4.0 * poses.rms_px[0, 0] ** 2 / 0.3**2 <= cost + 1e-3
    sigmas = np.sqrt(np.diag(poses.cov[0, 0]))
    assert np.linalg.norm(start[1] - p) < 0.1 * sigmas[:3].max()
    assert (np.abs(geo.log(R.T @ start[0])) < 0.1 * sigmas[3:]).all()


@pytest.mark.parametrize("refine", [1, 3])
@pytest.mark.parametrize("tilt_deg", [35.0, 60.0])
def test_covariance_is_that_of_the_estimates(tilt_deg, refine):
    rng = np.random.default_rng(11)
    R_CT, p_CT, X = tag_view(rng, np.radians(tilt_deg), depth=0.5)
    n = 2000
    corners = seen(R_CT, p_CT, X) + 0.3 * rng.standard_normal((n, 4, 2))
    poses = solve_tags(observations(corners), np.tile(X, (n, 1, 1)), np.full(n, 0.1), refine)
    d_T = (poses.p_CT[:, 0] - p_CT) @ R_CT  # the step of p is written in T
    right = geo.log(R_CT.T @ poses.R_CT[:, 0])
    e = np.concatenate([d_T, right], axis=1)
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(poses.cov[:, 0]), e)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * n) / n
    assert 0.95 * low < nees.mean() < 1.1 * high  # a tenth for the curvature


def test_the_better_solution_comes_first_and_both_fit_the_corners():
    rng = np.random.default_rng(5)
    views = [tag_view(rng, tilt) for tilt in rng.uniform(0.0, 1.2, 200)]
    corners = np.concatenate([seen(*v) for v in views]) + 0.3 * rng.standard_normal((200, 4, 2))
    X = np.concatenate([v[2] for v in views])
    poses = solve_tags(observations(corners), X, np.full(200, 0.1), 1)
    assert (poses.rms_px[:, 0] <= poses.rms_px[:, 1]).all()
    for s in range(2):
        fitted = project(CAMERA, X @ np.swapaxes(poses.R_CT[:, s], 1, 2) + poses.p_CT[:, s, None])
        rms = np.sqrt(np.square(fitted[0] - corners).sum(axis=(1, 2)) / 4.0)
        assert_allclose(poses.rms_px[:, s], rms, atol=1e-6)
    assert_allclose(np.linalg.det(poses.R_CT), 1.0, atol=1e-9)


def test_steps_never_raise_the_error():
    rng = np.random.default_rng(6)
    views = [tag_view(rng, tilt, depth=2.0) for tilt in rng.uniform(0.0, 1.45, 200)]
    corners = np.concatenate([seen(*v) for v in views]) + 0.5 * rng.standard_normal((200, 4, 2))
    X = np.concatenate([v[2] for v in views])
    before = np.inf
    for steps in (0, 1, 2, 10):
        rms = np.sort(solve_tags(observations(corners), X, np.full(200, 0.1), steps).rms_px, axis=1)
        assert (rms <= before + 1e-9).all()
        before = rms


@pytest.mark.parametrize(
    "quad",
    [np.zeros((4, 2)), np.array([[0, 0], [10, 0], [20, 0], [30, 0.0]]), np.full((4, 2), 7.0)],
)
def test_a_quad_that_is_none_does_not_crash(quad):
    poses = solve_tags(observations([quad]), tag_corners(np.array([0.1])), np.array([0.1]), 2)
    assert poses.p_CT.shape == (1, 2, 3)


def test_no_tags():
    poses = solve_tags(observations(np.zeros((0, 4, 2))), np.zeros((0, 4, 3)), np.zeros(0), 1)
    assert len(poses) == 0


@given(seeds, st.floats(0.0, 1.2))
def test_the_homography_has_the_centre_and_its_slope(seed, tilt):
    R_CT, p_CT, X = tag_view(np.random.default_rng(seed), tilt)
    corners_n, _, _ = unproject(CAMERA, seen(R_CT, p_CT, X)[0])
    x, J = np.empty(2), np.empty((2, 2))
    homography_at_centre(corners_n, 0.1, x, J, np.empty((3, 3)))
    assert_allclose(x, p_CT[:2] / p_CT[2], atol=1e-9)

    def image(d):
        y = p_CT + R_CT[:, :2] @ d
        return y[:2] / y[2]

    assert_allclose(J, central_difference(image, 2), atol=1e-5)


@given(seeds, st.floats(0.0, 1.2))
def test_derivatives_of_the_residual(seed, tilt):
    """The image is linearised at the measured corner: exact there, so corners are exact here."""
    rng = np.random.default_rng(seed)
    R_CT, p_CT, X = tag_view(rng, tilt)
    corners_n, J_px_n, _ = unproject(CAMERA, seen(R_CT, p_CT, X)[0])
    r, A, x_C = np.empty(8), np.empty((8, 3)), np.empty((4, 3))
    assert projection.residual(R_CT, p_CT, X[0], corners_n, J_px_n, r, A, x_C)
    assert_allclose(r, 0.0, atol=1e-8)
    L, J = np.empty((8, 6)), np.empty((8, 6))
    projection.tag_jacobian(A, R_CT, X[0], L)
    origin = np.eye(3), np.zeros(3)
    tag = central_difference(
        lambda d: pixels_of(CAMERA, *origin, turned(R_CT, d[3:]), p_CT + R_CT @ d[:3], X[0]), 6
    )
    assert_allclose(L, tag, rtol=1e-5, atol=1e-3)
    R_WC = geo.exp(rng.standard_normal(3))
    p_WC = rng.standard_normal(3)
    R_WT, p_WT = geo.compose(R_WC, p_WC, R_CT, p_CT)
    projection.camera_jacobian(A, R_WC, x_C, J)
    camera = central_difference(
        lambda d: pixels_of(CAMERA, turned(R_WC, d[3:]), p_WC + d[:3], R_WT, p_WT, X[0]), 6
    )
    assert_allclose(J, camera, rtol=1e-5, atol=1e-3)


def test_a_tag_behind_the_camera_is_told():
    r, A, x_C = np.empty(8), np.empty((8, 3)), np.empty((4, 3))
    X = tag_corners(np.array([0.1]))[0]
    behind = np.array([0.0, 0.0, -1.0])
    args = np.zeros((4, 2)), np.tile(np.eye(2), (4, 1, 1)), r, A, x_C
    assert not projection.residual(np.eye(3), behind, X, *args)
    assert projection.residual(np.eye(3), -behind, X, *args)
    assert np.isfinite(r).all()
