"""Frames over the arena by exact projection: corners, and what is wrong with them, drawn anew.

The truth of the statistical tests and of tools/check_covariance.py and tools/bench_vo.py.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.config import IntrinsicsErrorConfig
from tagvo.records import Detections, Frame
from tagvo.render.view import displaced
from tagvo.tags.tag_map import TagMap, load_map, map_from_dict, tag_corners

DOWN = np.diag([1.0, -1.0, -1.0])  # R_WC of a camera that looks straight down
ARENA = Path(__file__).parents[1] / "configs" / "maps" / "arena.yaml"
HEIGHTS = (0.5, 0.8, 1.4, 2.0)
_FACE = 0.05  # m; a tag is visible from this far above its plane


def arena() -> TagMap:
    return load_map(ARENA)


def pinhole(f=530.0, width=640, height=480, **keys) -> Camera:
    centre = [(width - 1) / 2, (height - 1) / 2]
    return Camera("none", np.array([f, f, *centre]), np.zeros(0), (width, height), **keys)


def grid_map(n=3, size=0.1, pitch=0.2, **keys) -> TagMap:
    """n x n tags of one size (or of the sizes given, in turn) around the origin, face up."""
    sizes = np.resize(np.atleast_1d(size), n * n)
    tags = []
    for i in range(n * n):
        p = [pitch * (i % n - (n - 1) / 2), pitch * (i // n - (n - 1) / 2), 0.0]
        tags.append({"id": i, "size": float(sizes[i]), "p": p, "q": [1.0, 0.0, 0.0, 0.0]})
    return map_from_dict({"family": "tag36h11", "tags": tags, **keys}, "grid")


def pose_above(rng, height, low, high, tilt_deg=4.0):
    """Camera pose R_WC, p_WC looking down from a place uniform over a rectangle [m]."""
    tilt = np.radians(tilt_deg) * rng.standard_normal(2)
    R_WC = DOWN @ geo.exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
    p = np.array([*rng.uniform(low, high), height])
    return R_WC @ geo.exp(np.array([*tilt, 0.0])), p


def corners_seen(tag_map, camera, R_WC, p_WC, margin_px=0.0):
    """Rows of the tags wholly in view, and the pixels (n, 4, 2) of all their border corners."""
    R_CW, p_CW = geo.invert(R_WC, p_WC)
    outline = geo.transform(
        tag_map.R_WT[:, None], tag_map.p_WT[:, None], tag_corners(tag_map.total_size)
    )
    outer, good = project(camera, geo.transform(R_CW, p_CW, outline))
    pixels, _ = project(camera, geo.transform(R_CW, p_CW, tag_map.corners_W))
    high = np.array(camera.resolution) - 1 - margin_px
    inside = ((outer >= margin_px) & (outer <= high)).all(axis=-1) & good
    above = np.einsum("nj,nj->n", p_WC - tag_map.p_WT, tag_map.R_WT[:, :, 2]) > _FACE
    return np.flatnonzero(inside.all(axis=1) & above), pixels


def wrong_camera(camera, floor: IntrinsicsErrorConfig, rng) -> Camera:
    """The camera as it might really be: focal length and principal point drawn from the floor."""
    shift = rng.standard_normal(3) * [floor.focal_rel, floor.principal_px, floor.principal_px]
    f, c = camera.intrinsics[:2] * (1.0 + shift[0]), camera.intrinsics[2:] + shift[1:]
    return replace(camera, intrinsics=np.concatenate([f, c]))


@dataclass(frozen=True)
class Shot:
    """One simulated frame with its truth."""

    frame: Frame
    R_WC: np.ndarray
    p_WC: np.ndarray


def shot(tag_map, camera, R_WC, p_WC, rng, *, noise_px=0.3, floor=None, lay=True, t_ns=0):
    """A frame of the map as it might lie through the camera as it might be, with corner noise."""
    real_map = displaced(tag_map, rng) if lay else tag_map
    real_camera = wrong_camera(camera, floor, rng) if floor is not None else camera
    rows, pixels = corners_seen(real_map, real_camera, R_WC, p_WC)
    noisy = pixels[rows] + noise_px * rng.standard_normal((len(rows), 4, 2))
    return Shot(Frame(t_ns, detections=Detections.of(tag_map.tag_id[rows], noisy)), R_WC, p_WC)


def error_of(p_WC, R_WC, true: Shot):
    """[dp in W, right rotation in C] of a pose; (6,)."""
    return np.concatenate([p_WC - true.p_WC, geo.log(true.R_WC.T @ R_WC)])


def nees(pose, true: Shot) -> float:
    """Squared Mahalanobis distance of a PoseMeasurement to the truth; 6 is expected."""
    error = error_of(pose.p_WC, pose.R_WC, true)
    return float(error @ np.linalg.solve(pose.cov, error))


def arena_shots(height, count, seed, floor, noise_px=0.3):
    """`count` frames at places uniform over the arena, everything redrawn for each."""
    tag_map, camera = arena(), pinhole()
    low, high = tag_map.p_WT[:, :2].min(axis=0), tag_map.p_WT[:, :2].max(axis=0)
    rng = np.random.default_rng(seed)
    for k in range(count):
        R_WC, p_WC = pose_above(rng, height, low, high)
        yield shot(tag_map, camera, R_WC, p_WC, rng, noise_px=noise_px, floor=floor, t_ns=k)
