"""What a tag tells of the camera: derivatives, the Woodbury law, the mean's covariance by trial."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from oracles.vision import central_difference, pixels_of, tag_covariance, turned
from scipy.stats import chi2
from simulated import DOWN, corners_seen, error_of, grid_map, pinhole, pose_above, shot
from strategies import seeds

from tagvo import geometry as geo
from tagvo.config import IntrinsicsErrorConfig, TagvoConfig
from tagvo.kernels.tag_residual import (
    accumulate,
    mean_covariance,
    residual_factor,
    systematic_shift,
    tag_rows,
)
from tagvo.pipeline import TagVO
from tagvo.pose.observations import observe, tag_batch
from tagvo.records import Detections

CAMERA = pinhole()
FLOOR = IntrinsicsErrorConfig()


def batch_at(seed, height=0.6, tilt_deg=15.0, n=2):
    """A batch of exactly seen tags, and the pose they are seen from."""
    rng = np.random.default_rng(seed)
    tag_map = grid_map(n, [0.05, 0.1], 0.15)
    R_WC, p_WC = pose_above(rng, height, [-0.05, -0.05], [0.05, 0.05], tilt_deg)
    _, pixels = corners_seen(tag_map, CAMERA, R_WC, p_WC)
    det = Detections.of(tag_map.tag_id, pixels)
    obs, lost = observe(det, tag_map.rows(det.tag_id), CAMERA, 0.3)
    assert lost == 0
    return tag_batch(obs, tag_map, CAMERA, FLOOR), R_WC, p_WC


def rows_of(tags, R_WC, p_WC, i):
    rows, L = np.empty((8, 7)), np.empty((8, 6))
    assert tag_rows(R_WC, p_WC, tags, i, rows, L, np.empty((16, 3)))
    return rows[:, 0], rows[:, 1:], L


@given(seeds)
def test_rows_by_differences(seed):
    tags, R_WC, p_WC = batch_at(seed)
    r, J, L = rows_of(tags, R_WC, p_WC, 1)
    tag = tags.R_WT[1], tags.p_WT[1], tags.corners_T[1]

    def moved_camera(d):
        return pixels_of(CAMERA, turned(R_WC, d[3:]), p_WC + d[:3], *tag)

    def moved_tag(d):
        R, p, X = tag
        return pixels_of(CAMERA, R_WC, p_WC, turned(R, d[3:]), p + R @ d[:3], X)

    assert_allclose(r, 0.0, atol=1e-8)
    assert_allclose(J, central_difference(moved_camera, 6), rtol=1e-5, atol=1e-3)
    assert_allclose(L, central_difference(moved_tag, 6), rtol=1e-5, atol=1e-3)


@given(seeds)
def test_the_factor_is_that_of_the_residuals_covariance(seed):
    tags, R_WC, p_WC = batch_at(seed)
    _, _, L = rows_of(tags, R_WC, p_WC, 0)
    factor = np.empty((8, 8))
    assert residual_factor(L, tags.laying[0], tags.sigma_px[0], factor)
    tag = tags.R_WT[0], tags.p_WT[0], tags.corners_T[0], tags.sigma_px[0], tags.laying[0]
    S = tag_covariance(CAMERA, R_WC, p_WC, *tag)
    assert_allclose(np.tril(factor) @ np.tril(factor).T, S, rtol=1e-4, atol=1e-4)


@given(seeds, st.floats(0.0, 12.0))
def test_woodbury_law_a_laying_error_moves_the_camera_with_the_tag(seed, tilt_deg):
    """(J^T S^-1 J)^-1 = (J^T J / sigma^2)^-1 + G Sigma G^T, G the motion with the tag's error."""
    tags, R_WC, p_WC = batch_at(seed, tilt_deg=tilt_deg)
    i = 0
    _, J, L = rows_of(tags, R_WC, p_WC, i)
    factor = np.empty((8, 8))
    residual_factor(L, tags.laying[i], tags.sigma_px[i], factor)
    whole = np.linalg.inv(J.T @ np.linalg.solve(np.tril(factor) @ np.tril(factor).T, J))
    alone = np.linalg.inv(J.T @ J / tags.sigma_px[i, 0] ** 2)
    R_TC, p_TC = geo.compose(*geo.invert(tags.R_WT[i], tags.p_WT[i]), R_WC, p_WC)

    def rigid(d):  # the tag moves by d in the map, and the camera that sees it moves along
        R_WT, p_WT = tags.R_WT[i] @ geo.exp(d[3:]), tags.p_WT[i] + tags.R_WT[i] @ d[:3]
        R, p = geo.compose(R_WT, p_WT, R_TC, p_TC)
        return np.concatenate([p - p_WC, geo.log(R_WC.T @ R)])

    G = central_difference(rigid, 6)
    expected = alone + G @ np.diag(tags.laying[i] ** 2) @ G.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert_allclose(whole / scale, expected / scale, atol=1e-5)


def test_systematic_shift_is_that_of_the_corners():
    offset = np.random.default_rng(0).uniform(-300, 300, (5, 4, 2))
    shift = systematic_shift(offset, 0.001, 0.5)
    for s, wrong in enumerate(([0.001, 0, 0], [0, 0.5, 0], [0, 0, 0.5])):
        expected = offset * wrong[0] + np.array(wrong[1:])
        assert_allclose(shift[..., s].reshape(5, 4, 2), expected)


def test_accumulate_is_the_product():
    J, H = np.random.default_rng(0).standard_normal((8, 6)), np.empty((6, 6))
    accumulate(J, H)
    assert_allclose(H, J.T @ J)


@pytest.mark.parametrize("floor", [IntrinsicsErrorConfig(focal_rel=0.0, principal_px=0.0), FLOOR])
@pytest.mark.parametrize("lever", [0.0, 0.25])
def test_mean_covariance_is_that_of_the_means(floor, lever):
    """Actual means of per-tag poses, leaning enough that no tag flips, everything redrawn."""
    camera = pinhole(R_CI=DOWN, p_CI=np.array([lever, 0.0, 0.05]))
    tag_map = grid_map(2, [0.1, 0.05], 0.2)
    config = TagvoConfig(pose="fused", outliers="none", select="ALL", refine=2, floor=floor)
    vo = TagVO(camera, tag_map, config)
    rng = np.random.default_rng(8)
    R_WC = DOWN @ geo.exp(np.radians([33.0, 0.0, 0.0])) @ geo.exp(np.array([0.0, 0.0, 0.4]))
    p_WC = -0.6 * R_WC[:, 2]
    errors, covs, n = [], [], 400
    for _ in range(n):
        true = shot(tag_map, camera, R_WC, p_WC, rng, floor=floor)
        fused = vo.trace(true.frame).fused
        errors.append(error_of(fused.p_WC, fused.R_WC, true))
        covs.append(fused.cov)
    e = np.array(errors)
    nees = np.einsum("ni,nij,nj->n", e, np.linalg.inv(np.array(covs)), e)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 6 * n) / n
    assert 0.97 * low < nees.mean() < 1.05 * high


def test_mean_covariance_says_nan_where_a_tag_is_behind():
    tags, R_WC, p_WC = batch_at(0)
    used, weight = np.array([0, 1]), np.array([0.5, 0.5])
    assert np.isfinite(mean_covariance(R_WC, p_WC, tags, used, weight)).all()
    assert np.isnan(mean_covariance(R_WC, -p_WC, tags, used, weight)).all()
