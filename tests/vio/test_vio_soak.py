"""A short form of tools/soak.py: nothing is lost, memory stays."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "oracles"))

from soak_flight import soak

SECONDS = 12


def test_nothing_is_lost_and_memory_is_flat(tmp_path):
    done = soak(tmp_path, SECONDS)
    assert done.imu_total > 50 * SECONDS, "the autopilot kept up, more or less"
    assert done.missing_imu() <= 2, "samples on their way when the status was written"
    assert done.missing_poses() == 0
    status, counters = done.status, done.status["counters"]
    known = status["counts"]["frames"] + counters.get("frames_skipped", 0)
    assert 0 < known <= counters["frames"]  # what waits between them, tools/soak.py shows
    assert not {k for k in done.lost() if "queue" in k or "faults" in k or "record" in k}
    assert done.fused >= 0.8 * done.got > 0
    assert done.growth_mb(SECONDS // 2) < 5.0
