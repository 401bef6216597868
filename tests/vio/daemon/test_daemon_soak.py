"""A short form of tools/soak.py: nothing is lost, memory stays."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[2] / "oracles"))

from soak_flight import soak

SECONDS = 12


def test_nothing_is_lost_and_memory_is_flat(tmp_path):
    done = soak(tmp_path, SECONDS)
    assert done.imu_total > 50 * SECONDS, "the autopilot kept up, more or less"
    assert done.missing_imu() <= 2, "samples on their way when the status was written"
    assert done.missing_poses() == 0
    status, counters = done.status, done.status["counters"]
    let_go = [counters.get(k, 0) for k in ("frames_skipped", "queue_dropped_frames")]
    waiting = counters["frames"] - status["counts"]["frames"] - sum(let_go)
    assert -2 <= waiting <= 12, "every frame is looked at, counted as let go, or on its way"
    uncalled_for = ("queue_dropped_imu", "faults", "record")
    assert not {k for k in done.lost() if any(word in k for word in uncalled_for)}
    assert done.fused >= 0.8 * done.got > 0
    assert done.growth_mb(SECONDS // 2) < 5.0
