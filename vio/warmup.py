"""Gets the compiled code ready before the first frame: the first run of a machine compiles it.

Otherwise the first frame of a run would wait for it, and its timing would say so.
"""

import numpy as np

from tagvo.camera import Camera
from tagvo.config import TagvoConfig
from tagvo.detect.filters import FilterConfig
from tagvo.families import FAMILIES
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame, PoseMeasurement
from tagvo.tagmap import map_from_dict

_SIDE_PX, _PITCH_PX = 40.0, 50.0


def warm_up(camera: Camera, config: TagvoConfig) -> PoseMeasurement | None:
    """Send four made-up tags, flat before the camera at 1 m, through the whole pipeline."""
    fu, fv, pu, pv = camera.intrinsics
    offsets = _PITCH_PX * (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) - 0.5)
    tags = [
        {"id": i, "size": float(_SIDE_PX / fu), "p": [float(u / fu), float(-v / fv), 0.0],
         "q": [1.0, 0.0, 0.0, 0.0]}
        for i, (u, v) in enumerate(offsets)
    ]  # fmt: skip
    made_up = map_from_dict({"family": next(iter(FAMILIES)), "tags": tags}, "warm-up")
    square = 0.5 * _SIDE_PX * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    corners = offsets[:, None] + square + np.array([pu, pv])
    every_tag = FilterConfig.model_validate({"min_side_px": 0.0, "edge_px": -1e6})
    vo = TagVO(camera, made_up, config.model_copy(update={"filters": every_tag}))
    frames = [Detections.of(made_up.tag_id[:n], corners[:n]) for n in (1, 4)]
    return [vo(Frame(0, detections=found)) for found in frames][-1]
