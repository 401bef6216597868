"""NEES of the joint and the fused pose over the arena: for a test and check_covariance.py."""

from dataclasses import dataclass

import numpy as np
from simulated import arena, arena_shots, nees, pinhole

from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO

JOINT_RANGE, FUSED_RANGE = (0.85, 1.15), (0.5, 2.0)  # of the mean NEES / 6
PATHS = {"joint": TagvoConfig(pose="joint"), "fused": TagvoConfig(pose="fused")}


@dataclass(frozen=True)
class Figures:
    """NEES / 6 of each frame with tags by path, (k,); frames: looked at, tagless ones included."""

    values: dict[str, np.ndarray]
    frames: int

    def mean(self, path):
        return float(self.values[path].mean())


def consistency(height, count, seed):
    """The figures of the first `count` frames that show a tag at all."""
    tag_map, camera = arena(), pinhole()
    vos = {path: TagVO(camera, tag_map, config) for path, config in PATHS.items()}
    values, frames = {path: [] for path in PATHS}, 0
    for true in arena_shots(height, 100 * count, seed, PATHS["joint"].floor):
        frames += 1
        poses = {path: vo(true.frame) for path, vo in vos.items()}
        if not len(true.frame.detections) or None in poses.values():
            continue
        for path, pose in poses.items():
            values[path].append(nees(pose, true) / 6.0)
        if len(values["joint"]) == count:
            break
    return Figures({path: np.array(v) for path, v in values.items()}, frames)
