"""Rendered frames against exact projections, a second renderer, and what a shutter must obey."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from oracles.raycast import cast_slowly
from scenes import (
    CLEAN,
    LENSES,
    camera_of,
    floor_of,
    gliding,
    moving,
    picture,
    pixels_of,
    scene_of,
    still,
    tilted,
)  # fmt: skip
from simulated import DOWN

from tagvo import geometry as geo
from tagvo.detect import make_detector
from tagvo.render.scene import LensConfig
from tagvo.render.view import Look, render_view
from tagvo.tags.tag_map import map_from_dict

HEIGHT = np.array([0.02, -0.03, 0.45])
LOOK = Look(black=25.0, white=225.0, floor=128.0)


def undistorted(camera, px):
    """Normalised coordinates of pixels (n, 2), by OpenCV."""
    fu, fv, pu, pv = camera.intrinsics
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]])
    px = np.asarray(px)[:, None]
    if camera.model == "equidistant":
        return cv2.fisheye.undistortPoints(px, K, camera.coeffs)[:, 0]
    coeffs = camera.coeffs if len(camera.coeffs) else np.zeros(4)
    rough = cv2.undistortPoints(px, K, coeffs)
    for _ in range(3):  # OpenCV stops early; what is left goes away by its own projection
        back, _ = cv2.projectPoints(
            cv2.convertPointsToHomogeneous(rough), *np.zeros((2, 3)), K, coeffs
        )
        rough += (px - back) / [fu, fv]
    return rough[:, 0]


def side_points(image, a, b, reach):
    """Places where the step along a side from a to b crosses rows or columns of pixels.

    Grey is light, and light is area: the sum of the greys across a step says exactly where it is.
    """
    across = int(abs(b[0] - a[0]) > abs(b[1] - a[1]))  # 1: the side runs along x, look along y
    grid = image.T if across else image
    (u0, v0), (u1, v1) = (a[::-1], b[::-1]) if across else (a, b)
    low, high = sorted((v0, v1))
    points = []
    for v in range(int(np.ceil(low + 0.15 * (high - low))), int(high - 0.15 * (high - low))):
        u = u0 + (v - v0) / (v1 - v0) * (u1 - u0)
        first, last = int(np.floor(u - reach)), int(np.ceil(u + reach)) + 1
        strip = grid[v, first:last]
        left, right = strip[0], strip[-1]
        edge = first - 0.5 + ((strip - right) / (left - right)).sum()
        points.append((v, edge) if across else (edge, v))
    return np.array(points)


def fitted_corners(image, camera, near_px, reach):
    """Corners of a tag's black square, normalised: where lines fitted to its sides meet."""
    lines = []
    for k in range(4):
        points = undistorted(camera, side_points(image, near_px[k], near_px[(k + 1) % 4], reach))
        middle = points.mean(axis=0)
        normal = np.linalg.svd(points - middle)[2][1]
        lines.append([*normal, -normal @ middle])
    corners = [np.cross(lines[k - 1], lines[k]) for k in range(4)]
    return np.array([c[:2] / c[2] for c in corners])


@pytest.mark.parametrize("model", LENSES)
def test_edges_meet_where_the_projection_has_the_corners(model):
    camera, tag_map = camera_of(model, 640, 480), floor_of(4, 0.1, 0.16, "tag36h11")
    scene, rng, errors = scene_of(tag_map), np.random.default_rng(3), []
    for _ in range(3):
        R, p = tilted(rng.normal(size=3) * [0.15, 0.15, 2.0]), HEIGHT + 0.03 * rng.normal(size=3)
        image = picture(scene, camera, still(R, p))
        exact = pixels_of(camera, R, p, tag_map.corners_W)
        for quad in exact[((exact > 20) & (exact < [620, 460])).all(axis=(1, 2))]:
            cell = np.linalg.norm(quad - np.roll(quad, 1, axis=0), axis=1).min() / 8
            found = fitted_corners(image, camera, quad, 0.55 * cell)
            errors.append((found - undistorted(camera, quad)) * camera.intrinsics[:2])
    assert len(errors) >= 8
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.01
    assert np.abs(errors).max() < 0.1


