"""Gets the compiled code ready before the first frame: the first run of a machine compiles it.

Otherwise the first frame of a run would wait for it, and its timing would say so.
"""

from dataclasses import replace

import numpy as np

from tagvo.camera.model import Camera
from tagvo.config import FilterConfig, TagvoConfig, TrackConfig
from tagvo.detect.protocol import no_detections
from tagvo.geometry import Array
from tagvo.pipeline import TagVO, Trace
from tagvo.records import Detections, Frame, PoseMeasurement, PosePrior
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import TagMap, map_from_dict
from tagvo.track import Tracker
from vio.config.filter import VioConfig
from vio.filter.eskf import ErrorStateFilter
from vio.filter.noise_model import USUAL_NOISE
from vio.records import ImuSample

_SIDE_PX, _PITCH_PX = 40.0, 50.0
_IMU_STEP_NS, _STEPS, _POSE_EVERY = 10_000_000, 150, 5  # 1.5 s at 100 Hz, poses at 20 Hz


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
    vo = TagVO(camera, made_up, config.model_copy(update={"filters": every_tag}))
    frames = [Frame(0, detections=Detections.of(made_up.tag_id[:n], corners[:n])) for n in (1, 4)]
    trace = [vo.trace(frame) for frame in frames][-1]
    if vio is not None and trace.pose is not None:
        _warm_filter(vo, frames[-1], trace, trace.pose, vio)
    return trace.pose


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
    vo: TagVO, frame: Frame, trace: Trace, pose: PoseMeasurement, config: VioConfig
) -> None:
    """Start a filter at rest and correct it both ways, late and in time; ask for its prior."""
    both = config.model_copy(update={"update": "corners"})  # it takes poses as well
    core = ErrorStateFilter(both, vo.camera, USUAL_NOISE, vo.tag_map, vo.config.floor)
    force = pose.R_WC @ vo.camera.R_CI  # R_WI: at rest it carries the IMU along z of the map
    accel = config.gravity_m_s2 * force[2]
    shift = round(vo.camera.timeshift_s * 1e9)
    for i in range(_STEPS):
        t_ns = i * _IMU_STEP_NS
        core.imu(ImuSample(t_ns, np.zeros(3), accel, t_ns))
        if i and i % _POSE_EVERY == 0:
            core.pose(replace(pose, t_ns=t_ns - shift - _IMU_STEP_NS))
    late_ns = (_STEPS - 2 * _POSE_EVERY) * _IMU_STEP_NS - shift + _IMU_STEP_NS // 2  # in between
    if trace.observations is not None:
        core.corners(late_ns, trace.observations, pose)
    prior = core.prior(late_ns)
    if prior is not None:
        asked = vo.config.model_copy(update={"ambiguity": "prior"})
        TagVO(vo.camera, vo.tag_map, asked)(replace(frame, t_ns=late_ns), prior)
