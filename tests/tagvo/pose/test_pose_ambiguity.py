"""Which planar branch a tag takes: on floors of small tags seen head-on, and with a prior."""

import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from simulated import DOWN, arena, grid_map, pinhole, pose_above, shot
from strategies import seeds

from tagvo import geometry as geo
from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from tagvo.pose.ambiguity import AMBIGUITY, camera_candidates, chi2_gap, prior_cost
from tagvo.records import PosePrior

CAMERA = pinhole()


def candidates_of(tag_map, height, count, tilt_deg, seed):
    """Frames from above the map's middle: as `judged`."""
    rng = np.random.default_rng(seed)
    middle = tag_map.p_WT[:, :2].mean(axis=0)
    poses = (pose_above(rng, height, middle, middle, tilt_deg) for _ in range(count))
    yield from judged(tag_map, poses, rng)


def judged(tag_map, poses, rng):
    """Trace, truth, each tag's true branch (n,), how far apart the branches' errors are (n,)."""
    vo = TagVO(CAMERA, tag_map, TagvoConfig(pose="fused"))
    for R_WC, p_WC in poses:
        true = shot(tag_map, CAMERA, R_WC, p_WC, rng)
        trace = vo.trace(true.frame)
        off = geo.angle(true.R_WC.T @ trace.candidates.R_WC)
        yield trace, true, np.argmin(off, axis=1), np.abs(off[:, 0] - off[:, 1])


@pytest.mark.parametrize("tilt_deg", [0.5, 6.0])
def test_consistent_finds_the_branch_that_first_misses(tilt_deg):
    """2 m above 5.75 cm tags: the two branches' errors are nearly the same."""
    right = {"first": [], "consistent": []}
    tag_map = grid_map(7, 0.0575, 0.2)
    for trace, _, true_branch, apart in candidates_of(tag_map, 2.0, 40, tilt_deg, 1):
        clear = apart > np.radians(6.0)  # else either will do
        c = trace.candidates
        area = np.ones(len(c.gap))
        for name, hits in right.items():
            branch = AMBIGUITY[name](c.R_WC, c.p_WC, c.depth, c.gap, area, None)
            hits.extend((branch == true_branch)[clear])
    assert len(right["first"]) > 500
    assert np.mean(right["first"]) < 0.9
    assert np.mean(right["consistent"]) > 0.99


def test_consistent_over_the_arena():
    hits = []
    for trace, _, true_branch, apart in candidates_of(arena(), 2.0, 20, 4.0, 2):
        hits.extend((trace.candidates.branch == true_branch)[apart > np.radians(6.0)])
    assert np.mean(hits) > 0.99


def lone_tag(count, seed):
    """A tag of 5.75 cm, 1.5 m away, seen 20 degrees from head-on."""
    rng = np.random.default_rng(seed)
    turns = geo.exp(np.radians(20.0) * np.array([1.0, 0, 0]))
    R_WC = [DOWN @ geo.exp(np.array([0, 0, a])) @ turns for a in rng.uniform(-3, 3, count)]
    return judged(grid_map(1, 0.0575), ((R, -1.5 * R[:, 2]) for R in R_WC), rng)


def test_a_good_prior_settles_a_lone_tag():
    rng = np.random.default_rng(3)
    right, first = [], []
    cov = np.diag([0.02**2] * 3 + [np.radians(1.0) ** 2] * 3)
    for trace, true, true_branch, apart in lone_tag(120, 3):
        if apart[0] < np.radians(8.0):
            continue
        error = np.linalg.cholesky(cov) @ rng.standard_normal(6)
        prior = PosePrior(0, true.p_WC + error[:3], true.R_WC @ geo.exp(error[3:]), cov)
        c = trace.candidates
        args = c.R_WC, c.p_WC, c.depth, c.gap, np.ones(1)
        right.append(AMBIGUITY["prior"](*args, prior)[0] == true_branch[0])
        first.append(AMBIGUITY["consistent"](*args, prior)[0] == true_branch[0])
    assert len(right) > 30
    assert np.mean(right) > 0.97
    assert np.mean(first) < 0.9


@pytest.mark.parametrize("far", [0.0, 1e3, 1e9])
@pytest.mark.parametrize("size", [1e-12, 1e6])
def test_a_wild_prior_does_not_crash(far, size):
    rng = np.random.default_rng(4)
    prior = PosePrior(0, np.full(3, far), geo.exp(np.array([3.0, 0.4, 0.0])), size * np.eye(6))
    for pose in ("fused", "joint"):
        vo = TagVO(CAMERA, arena(), TagvoConfig(pose=pose, ambiguity="prior"))
        true = shot(vo.tag_map, CAMERA, *pose_above(rng, 1.0, [1, 1], [2, 4]), rng)
        out = vo(true.frame, prior)
        assert out is None or np.isfinite(out.cov).all()


def test_without_a_prior_the_method_prior_is_consistent():
    for trace, *_ in candidates_of(grid_map(3, 0.06), 1.5, 5, 3.0, 5):
        c = trace.candidates
        args = c.R_WC, c.p_WC, c.depth, c.gap, np.ones(len(c.gap)), None
        assert_array_equal(AMBIGUITY["prior"](*args), AMBIGUITY["consistent"](*args))


def test_one_tag_alone_takes_its_first():
    for trace, *_ in lone_tag(5, 6):
        assert trace.candidates.branch[0] == 0


@given(seeds)
def test_candidates_put_the_tag_where_the_map_has_it(seed):
    rng = np.random.default_rng(seed)
    R_CT, p_CT = geo.exp(rng.standard_normal((4, 2, 3))), rng.standard_normal((4, 2, 3))
    R_WT, p_WT = geo.exp(rng.standard_normal((4, 3))), rng.standard_normal((4, 3))
    R_WC, p_WC, depth = camera_candidates(R_CT, p_CT, R_WT, p_WT)
    R, p = geo.compose(R_WC, p_WC, R_CT, p_CT)
    assert_allclose(R, np.repeat(R_WT[:, None], 2, axis=1), atol=1e-12)
    assert_allclose(p, np.repeat(p_WT[:, None], 2, axis=1), atol=1e-12)
    assert_allclose(depth, p_CT[..., 2])


def test_the_gap_is_a_chi_square_and_infinite_without_a_second():
    gap = chi2_gap(np.array([[0.1, 0.4], [0.2, np.inf], [np.nan, np.nan]]), np.full((3, 4), 0.5))
    assert_allclose(gap, [4 * (0.16 - 0.01) / 0.25, np.inf, np.inf])


def test_prior_cost_is_zero_at_the_prior_and_grows_away_from_it():
    prior = PosePrior(0, np.ones(3), DOWN, 1e-4 * np.eye(6))
    R = DOWN @ geo.exp(np.array([[0.0, 0, 0], [0.1, 0, 0], [1.0, 0, 0]]))
    cost = prior_cost(R, np.ones((3, 3)), np.ones(3), prior)
    assert cost[0] == 0.0
    assert cost[2] > cost[1] > 0.0