@pytest.mark.parametrize("model", LENSES)
def test_the_detector_finds_corners_within_a_twentieth_of_a_pixel(model):
    camera, tag_map = camera_of(model, 640, 480), floor_of(12, 0.04, 0.086)
    scene, rng, errors = scene_of(tag_map), np.random.default_rng(5), []
    detector = make_detector("apriltag", tag_map.family)
    for _ in range(4):  # small tags: the detector takes sides for straight that the lens bends
        R = tilted(rng.normal(size=3) * [0.12, 0.12, 2.0])
        p = np.array([0.0, 0.0, 0.55]) + 0.05 * rng.normal(size=3)
        found = detector.detect(picture(scene, camera, still(R, p)).astype(np.uint8))
        exact = pixels_of(camera, R, p, tag_map.corners_W[tag_map.rows(found.tag_id)])
        errors.append(found.corners_px - exact)
    errors = np.concatenate(errors)
    assert len(errors) >= 100
    assert np.sqrt(np.mean(errors**2)) < 0.05
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.01


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize(
    ("rotvec", "p_WC"),
    [
        ([0.0, 0.0, 0.3], [0.02, -0.03, 0.45]),
        ([0.5, -0.4, 1.0], [0.05, 0.1, 0.3]),
        ([1.25, 0.0, 0.0], [0.0, -0.3, 0.1]),  # along the floor: tags behind, aside, far away
        ([0.2, 0.1, 0.0], [0.0, 0.0, 0.03]),  # a tag larger than the view
    ],
)
def test_a_clean_frame_is_what_a_slow_ray_caster_sees(model, rotvec, p_WC):
    camera = camera_of(model, 64, 48)
    scene = scene_of(floor_of(), laying_scale=3.0)  # they even overlap
    R, p = DOWN @ geo.exp(np.array(rotvec)), np.array(p_WC)
    cast = cast_slowly(scene.tag_map, camera, R, p, LOOK, fine=9)
    error = picture(scene, camera, still(R, p)) - cast
    assert cast.std() > 20.0
    assert np.sqrt(np.mean(error**2)) < 4.0  # 81 rays leave 3; a shift by 1/4 px makes 12
    assert np.abs(error.mean()) < 0.3


@pytest.mark.parametrize("model", LENSES)
def test_a_clean_frame_is_what_the_other_renderer_draws(model):
    camera, scene = camera_of(model), scene_of(floor_of())
    R, p = tilted((0.4, -0.3, 0.7)), np.array([0.02, -0.03, 0.45])
    drawn = render_view(scene.tag_map, camera, R, p, look=LOOK, supersample=8).astype(float)
    error = picture(scene, camera, still(R, p), LensConfig(supersample=12)) - drawn
    assert drawn.std() > 40.0
    assert np.sqrt(np.mean(error**2)) < 1.8  # 64 rays leave 1.6
    assert np.abs(error).max() < 30.0  # a slip of a whole cell would be 200
    slopes = np.stack([g.ravel() for g in np.gradient(drawn)], axis=1)
    shift_px = np.linalg.lstsq(slopes, error.ravel(), rcond=None)[0]
    assert np.abs(shift_px).max() < 1e-3


def test_the_nearer_surface_is_seen_whatever_the_order():
    camera, (high, low) = camera_of(), (0.1, 0.0)
    pose = still(tilted(), np.array([0.0, 0.0, 0.6]))
    tags = [{"id": 0, "size": 0.1, "p": [0, 0, high], "q": [1, 0, 0, 0]},
            {"id": 1, "size": 0.3, "p": [0.1, 0, low], "q": [1, 0, 0, 0]}]  # fmt: skip
    both = [map_from_dict({"family": "tag36h11", "tags": t}, "two") for t in (tags, tags[::-1])]
    one, other = (picture(scene_of(m), camera, pose) for m in both)
    np.testing.assert_array_equal(one, other)
    drawn = render_view(both[0], camera, tilted(), np.array([0.0, 0.0, 0.6]), supersample=8)
    assert np.sqrt(np.mean((one - drawn) ** 2)) < 2.0


