"""The covariances are honest at every height: 500 frames each, everything redrawn for every one."""

import pytest
from covariance import FUSED_RANGE, JOINT_RANGE, consistency
from simulated import HEIGHTS


@pytest.mark.parametrize("height", HEIGHTS)
def test_nees_of_both_poses(height):
    figures = consistency(height, 500, seed=1)
    assert JOINT_RANGE[0] < figures.mean("joint") < JOINT_RANGE[1]
    assert FUSED_RANGE[0] < figures.mean("fused") < FUSED_RANGE[1]
