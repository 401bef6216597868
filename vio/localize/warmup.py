"""Gets the compiled code ready before the first frame: the first run of a machine compiles it.

Otherwise the first frame of a run would wait for it, and its timing would say so.
"""

from dataclasses import replace

import numpy as np

from tagvo.camera.model import Camera
from tagvo.config import FilterConfig, TagvoConfig, TrackConfig
from tagvo.detect.protocol import no_detections
from tagvo.geometry import Array
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame, PoseMeasurement, PosePrior
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import TagMap, map_from_dict
from tagvo.track import Tracker
from vio.config import Config
from vio.config.filter import VioConfig
from vio.localize.localizer import Localizer
from vio.records import ImuSample

_SIDE_PX, _PITCH_PX = 40.0, 50.0
_IMU_STEP_NS, _STEPS, _FRAME_EVERY = 10_000_000, 150, 5  # 1.5 s at 100 Hz, frames at 20 Hz
_LATE_NS = 15_000_000  # a frame falls between two samples, and is known after both


def warm_up(
    camera: Camera, config: TagvoConfig, vio: VioConfig | None = None
) -> PoseMeasurement | None:
    """Send four made-up tags, flat before the camera at 1 m, through the whole pipeline.

    vio: and through the filter with this configuration, None: tagvo alone.
    """
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
    config = config.model_copy(update={"filters": every_tag})
    vo = TagVO(camera, made_up, config)
    frames = [Frame(0, detections=Detections.of(made_up.tag_id[:n], corners[:n])) for n in (1, 4)]
    pose = [vo(frame) for frame in frames][-1]
    if vio is not None and pose is not None:
        _warm_filter(vo, frames[-1], pose, config, vio)
    return pose


def warm_all(
    tag_map: TagMap, camera: Camera, config: TagvoConfig, vio: VioConfig | None = None
) -> None:
    """All that a run with these settings needs; vio as in `warm_up`."""
    warm_up(camera, config, vio)
    if config.track.mode == "on":
        warm_tracker(tag_map, camera, config.track)


def warm_tracker(tag_map: TagMap, camera: Camera, config: TrackConfig | None = None) -> None:
    """Track a picture of nothing, so that the tracker's code is there before the first frame."""
    width, height = camera.resolution
    image = np.zeros((height, width), dtype=np.uint8)
    middle = tag_map.p_WT.mean(axis=0)
    nearest = int(np.argmin(np.linalg.norm(tag_map.p_WT - middle, axis=1)))
    R_WC = tag_map.R_WT[nearest] @ np.diag([1.0, -1.0, -1.0])
    p_WC = tag_map.p_WT[nearest] + 4.0 * tag_map.size[nearest] * tag_map.R_WT[nearest][:, 2]
    prior = PosePrior(0, p_WC, R_WC, 1e-6 * np.eye(6))
    tracker = Tracker(camera, tag_map, config or TrackConfig(mode="on"))
    tracker(image, 0, prior, lambda *_: no_detections())
    tracker.decimate(prior, 0, largest_only=False)


def warm_renderer(tag_map: TagMap, camera: Camera) -> None:
    """Draw a picture with a floor of wood, torn tags, objects and motion: `simulate`'s code."""
    from tagvo.render.config import LensConfig, OccluderConfig, SceneConfig, TextureConfig
    from tagvo.render.frame import (
        render_frame,  # here: a daemon that restarts in flight draws nothing
    )
    from tagvo.render.scene import make_scene

    objects = OccluderConfig(count=3, size_m=0.2)
    config = SceneConfig(texture=TextureConfig(kind="wood"), torn_share=0.5, occluders=objects)
    above = tag_map.p_WT.mean(axis=0) + np.array([0.0, 0.0, 1.0])

    def pose_at(t_s: Array) -> tuple[Array, Array]:
        R_WC = np.tile(np.diag([1.0, -1.0, -1.0]), (len(t_s), 1, 1))
        return R_WC, above + t_s[:, None] * np.array([0.5, 0.0, 0.0])

    rng = np.random.default_rng(0)
    scene = make_scene(tag_map, config, rng)
    for lens in (LensConfig(), LensConfig(exposure_s=0.006, readout_s=0.02)):
        render_frame(scene, camera, pose_at, 0.0, lens, rng)


def _warm_filter(
    vo: TagVO, frame: Frame, pose: PoseMeasurement, tagvo: TagvoConfig, vio: VioConfig
) -> None:
    """Fly a localizer at rest above the tags of a frame: both updates, one of them late."""
    config = Config(
        tagvo=tagvo.model_copy(update={"ambiguity": "prior"}),  # each frame asks the filter
        vio=vio.model_copy(update={"update": "corners"}),  # it starts from poses as well
    )
    localizer = Localizer(vo.camera, vo.tag_map, config)
    force = pose.R_WC @ vo.camera.R_CI  # R_WI: at rest it carries the IMU along z of the map
    accel = vio.gravity_m_s2 * force[2]
    shift_ns = round(vo.camera.timeshift_s * 1e9) + _LATE_NS
    for i in range(_STEPS):
        t_ns = i * _IMU_STEP_NS
        localizer.process(ImuSample(t_ns, np.zeros(3), accel, t_ns))
        if i and i % _FRAME_EVERY == 0:
            localizer.process(replace(frame, t_ns=t_ns - shift_ns, arrival_ns=t_ns))