def test_of_tags_that_overlap_the_upper_one_shows_from_everywhere():
    tags = [{"id": i, "size": 0.1, "p": [0.11 * i, 0.02 * i, 0.002 * (i == 1)], "q": [1, 0, 0, 0]}
            for i in range(3)]  # fmt: skip
    tag_map = map_from_dict({"family": "tag36h11", "tags": tags}, "pile")
    alone, camera = tag_map.only(np.array([1])), camera_of("none")
    for x in (-0.05, 0.1, 0.25):  # the nearest middle is another's each time
        R, p = tilted((0.1, 0.0, 0.2)), np.array([x, 0.05, 0.6])
        quad = pixels_of(camera, R, p, alone.corners_W[0] * 1.2 - alone.p_WT[0] * 0.2)
        inside = np.zeros((240, 320), np.uint8)
        cv2.fillConvexPoly(inside, np.rint(quad).astype(int), 1)
        inside = cv2.erode(inside, np.ones((5, 5))) > 0
        assert inside.sum() > 500
        seen = picture(scene_of(tag_map), camera, still(R, p))[inside]
        np.testing.assert_array_equal(seen, picture(scene_of(alone), camera, still(R, p))[inside])


def test_blur_is_the_mean_of_the_instants():
    camera, scene = camera_of(), scene_of(floor_of())
    pose = moving(tilted(), HEIGHT, (0.3, -0.2, 1.0), (0.8, 0.3, 0.2))
    lens = LensConfig(exposure_s=0.016, sub_exposures=8)
    times = ((np.arange(8) + 0.5) / 8 - 0.5) * lens.exposure_s
    blurred = picture(scene, camera, pose, lens)
    instants = [picture(scene, camera, pose, t_s=t) for t in times]
    error = blurred - np.mean(instants, axis=0)
    assert np.sqrt(np.mean(error**2)) < 0.7  # each instant is rounded to whole greys
    assert np.abs(error).max() < 6.0  # one sample of 64 in one of eight instants: 0.4
    assert np.abs(blurred - instants[4]).mean() > 10.0


def test_the_blur_that_the_motion_asks_for_is_the_limit_of_many_instants():
    camera, scene = camera_of(), scene_of(floor_of(), laying_scale=1.0)
    pose = moving(tilted(), HEIGHT, (0.3, -0.2, 1.0), (0.8, 0.3, 0.2))
    limit = picture(scene, camera, pose, LensConfig(exposure_s=0.016, sub_exposures=48))
    error = picture(scene, camera, pose, LensConfig(exposure_s=0.016)) - limit
    assert np.sqrt(np.mean(error**2)) < 1.5
    few = picture(scene, camera, pose, LensConfig(exposure_s=0.016, sub_exposures=3)) - limit
    assert np.sqrt(np.mean(few**2)) > 3.0 * np.sqrt(np.mean(error**2))


def shaking(R_WC, p_WC):
    """A camera that vibrates at 130 Hz by 0.1 degrees, which straight lines do not follow."""

    def pose_at(t):
        wave = np.sin(2 * np.pi * 130.0 * t)[:, None] * np.radians([0.1, 0.07, 0.0])
        return R_WC @ geo.exp(wave + t[:, None] * [0.5, 0.3, 1.0]), p_WC + t[:, None] * [0.5, 0, 0]

    return pose_at


@pytest.mark.parametrize("way", [gliding, shaking])
def test_each_row_is_seen_at_its_own_time(way):
    camera, scene = camera_of(width=640, height=480), scene_of(floor_of(), laying_scale=1.0)
    pose, readout = way(tilted(), HEIGHT), 0.03
    rolling = picture(scene, camera, pose, LensConfig(readout_s=readout), t_s=0.2)
    rows, shift = np.arange(20, 480, 73), []
    for row in rows:
        t = 0.2 + (row / 479 - 0.5) * readout
        instant = picture(scene, camera, pose, t_s=t)[row]
        shift.append(np.abs(rolling[row] - instant).mean() / np.abs(np.diff(instant)).mean())
    assert np.max(shift) < 0.05  # greys by greys per pixel: a row's shift in pixels
    whole = picture(scene, camera, pose, t_s=0.2)
    assert np.abs(rolling - whole)[[0, -1]].mean() > 20.0
    assert np.abs(rolling - whole)[[239, 240]].mean() < 2.0


def test_rows_expose_one_after_the_other_and_blur_alike():
    camera, scene = camera_of(), scene_of(floor_of())
    pose = shaking(tilted(), HEIGHT)
    lens = LensConfig(exposure_s=0.008, readout_s=0.02)
    rolling = picture(scene, camera, pose, lens, t_s=0.1)
    for row in (5, 120, 230):
        t = 0.1 + (row / 239 - 0.5) * lens.readout_s
        own = picture(scene, camera, pose, LensConfig(exposure_s=0.008), t_s=t)[row]
        assert np.abs(rolling[row] - own).mean() < 1.5


