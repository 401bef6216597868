"""Rendered views against exact projections, a slow ray caster and the detectors' own corners."""

from dataclasses import replace

import numpy as np
import pytest
from oracles.raycast import cast_slowly

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.render.view import Look, displaced, exposure_poses, render_view
from tagvo.tags.tag_map import map_from_dict

DOWN = np.diag([1.0, -1.0, -1.0])
CAMERAS = {
    "none": ("none", [530.0, 530.0, 319.5, 239.5], []),
    "radtan": ("radtan", [530.0, 528.0, 322.1, 236.2], [-0.18, 0.05, 1e-3, -5e-4]),
    "equidistant": ("equidistant", [400.0, 401.0, 318.0, 241.3], [-0.01, 0.02, -0.01, 0.002]),
}


def camera_of(name, width=640, height=480):
    model, intrinsics, coeffs = CAMERAS[name]
    scale = width / 640
    return Camera(model, np.array(intrinsics) * scale, np.array(coeffs), (width, height))


def grid_map(n=8, size=0.115, pitch=0.22, family="tagStandard41h12", **keys):
    tags = []
    for i in range(n * n):
        yaw = np.pi / 2 * (i * 7 % 4)
        q = [float(np.cos(yaw / 2)), 0, 0, float(np.sin(yaw / 2))]
        p = [pitch * (i % n - n / 2 + 0.5), pitch * (i // n - n / 2 + 0.5), 0.0]
        tags.append({"id": i, "size": size, "p": p, "q": q})
    return map_from_dict({"family": family, "tags": tags, **keys}, "grid")


def corners_px(tag_map, camera, R_WC, p_WC, tag_id):
    (row,) = tag_map.rows(np.array([tag_id]))
    R_CW, p_CW = geo.invert(R_WC, p_WC)
    return project(camera, geo.transform(R_CW, p_CW, tag_map.corners_W[row]))[0]


@pytest.mark.parametrize("name", CAMERAS)
def test_the_detector_finds_the_corners_where_the_projection_has_them(name):
    import apriltag

    camera, tag_map, rng = camera_of(name), grid_map(), np.random.default_rng(5)
    detector = apriltag.apriltag("tagStandard41h12", maxhamming=0, decimate=1.0)
    errors = []
    for k in range(8):
        tilt = rng.normal(size=3) * [0.12, 0.12, 2.0] * (k > 0)
        R_WC = DOWN @ geo.exp(tilt)
        p_WC = np.array([0.0, 0.0, 1.1]) + 0.08 * rng.normal(size=3)
        for found in detector.detect(render_view(tag_map, camera, R_WC, p_WC)):
            exact = corners_px(tag_map, camera, R_WC, p_WC, found["id"])
            if np.linalg.norm(exact[0] - exact[1]) >= 20.0:
                errors.append(found["lb-rb-rt-lt"][::-1] - 0.5 - exact)
    assert len(errors) >= 120
    assert np.sqrt(np.mean(np.square(errors))) < 0.15
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.05


def test_a_kalibr_grid_is_read_by_opencv_turned_by_180_degrees():
    from cv2 import aruco

    tag_map = grid_map(n=3, size=0.15, pitch=0.2, family="tag36h11", border_bits=2)
    camera, p_WC = camera_of("none"), np.array([0.0, 0.0, 0.8])
    image = render_view(tag_map, camera, DOWN, p_WC, look=Look(floor=225.0))
    parameters = aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    book = aruco.getPredefinedDictionary(aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = aruco.ArucoDetector(book, parameters).detectMarkers(image)
    assert sorted(ids.ravel()) == list(range(9))
    for tag_id, found in zip(ids.ravel(), corners, strict=True):
        exact = corners_px(tag_map, camera, DOWN, p_WC, tag_id)
        np.testing.assert_allclose(np.roll(found[0], 2, axis=0), exact, atol=0.3)


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(
    ("rotvec", "p_WC"),
    [
        ([0.0, 0.0, 0.3], [0.02, -0.03, 0.9]),
        ([0.5, -0.4, 1.0], [0.1, 0.2, 0.6]),
        ([1.25, 0.0, 0.0], [0.0, -0.3, 0.15]),  # along the floor: tags behind, aside, far away
        ([0.2, 0.1, 0.0], [0.0, 0.0, 0.03]),  # a tag larger than the view
    ],
)
def test_a_view_is_what_a_slow_ray_caster_sees(name, rotvec, p_WC):
    rng = np.random.default_rng(2)
    camera = camera_of(name, 64, 48)
    tag_map = displaced(grid_map(6), rng, (0.0, 0.002, 0.0, 0.03))
    R_WC, p_WC, look = DOWN @ geo.exp(np.array(rotvec)), np.array(p_WC), Look(20.0, 220.0, 100.0)
    seen = render_view(tag_map, camera, R_WC, p_WC, look=look, supersample=8).astype(float)
    error = seen - cast_slowly(tag_map, camera, R_WC, p_WC, look)
    assert seen.std() > 20.0
    assert np.sqrt(np.mean(error**2)) < 6.0  # 64 rays leave 4; a shift by 1/4 px makes 12
    assert np.abs(error.mean()) < 0.3


def test_the_nearer_of_two_tags_hides_the_other():
    tags = [
        {"id": 1, "size": 0.1, "p": [0, 0, 0.1], "q": [1, 0, 0, 0]},
        {"id": 0, "size": 0.4, "p": [0, 0, 0.0], "q": [1, 0, 0, 0]},
    ]
    both = map_from_dict({"family": "tag36h11", "tags": tags}, "two")
    camera, p_WC = camera_of("none", 160, 120), np.array([0.0, 0.0, 0.6])
    middle = slice(50, 70), slice(70, 90)
    seen = [render_view(m, camera, DOWN, p_WC)[middle] for m in (both, both.only([1]))]
    np.testing.assert_array_equal(*seen)


def test_a_tag_shows_its_face_only():
    camera, p_WC = camera_of("none", 160, 120), np.array([0.0, 0.0, -0.8])
    assert (render_view(grid_map(), camera, np.eye(3), p_WC) == 128).all()


def test_where_the_lens_has_no_inverse_there_is_no_light():
    wild = Camera("radtan", np.array([60.0, 60, 79.5, 59.5]), np.array([-0.4, 0, 0, 0]), (160, 120))
    image = render_view(grid_map(), wild, DOWN, np.array([0.0, 0.0, 0.8]))
    assert image[0, 0] == 0
    assert image[60, 80] > 0


def test_blur_is_the_mean_of_its_exposures():
    camera, tag_map = camera_of("radtan", 160, 120), grid_map()
    twist = np.array([1.0, 0.2, 0.0, 0.0, 0.3, 1.0])
    R, p = exposure_poses(DOWN, np.array([0.0, 0.0, 0.8]), twist, 0.02, 5)
    blurred = render_view(tag_map, camera, R, p).astype(float)
    sharp = [render_view(tag_map, camera, R[k], p[k]) for k in range(5)]
    np.testing.assert_allclose(blurred, np.mean(sharp, axis=0), atol=1.01)
    assert np.abs(blurred - sharp[2]).max() > 30.0


def test_an_exposure_is_centred_and_as_long_as_its_motion():
    twist = np.array([1.0, 0.2, -0.1, 0.4, 0.3, 1.0])
    R_0, p_0 = geo.exp(np.array([0.3, 0.2, 0.1])), np.array([1.0, 2.0, 3.0])
    R, p = exposure_poses(R_0, p_0, twist, 0.5, 5)
    np.testing.assert_allclose(R[2], R_0, atol=1e-12)
    np.testing.assert_allclose(p[2], p_0, atol=1e-12)
    moved = geo.compose(*geo.invert(R[0], p[0]), R[4], p[4])
    for got, want in zip(moved, geo.exp_se3(twist * 0.5 * 4 / 5), strict=True):
        np.testing.assert_allclose(got, want, atol=1e-9)


def test_noise_is_drawn_from_the_rng_alone():
    camera, tag_map, p_WC = camera_of("none", 160, 120), grid_map(), np.array([0.0, 0.0, 0.8])

    def noisy(seed):
        rng = np.random.default_rng(seed)
        return render_view(tag_map, camera, DOWN, p_WC, noise_sigma=5.0, rng=rng).astype(float)

    clean = render_view(tag_map, camera, DOWN, p_WC)
    np.testing.assert_array_equal(noisy(1), noisy(1))
    assert np.std(noisy(1) - clean) == pytest.approx(5.0, rel=0.05)
    with pytest.raises(ValueError, match="rng"):
        render_view(tag_map, camera, DOWN, p_WC, noise_sigma=5.0)


def test_light_follows_the_gain_and_the_floor_its_texture():
    camera, p_WC = camera_of("none", 160, 120), np.array([5.0, 5.0, 0.8])  # beside the map
    look = Look(floor=100.0, gain=0.5)
    assert (render_view(grid_map(), camera, DOWN, p_WC, look=look) == 50).all()
    rough = render_view(grid_map(), camera, DOWN, p_WC, look=replace(look, texture=40.0))
    assert 2.0 < rough.std() < 20.0
    assert rough.mean() == pytest.approx(50.0, abs=5.0)


def test_laying_errors_have_the_maps_own_sigmas():
    sigma = {"xy": 0.004, "z": 0.001, "yaw_deg": 2.0, "tilt_deg": 0.5}
    tag_map = grid_map(n=20, sigma=sigma)
    R_0 = geo.exp(np.random.default_rng(0).normal(size=(len(tag_map), 3)))
    tag_map, rng = replace(tag_map, R_WT=R_0), np.random.default_rng(9)
    laid = [displaced(tag_map, rng) for _ in range(10)]
    dp = np.stack([geo.transform(np.swapaxes(R_0, 1, 2), 0.0, m.p_WT - tag_map.p_WT) for m in laid])
    dphi = np.stack([geo.log(np.swapaxes(R_0, 1, 2) @ m.R_WT) for m in laid])
    spread = np.concatenate([dp, dphi], axis=-1).std(axis=(0, 1))
    np.testing.assert_allclose(spread, tag_map.laying_sigma[0], rtol=0.06)
    still = displaced(tag_map, rng, (0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose(still.p_WT, tag_map.p_WT, atol=1e-15)
    np.testing.assert_allclose(still.corners_W, tag_map.corners_W, atol=1e-12)
