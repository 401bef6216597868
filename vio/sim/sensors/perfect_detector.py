"""What a perfect detector would find: exact corners of the tags in view, without an image."""

import numpy as np
from pydantic import Field, NonNegativeFloat

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import Detections
from tagvo.render.shutter import PoseAt
from tagvo.tags.tag_map import TagMap, tag_corners
from vio.sim.model import Model

_FACE_M = 1e-3  # the camera must be this far before a tag's face
_ROW_STEPS = 3  # rolling shutter: times at which a corner's row is looked up anew


class SightingConfig(Model):
    """How corners come out where no images are written."""

    sigma_px: NonNegativeFloat = Field(default=0.3, description="sigma of a corner per axis [px]")
    least_side_px: NonNegativeFloat = Field(
        default=12.0, description="tags smaller than this are not found [px]"
    )
    miss_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of the tags that are missed"
    )


def sighted(
    tag_map: TagMap,
    camera: Camera,
    pose_at: PoseAt,
    t_s: float,
    config: SightingConfig,
    rng: np.random.Generator,
    *,
    readout_s: float = 0.0,
) -> Detections:
    """Corners of the tags that lie wholly in view, with noise.

    t_s: middle of the exposure of the middle row; readout_s: from the first row to the last, each
    corner then being seen when its own row is exposed.
    """
    R_WC, p_WC = (x[0] for x in pose_at(np.array([t_s])))
    rows = _in_view(tag_map, camera, R_WC, p_WC)
    points_W = tag_map.corners_W[rows]
    pixels, _ = project(camera, _seen(R_WC, p_WC, points_W))
    if readout_s > 0.0 and len(rows):
        pixels = _row_by_row(camera, pose_at, t_s, readout_s, points_W, pixels)
    side = geo.shortest_sides(pixels)
    noise = config.sigma_px * rng.standard_normal((len(tag_map), 4, 2))[rows]
    found = (side >= config.least_side_px) & (rng.random(len(tag_map))[rows] >= config.miss_share)
    return Detections.of(tag_map.tag_id[rows][found], (pixels + noise)[found])


def _in_view(tag_map: TagMap, camera: Camera, R_WC: Array, p_WC: Array) -> IntArray:
    """Rows of the tags whose whole print, seen from its face, is within the image."""
    before = np.einsum("nj,nj->n", p_WC - tag_map.p_WT, tag_map.R_WT[:, :, 2]) > _FACE_M
    outline = geo.transform(
        tag_map.R_WT[:, None], tag_map.p_WT[:, None], tag_corners(tag_map.total_size)
    )
    pixels, good = project(camera, _seen(R_WC, p_WC, outline))
    inside: BoolArray = (pixels >= 0.0) & (pixels <= np.array(camera.resolution) - 1.0)
    return np.flatnonzero(before & (inside.all(axis=-1) & good).all(axis=-1))


def _seen(R_WC: Array, p_WC: Array, points_W: Array) -> Array:
    R_CW, p_CW = geo.invert(R_WC, p_WC)
    return geo.transform(R_CW, p_CW, points_W)


def _row_by_row(
    camera: Camera, pose_at: PoseAt, t_s: float, readout_s: float, points_W: Array, pixels: Array
) -> Array:
    """Pixels (n, 4, 2) of points, each at the time of the row that it falls on."""
    height = camera.resolution[1]
    for _ in range(_ROW_STEPS):
        rows = pixels[..., 1].ravel()
        times = t_s + (rows / (height - 1) - 0.5) * readout_s
        R_WC, p_WC = pose_at(times)
        shape = points_W.shape
        p_C = _seen(R_WC, p_WC, points_W.reshape(-1, 3))
        pixels = project(camera, p_C)[0].reshape(*shape[:-1], 2)
    return pixels
