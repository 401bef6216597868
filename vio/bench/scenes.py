"""What the benchmark looks at: rendered views with their exact corners, and real photographs."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.calibration import load_camera
from tagvo.camera.model import Camera, project
from tagvo.geometry import Array, IntArray
from tagvo.records import PosePrior
from tagvo.render.view import Image, Look, exposure_poses, render_view
from tagvo.tags.tag_map import TagMap, load_map, tag_corners
from vio.config.shipped import config_path
from vio.sim.demo import camera_poses, demo_camera, demo_flight

SIZES = {"640x480": (640, 480), "1280x720": (1280, 720), "1640x1232": (1640, 1232)}
LOOKS = ("sharp", "blurred", "noisy", "dark")
PRIOR_M, PRIOR_RAD = 0.005, float(np.radians(0.3))  # what an IMU knows a frame after the last one
_SPAN_S = (1.0, 13.0)  # of the demo's flight
_NOISE = {"sharp": 2.5, "blurred": 2.5, "noisy": 12.0, "dark": 3.0}
_DARK_GAIN, _BLUR_PX, _EXPOSURE_S, _SUB_EXPOSURES = 0.25, (3.0, 6.0), 0.01, 7


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One image: image (h, w), tags that are wholly in it and their corners (n, 4, 2) [px].

    p_WC (3,) is exact; prior: as a filter would give it. A photograph's corners and pose are our
    own detector's.
    """

    image: Image
    tag_id: IntArray
    corners_px: Array
    p_WC: Array
    prior: PosePrior


def floor_and_camera(size: str) -> tuple[TagMap, Camera]:
    """The arena's floor and a camera of this many pixels with the field of view of its camera."""
    camera = demo_camera(load_camera(config_path("cameras/arena.yaml")))
    width, height = SIZES[size]
    k = width / camera.resolution[0]
    f = camera.intrinsics[:2] * k
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    bigger = replace(camera, intrinsics=np.concatenate([f, centre]), resolution=(width, height))
    return load_map(config_path("maps/arena.yaml")), bigger


def rendered(tag_map: TagMap, camera: Camera, look: str, count: int) -> Iterator[View]:
    """Views along the demo's flight, evenly in time."""
    flight, rng = demo_flight(), np.random.default_rng([LOOKS.index(look), count])
    poses = camera_poses(flight(np.linspace(*_SPAN_S, count)), camera)
    for R_WC, p_WC in zip(*poses, strict=True):
        R, p = R_WC, p_WC
        if look == "blurred":
            angle, px = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_BLUR_PX)
            speed = px * p_WC[2] / camera.intrinsics[0] / _EXPOSURE_S
            twist = np.array([speed * np.cos(angle), speed * np.sin(angle), 0.0, 0.0, 0.0, 0.0])
            R, p = exposure_poses(R_WC, p_WC, twist, _EXPOSURE_S, _SUB_EXPOSURES)
        image = render_view(
            tag_map, camera, R, p, supersample=2, noise_sigma=_NOISE[look], rng=rng,
            look=Look(texture=12.0, gain=_DARK_GAIN if look == "dark" else 1.0),
        )  # fmt: skip
        rows, corners = in_view(tag_map, camera, R_WC, p_WC)
        prior = _prior(R_WC, p_WC, rng)
        yield View(image, tag_map.tag_id[rows], corners, p_WC, prior)


def in_view(tag_map: TagMap, camera: Camera, R_WC: Array, p_WC: Array) -> tuple[IntArray, Array]:
    """Rows of the tags whose whole print is in view from its face, and their corners (n, 4, 2)."""
    R_CW, p_CW = geo.invert(R_WC, p_WC)
    outline = geo.transform(
        tag_map.R_WT[:, None], tag_map.p_WT[:, None], tag_corners(tag_map.total_size)
    )
    outer, good = project(camera, geo.transform(R_CW, p_CW, outline))
    high = np.array(camera.resolution) - 1
    inside = ((outer >= 0.0) & (outer <= high)).all(axis=-1) & good
    face = np.einsum("nj,nj->n", p_WC - tag_map.p_WT, tag_map.R_WT[:, :, 2]) > 0.0
    rows: IntArray = np.flatnonzero(inside.all(axis=1) & face)
    corners, _ = project(camera, geo.transform(R_CW, p_CW, tag_map.corners_W[rows]))
    return rows, corners


def _prior(R_WC: Array, p_WC: Array, rng: np.random.Generator) -> PosePrior:
    cov = np.diag([PRIOR_M**2] * 3 + [PRIOR_RAD**2] * 3)
    xi = np.sqrt(np.diag(cov)) * rng.standard_normal(6)
    return PosePrior(0, p_WC + xi[:3], R_WC @ geo.exp(xi[3:]), cov)


def photographs(folder: Path) -> tuple[TagMap, Camera, list[View]]:
    """The photographs of a folder with images/, camera.yaml and tagmap.yaml."""
    from tagvo.pipeline import TagVO
    from tagvo.records import Frame
    from vio.sources.flight_log.log_frames import read_image

    tag_map, camera = load_map(folder / "tagmap.yaml"), load_camera(folder / "camera.yaml")
    vo, rng, views = TagVO(camera, tag_map), np.random.default_rng(0), []
    for path in sorted((folder / "images").iterdir()):
        image = read_image(path)
        trace = None if image is None else vo.trace(Frame(0, image))
        if image is None or trace is None or trace.pose is None:
            continue
        pose, found = trace.pose, trace.observations
        prior = _prior(pose.R_WC, pose.p_WC, rng)
        views.append(View(image, found.tag_id, found.corners_px, pose.p_WC, prior))
    return tag_map, camera, views
