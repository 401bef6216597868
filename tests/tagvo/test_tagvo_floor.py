"""The joint pose against the paper's variants on rendered floors, exact and laid by hand.

tools/floor_table.py is the long version: four heights, 200 places each.
"""

import numpy as np
import pytest
from oracles.floor_study import study, variants, views
from simulated import arena, pinhole

PLACES = 20


@pytest.fixture(scope="module", params=[(h, m) for h in (0.8, 1.4) for m in (False, True)])
def result(request):
    height, misplaced = request.param
    tag_map, camera = arena(), pinhole()
    seen = list(views(tag_map, camera, height, PLACES, 3, misplaced=misplaced))
    return study(seen, tag_map, camera, variants())


def test_joint_beats_what_the_paper_proposes(result):
    joint = result.errors["joint"]
    good = np.isfinite(joint.position_cm)
    assert good.sum() >= 0.7 * PLACES
    for name in ("TBS-OR W1+QL2", "TBS-OR W2+QL2", "TBS-OR W2+CL2"):
        paper = result.errors[name]
        assert (np.isfinite(paper.position_cm) == good).all()
        assert joint.position_cm[good].mean() < paper.position_cm[good].mean()
        assert joint.rotation_deg[good].mean() < paper.rotation_deg[good].mean()


def test_both_means_agree_at_small_spreads(result):
    assert len(result.gap_deg) >= 10 * PLACES * 0.7  # selections x weights
    assert result.gap_deg.max() < 1e-3


def test_many_tags_beat_one(result):
    """The paper's first claim: JBT is behind every variant of the two biggest classes."""
    jbt, tbs = (result.errors[f"{name} W2+QL2"] for name in ("JBT", "TBS-OR"))
    assert np.nanmean(tbs.position_cm) < np.nanmean(jbt.position_cm)
