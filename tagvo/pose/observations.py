"""Joins detections with the map and the camera: what the geometric stages work on."""

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera, unproject
from tagvo.config import IntrinsicsErrorConfig
from tagvo.geometry import Array, IntArray
from tagvo.kernels.tag_residual import TagBatch, systematic_shift
from tagvo.records import Detections, ImuPoses, Observations
from tagvo.tags.tag_map import TagMap


def observe(
    det: Detections, rows: IntArray, camera: Camera, corner_px: float, camera_index: int = 0
) -> tuple[Observations, int]:
    """Undistorted observations of n detections at these rows of the map, and how many were lost.

    corner_px: sigma of corners whose detector gives none [px]. Lost: corners outside the radius
    where the distortion can be inverted.
    """
    corners_n, J_px_n, valid = unproject(camera, det.corners_px)
    sigma = np.where(np.isnan(det.sigma_px), corner_px, det.sigma_px)
    obs = Observations(rows, det.tag_id, det.corners_px, corners_n, J_px_n, sigma, camera_index)
    if valid.all():
        return obs, 0
    good = np.asarray(valid.all(axis=1))
    return obs[good], int((~good).sum())


def tag_batch(
    obs: Observations, tag_map: TagMap, camera: Camera, floor: IntrinsicsErrorConfig
) -> TagBatch:
    """The arrays that the compiled kernels take, of the n observed tags."""
    rows = obs.row
    return TagBatch(
        tag_map.R_WT[rows],
        tag_map.p_WT[rows],
        tag_map.corners_T[rows],
        tag_map.laying_sigma[rows],
        obs.corners_n,
        obs.J_px_n,
        obs.sigma_px,
        systematic_shift(
            obs.corners_px - camera.intrinsics[2:], floor.focal_rel, floor.principal_px
        ),
    )


def quad_area(corners_px: Array) -> Array:
    """Image area of quads, by the cross product of their diagonals; (n, 4, 2) -> (n,) [px^2]."""
    a, b = corners_px[:, 2] - corners_px[:, 0], corners_px[:, 3] - corners_px[:, 1]
    return np.asarray(0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]))


def to_imu_poses(
    obs: Observations, R_WC: Array, p_WC: Array, area_px: Array, tag_map: TagMap, camera: Camera
) -> ImuPoses:
    """Per-tag poses of the IMU: T_WI_i = T_WC_i T_CI (the paper's T_WB_i, problem statement).

    R_WC (n, 3, 3), p_WC (n, 3): the camera as each tag sees it; area_px (n,).
    """
    R_WI, p_WI = geo.compose(R_WC, p_WC, camera.R_CI, camera.p_CI)
    return ImuPoses(obs.tag_id, tag_map.size[obs.row], tag_map.level[obs.row], area_px, p_WI, R_WI)
