"""A lone tag with one corner off: its covariance covers what the fit hides of it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.pipeline import TagVO
from tagvo.pose.lone_tag import corner_rows, with_hidden_shift
from tagvo.pose.observations import observe, tag_batch
from tagvo.records import Detections, Frame
from tagvo.tags.tag_map import map_from_dict

CAMERA = Camera("none", np.array([530.0, 530.0, 320.0, 240.0]), np.zeros(4), (640, 480))
SIGMA_PX = 0.3


def tag_of(size):
    tag = {"id": 0, "size": size, "p": [0, 0, 0], "q": [1, 0, 0, 0]}
    return map_from_dict({"family": "tagStandard41h12", "size_kind": "border", "tags": [tag]}, "m")


def seen(size, tilt, shift_px, seed):
    """The map, a camera pose 0.7 m off and what it sees, one corner shifted any way."""
    rng, tag_map = np.random.default_rng(seed), tag_of(size)
    turn = geo.exp(np.array([tilt, 0.0, 0.0]) + 0.03 * rng.normal(size=3))
    R_WC = np.diag([1.0, -1.0, -1.0]) @ turn
    p_WC = -R_WC @ np.array([*(0.05 * rng.normal(size=2)), 0.7])
    p_C = (tag_map.corners_T[0] - p_WC) @ R_WC
    corners = p_C[:, :2] / p_C[:, 2:] * 530.0 + [320.0, 240.0]
    corners = corners + SIGMA_PX * rng.normal(size=(4, 2))
    way = rng.uniform(0.0, 2.0 * np.pi)
    corners[rng.integers(4)] += shift_px * np.array([np.cos(way), np.sin(way)])
    found = Detections.of(np.array([0]), corners[None], sigma_px=np.full((1, 4), SIGMA_PX))
    return tag_map, R_WC, p_WC, found


def nees(size, tilt, shift_px, seeds=40):
    out = []
    for seed in range(seeds):
        tag_map, R_WC, p_WC, found = seen(size, tilt, shift_px, seed)
        pose = TagVO(CAMERA, tag_map)(Frame(0, detections=found))
        e = np.r_[pose.p_WC - p_WC, geo.log(R_WC.T @ pose.R_WC)]
        out.append(e @ np.linalg.solve(pose.cov, e) / 6.0)
    return np.array(out)


@pytest.mark.parametrize("size", [0.1, 0.2])
@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_one_corner_off_is_within_what_is_stated(size, tilt):
    """Median NEES per dof; without the hidden shift up to 9 head on."""
    for shift_px in (3.0, 6.0, 12.0):
        assert np.median(nees(size, tilt, shift_px)) < 1.5


def test_a_tag_that_fits_keeps_its_covariance():
    changed = 0
    for seed in range(40):
        tag_map, _, _, found = seen(0.2, 0.4, 0.0, seed)
        trace = TagVO(CAMERA, tag_map).trace(Frame(0, detections=found))
        tags = batch(tag_map, found)
        joint, misfit = with_hidden_shift(trace.joint, tags)
        changed += misfit != 1.0
        assert misfit == 1.0 or misfit > 4.6
        assert misfit != 1.0 or joint is trace.joint
    assert changed <= 4


def batch(tag_map, found):
    from tagvo.config import IntrinsicsErrorConfig

    obs, _ = observe(found, np.array([0]), CAMERA, SIGMA_PX)
    return tag_batch(obs, tag_map, CAMERA, IntrinsicsErrorConfig())


def test_the_jacobian_is_that_of_the_residual():
    tag_map, R_WC, p_WC, found = seen(0.2, 0.4, 3.0, 1)
    tags = batch(tag_map, found)
    _, J = corner_rows(R_WC, p_WC, tags)
    step = 1e-6
    for k in range(6):
        d = step * np.eye(6)[k]
        ahead = corner_rows(R_WC @ geo.exp(d[3:]), p_WC + d[:3], tags)[0]
        back = corner_rows(R_WC @ geo.exp(-d[3:]), p_WC - d[:3], tags)[0]
        assert_allclose(-(ahead - back) / (2.0 * step), J[:, k], atol=1e-3 * np.abs(J).max())
