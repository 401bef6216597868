"""Cameras and ways of moving over a floor of tags, for the tests of the renderer."""

import numpy as np
from simulated import DOWN

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.render.frame import render_frame
from tagvo.render.scene import LensConfig, SceneConfig, make_scene
from tagvo.tags.tag_map import map_from_dict

LENSES = {
    "none": ([530.0, 530.0, 319.5, 239.5], []),
    "radtan": ([530.0, 528.0, 322.1, 236.2], [-0.18, 0.05, 1e-3, -5e-4]),
    "equidistant": ([400.0, 401.0, 318.0, 241.3], [-0.01, 0.02, -0.01, 0.002]),
}
CLEAN = LensConfig()


def camera_of(model="radtan", width=320, height=240) -> Camera:
    """The lens at any resolution; the view is that of 640 x 480."""
    intrinsics, coeffs = LENSES[model]
    scale = width / 640
    return Camera(model, np.array(intrinsics) * scale, np.array(coeffs), (width, height))


def floor_of(n=6, size=0.06, pitch=0.12, family="tagStandard41h12", **keys):
    """n x n tags face up around the origin, each turned by a multiple of 90 degrees."""
    tags = []
    for i in range(n * n):
        yaw = np.pi / 2 * (i * 7 % 4)
        p = [pitch * (i % n - n / 2 + 0.5), pitch * (i // n - n / 2 + 0.5), 0.0]
        q = [float(np.cos(yaw / 2)), 0.0, 0.0, float(np.sin(yaw / 2))]
        tags.append({"id": i, "size": size, "p": p, "q": q})
    return map_from_dict({"family": family, "tags": tags, **keys}, "floor")


def scene_of(tag_map, seed=0, **config):
    return make_scene(tag_map, SceneConfig.model_validate(config), np.random.default_rng(seed))


def still(R_WC, p_WC):
    """A camera at rest."""
    return lambda t: (np.broadcast_to(R_WC, (len(t), 3, 3)), np.broadcast_to(p_WC, (len(t), 3)))


def moving(R_WC, p_WC, rate_C=(0.0, 0.0, 0.0), v_W=(0.0, 0.0, 0.0)):
    """A camera that is at R_WC, p_WC at t = 0 and turns and moves evenly."""
    w, v = np.array(rate_C, dtype=float), np.array(v_W, dtype=float)
    return lambda t: (R_WC @ geo.exp(t[:, None] * w), p_WC + t[:, None] * v)


def gliding(R_WC, p_WC):
    """An even motion, turning and moving along every axis."""
    return moving(R_WC, p_WC, (0.5, 0.3, 1.0), (0.8, 0.3, 0.2))


def tilted(rotvec=(0.05, -0.08, 0.3)):
    return DOWN @ geo.exp(np.array(rotvec, dtype=float))


def picture(scene, camera, pose_at, lens=CLEAN, t_s=0.0, seed=0):
    """A frame as floats."""
    rng = np.random.default_rng(seed)
    return render_frame(scene, camera, pose_at, t_s, lens, rng).astype(float)


def pixels_of(camera, R_WC, p_WC, points_W):
    """Exact projection of points (..., 3)."""
    R_CW, p_CW = geo.invert(R_WC, p_WC)
    return project(camera, geo.transform(R_CW, p_CW, points_W))[0]