def test_a_wall_passing_by_blurs_as_well():
    q = [float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0]  # T's z along -y of W
    tags = [{"id": i, "size": 0.1, "p": [0.2 * i - 0.5, 1.0, 1.5], "q": q} for i in range(6)]
    scene = scene_of(map_from_dict({"family": "tag36h11", "tags": tags}, "wall"))
    R_WC = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # looks along y
    pose = moving(R_WC, np.array([0.0, 0.0, 1.5]), v_W=(1.0, 0.0, 0.0))
    lens = LensConfig(exposure_s=0.02)
    error = picture(scene, camera_of(), pose, lens) - picture(
        scene, camera_of(), pose, LensConfig(exposure_s=0.02, sub_exposures=40)
    )
    assert np.sqrt(np.mean(error**2)) < 1.0
    sharp = picture(scene, camera_of(), pose)
    assert sharp.std() > 20.0
    assert np.abs(picture(scene, camera_of(), pose, lens) - sharp).mean() > 2.0


def test_a_tag_that_comes_into_view_during_the_frame_is_whole():
    camera, scene = camera_of(), scene_of(floor_of(2, 0.1, 0.2))
    pose = moving(tilted((0, 0, 0.1)), np.array([0.42, 0.0, 0.5]), v_W=(-3.0, 0.0, 0.0))
    rolling = picture(scene, camera, pose, LensConfig(readout_s=0.06))
    for row in (3, 60, 120, 200, 236):
        t = (row / 239 - 0.5) * 0.06
        np.testing.assert_allclose(
            rolling[row].mean(), picture(scene, camera, pose, t_s=t)[row].mean(), atol=0.3
        )
    assert rolling[200].std() > 20.0


FULL = {
    "laying_scale": 1.0, "hidden_share": 0.1, "torn_share": 0.1,
    "occluders": {"count": 3, "size_m": 0.05}, "texture": {"kind": "concrete"},
    "light": {"hot_spot_share": 0.5, "gradient_share": 0.2, "flicker_share": 0.2},
    "glare": {"peak_grey": 200.0}, "shadow": {"darkness_share": 0.5},
}  # fmt: skip
REAL = LensConfig(
    exposure_s=0.006, readout_s=0.02, defocus_px=0.8, vignetting=0.3, full_well_e=8000,
    read_noise_grey=1.5, gamma=2.2, jpeg_quality=90,
)  # fmt: skip


def test_the_same_seed_makes_the_same_bytes_in_any_thread():
    camera, pose = camera_of(), shaking(tilted(), HEIGHT)
    scene = scene_of(floor_of(4), seed=4, **FULL)
    with ThreadPoolExecutor(2) as pool:
        shots = [pool.submit(picture, scene, camera, pose, REAL, seed=s) for s in (7, 7, 8)]
        one, two, other = (shot.result() for shot in shots)
    np.testing.assert_array_equal(one, two)
    assert 0.5 < (one - other).std() < 8.0  # another noise over the same scene


def test_where_the_lens_has_no_inverse_there_is_no_light():
    from tagvo.camera.model import Camera

    wild = Camera("radtan", np.array([60.0, 60, 79.5, 59.5]), np.array([-0.4, 0, 0, 0]), (160, 120))
    image = picture(scene_of(floor_of()), wild, still(DOWN, np.array([0.0, 0.0, 0.8])))
    assert image[0, 0] == 0
    assert image[60, 80] > 0


def test_a_face_seen_from_behind_is_not_seen():
    image = picture(scene_of(floor_of()), camera_of(), still(np.eye(3), np.array([0, 0, -0.8])))
    assert (image == 128).all()


def test_defaults_are_a_clean_world():
    assert LensConfig() == CLEAN
    scene = scene_of(floor_of())
    np.testing.assert_array_equal(scene.tag_map.p_WT, floor_of().p_WT)
    image = picture(scene, camera_of(), still(tilted(), np.array([0.0, 0.0, 0.05])))
    assert set(np.unique(image)) >= {25.0, 225.0}
    assert image.min() == 25.0
    assert image.max() == 225.0
