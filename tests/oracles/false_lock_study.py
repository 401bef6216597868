"""Does the tracker ever report a tag where it is not? Wrong priors, moved, hidden, repeated tags.

The truth is the scene that was rendered: where each printed tag really lies in the image.
"""

from collections import Counter
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from simulated import arena, corners_seen, pinhole, pose_above

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.config import TrackConfig
from tagvo.detect.protocol import no_detections
from tagvo.records import PosePrior
from tagvo.render.view import Look, exposure_poses, render_view
from tagvo.tags.tag_map import TagMap
from tagvo.track import Tracker

SCENES = ("clean", "moved", "hidden", "repeated", "blurred", "noisy", "dark", "mosaic")
OFF_PX = 2.0
MAX_PX, MAX_DEG = 40.0, 10.0  # how wrong priors may be


def lens() -> Camera:
    """640x480 with the distortion of a common wide lens."""
    return replace(pinhole(), model="radtan", coeffs=np.array([-0.18, 0.05, 0.001, -0.0005]))


@dataclass
class Tally:
    """frames, tracked frames, tags reported, tags off, by scene; worst [px] of all."""

    frames: Counter[str] = field(default_factory=Counter)
    tracked: Counter[str] = field(default_factory=Counter)
    tags: Counter[str] = field(default_factory=Counter)
    off: Counter[str] = field(default_factory=Counter)
    misled: Counter[str] = field(default_factory=Counter)
    causes: Counter[str] = field(default_factory=Counter)
    worst_px: float = 0.0


def disturbed(tag_map: TagMap, scene: str, rng: np.random.Generator) -> TagMap:
    """The floor as it lies: some tags moved by centimetres, or replaced by copies of others."""
    n = len(tag_map)
    if scene == "moved":
        some = rng.random(n) < rng.uniform(0.05, 0.6)
        shift = rng.uniform(-0.06, 0.06, (n, 3)) * [1.0, 1.0, 0.0]
        turn = geo.exp(rng.uniform(-0.5, 0.5, (n, 1)) * [0.0, 0.0, 1.0])
        p = np.where(some[:, None], tag_map.p_WT + shift, tag_map.p_WT)
        R = np.where(some[:, None, None], tag_map.R_WT @ turn, tag_map.R_WT)
        return replace(tag_map, p_WT=p, R_WT=R)
    if scene == "repeated":  # within a size the same few ids again and again
        ids = tag_map.tag_id.copy()
        for size in tag_map.classes:
            rows = np.flatnonzero(np.isclose(tag_map.size, size))
            ids[rows] = rng.choice(tag_map.tag_id[rows], 3)[rng.integers(0, 3, len(rows))]
        return replace(tag_map, tag_id=ids)
    return tag_map


def picture(floor: TagMap, camera: Camera, R_WC, p_WC, scene: str, rng) -> np.ndarray:
    """The image of a scene."""
    look, noise, R, p = Look(texture=12.0), 2.5, R_WC, p_WC
    if scene == "dark":
        look, noise = Look(texture=12.0, gain=0.18), 3.0
    if scene == "noisy":
        noise = 15.0
    if scene == "blurred":
        a, px = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 8.0)
        speed = px * p_WC[2] / camera.intrinsics[0] / 0.01
        twist = np.array([speed * np.cos(a), speed * np.sin(a), 0.0, 0.0, 0.0, 0.0])
        R, p = exposure_poses(R_WC, p_WC, twist, 0.01, 7)
    image = render_view(floor, camera, R, p, look=look, supersample=2, noise_sigma=noise, rng=rng)
    if scene == "hidden":
        for _ in range(rng.integers(2, 12)):
            points = rng.uniform([0, 0], [640, 480]) + rng.uniform(-90, 90, (4, 2))
            hull = cv2.convexHull(points.astype(np.int32))
            cv2.fillConvexPoly(image, hull, int(rng.integers(0, 256)))
    if scene == "mosaic":  # a raw Bayer image taken for a grey one
        image = image.copy()
        image[::2, ::2] = image[::2, ::2] * 0.6
        image[1::2, 1::2] = image[1::2, 1::2] * 0.5
    return image


def prior_near(R_WC, p_WC, rng, focal_px: float) -> PosePrior:
    """A prior, half of the time as wrong as it says, else wrong by up to 40 px and 10 deg."""
    sigma_px = 10.0 ** rng.uniform(-0.3, 1.1)
    s_m, s_rad = 0.7 * sigma_px * p_WC[2] / focal_px, 0.7 * sigma_px / focal_px
    cov = np.diag([s_m**2] * 3 + [s_rad**2] * 3)
    if rng.random() < 0.5:
        xi = np.sqrt(np.diag(cov)) * rng.standard_normal(6)
    else:
        m = MAX_PX * p_WC[2] / focal_px
        xi = np.concatenate([rng.uniform(-m, m, 3), np.zeros(3)])
        axis = rng.standard_normal(3)
        if rng.random() < 0.5:
            xi[3:] = axis / np.linalg.norm(axis) * np.radians(rng.uniform(0.0, MAX_DEG))
    return PosePrior(0, p_WC + xi[:3], R_WC @ geo.exp(xi[3:]), cov)


def study(images: int, priors: int, seed: int, step=lambda: None) -> Tally:
    """`images` scenes with so many priors each; the tracker alone, its detector finds nothing."""
    tag_map, camera, tally = arena(), lens(), Tally()
    tracker = Tracker(camera, tag_map, TrackConfig(mode="on", sweep_s=0.0))
    low, high = tag_map.p_WT[:, :2].min(axis=0), tag_map.p_WT[:, :2].max(axis=0)
    for k in range(images):
        rng = np.random.default_rng([seed, k])
        scene = SCENES[k % len(SCENES)]
        R_WC, p_WC = pose_above(rng, rng.uniform(0.4, 2.2), low, high)
        floor = disturbed(tag_map, scene, rng)
        image = picture(floor, camera, R_WC, p_WC, scene, rng)
        p_C = geo.transform(*geo.invert(R_WC, p_WC), floor.corners_W.reshape(-1, 3))
        real = project(camera, p_C)[0].reshape(-1, 4, 2)
        _, mapped = corners_seen(tag_map, camera, R_WC, p_WC)
        for _ in range(priors):
            prior = prior_near(R_WC, p_WC, rng, camera.intrinsics[0])
            got = tracker(image, 0, prior, lambda *_: no_detections())
            tally.frames[scene] += 1
            tally.causes.update(got.counts)
            if got.detections is not None:
                tally.tracked[scene] += 1
                _judge(tally, scene, got.detections, floor, tag_map, real, mapped)
        step()
    return tally


def _judge(tally, scene, found, floor, tag_map, real, mapped) -> None:
    """Each tag reported against the nearest place where a tag of that id really lies."""
    for tag_id, corners in zip(found.tag_id.tolist(), found.corners_px, strict=True):
        places = real[floor.tag_id == tag_id]
        apart = [float(np.linalg.norm(q - corners, axis=1).max()) for q in places]
        off = min(apart, default=np.inf)
        tally.tags[scene] += 1
        tally.worst_px = max(tally.worst_px, off)
        if off > OFF_PX:
            tally.off[scene] += 1
        home = mapped[tag_map.rows(np.array([tag_id]))[0]]
        if np.linalg.norm(home - corners, axis=1).max() > OFF_PX:
            tally.misled[scene] += 1
