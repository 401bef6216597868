"""The edges of tags in the image: refit of corners, spread under blur, what blur costs a corner."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.detect.apriltag import AprilTagDetector
from tagvo.detect.blur import corner_sigma, edge_spread, measured_sigma
from tagvo.detect.edge_profile import cell_width, refit_corners, sample, signed_area
from tagvo.render.view import exposure_poses, render_view
from tagvo.tags.tag_map import map_from_dict

F_PX = 600.0
CAMERA = Camera("none", np.array([F_PX, F_PX, 159.5, 119.5]), np.zeros(4), (320, 240))
DOWN = np.diag([1.0, -1.0, -1.0])


def board(family, side_px, columns, rows, rng=None):
    size = side_px / F_PX
    pitch = size * (2.3 if family == "tagStandard41h12" else 1.7)
    tags = []
    for i in range(columns * rows):
        turn = 0.0 if rng is None else rng.uniform(0, 2 * np.pi)
        x, y = i % columns - (columns - 1) / 2, i // columns - (rows - 1) / 2
        q = [float(np.cos(turn / 2)), 0.0, 0.0, float(np.sin(turn / 2))]
        tags.append({"id": i, "size": size, "p": [x * pitch, y * pitch, 0.0], "q": q})
    return map_from_dict({"family": family, "tags": tags}, "test board")


def view(tag_map, rng, blur_px=(0.0, 0.0), focus_px=0.5, noise=2.0, tilt=0.1):
    """A picture from 1 m, moved by blur_px in the exposure, and the exact corners at its middle."""
    R_WC = geo.exp(rng.normal(0.0, tilt, 3)) @ DOWN
    p_WC = -R_WC[:, 2] + np.array([*rng.uniform(-0.002, 0.002, 2), 0.0])
    twist_C = np.array([*(np.asarray(blur_px) / F_PX), 0.0, 0.0, 0.0, 0.0])
    count = 1 + 2 * int(np.ceil(np.hypot(*blur_px)))
    light = render_view(tag_map, CAMERA, *exposure_poses(R_WC, p_WC, twist_C, 1.0, count))
    soft = cv2.GaussianBlur(light.astype(float), (0, 0), focus_px)
    image = np.clip(np.rint(soft + rng.normal(0.0, noise, soft.shape)), 0, 255).astype(np.uint8)
    pixels, _ = project(CAMERA, (tag_map.corners_W - p_WC) @ R_WC)
    return image, pixels


def test_sample_is_bilinear_and_holds_the_rim():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (9, 11), dtype=np.uint8)
    x, y = rng.uniform(0, 10, 200).astype(np.float32), rng.uniform(0, 8, 200).astype(np.float32)
    x0, y0 = np.minimum(x.astype(int), 9), np.minimum(y.astype(int), 7)
    u, v = x - x0, y - y0
    grey = image.astype(float)
    want = (1 - v) * ((1 - u) * grey[y0, x0] + u * grey[y0, x0 + 1])
    want += v * ((1 - u) * grey[y0 + 1, x0] + u * grey[y0 + 1, x0 + 1])
    assert_allclose(sample(image, x, y), want, atol=1e-3)
    outside = np.array([-5.0, 99.0], dtype=np.float32)
    assert_allclose(sample(image, outside, outside), [grey[0, 0], grey[-1, -1]])
    assert_allclose(sample(image[:1, :1].copy(), outside, outside), grey[0, 0])


def test_cell_width_knows_foreshortening():
    flat = np.array([[[0, 0], [80, 0], [80, 20], [0, 20]]], dtype=float)
    assert_allclose(signed_area(flat), 1600.0)
    assert_allclose(cell_width(flat, 8), [[2.5, 10.0, 2.5, 10.0]])


@pytest.mark.parametrize(
    ("family", "cells", "side"), [("tag36h11", 8, 40), ("tagStandard41h12", 5, 40)]
)
def test_refit_brings_rough_corners_home(family, cells, side):
    """From up to 1.2 px off; both senses of the border (black inside, white inside)."""
    rng = np.random.default_rng(1)
    tag_map = board(family, side, 3, 2, rng)
    image, truth = view(tag_map, rng)
    rough = truth + rng.uniform(-1.2, 1.2, truth.shape)
    fine = refit_corners(image, rough, cells)
    assert np.sqrt(np.square(rough - truth).mean()) > 0.6
    assert np.sqrt(np.square(fine - truth).mean()) < 0.05


def test_refit_leaves_alone_what_has_no_edges():
    rng = np.random.default_rng(2)
    quads = np.array([[[50, 50], [90, 50], [90, 90], [50, 90]]], dtype=float)
    flat = np.full((240, 320), 128, dtype=np.uint8)
    assert_allclose(refit_corners(flat, quads, 8), quads)
    noise = rng.integers(0, 256, (240, 320), dtype=np.uint8)
    assert np.abs(refit_corners(noise, quads, 8) - quads).max() <= 3.0
    for odd in (quads * 0.0, quads * [1, 0], quads - 500.0, quads[:, [0, 2, 1, 3]], quads[:0]):
        assert refit_corners(noise, odd, 8).shape == odd.shape
        assert np.isfinite(refit_corners(noise, odd, 8)).all()
    assert_allclose(refit_corners(np.zeros((0, 5), dtype=np.uint8), quads, 8), quads)


@pytest.mark.parametrize("focus_px", [0.5, 1.0, 1.5, 2.0])
def test_spread_measures_defocus(focus_px):
    rng = np.random.default_rng(3)
    tag_map = board("tag36h11", 70.0, 2, 1, rng)
    image, truth = view(tag_map, rng, focus_px=focus_px)
    want = np.sqrt(focus_px**2 + 1 / 12 + 1 / 6)  # the box of a pixel, the hat of sampling
    spread = edge_spread(image, truth, 8)
    assert spread.shape == (2, 4)
    assert 0.72 < np.median(spread) / want < 1.0  # the floor under the gradient cuts its tails


def test_motion_widens_the_sides_it_crosses_and_no_others():
    rng = np.random.default_rng(4)
    tag_map = board("tag36h11", 70.0, 2, 1)  # upright: sides 0 and 2 run along x
    image, truth = view(tag_map, rng, blur_px=(6.0, 0.0), tilt=0.0)
    spread = edge_spread(image, truth, 8)
    assert spread[:, [1, 3]].min() > 1.4  # a box of 6 px: 1.73
    assert spread[:, [0, 2]].max() < 0.75


def test_spread_does_not_care_for_noise_or_contrast():
    tag_map = board("tagStandard41h12", 45.0, 2, 2)
    sharp, truth = view(tag_map, np.random.default_rng(5), noise=0.0)
    noisy, _ = view(tag_map, np.random.default_rng(5), noise=8.0)
    dim = (sharp * 0.3).astype(np.uint8)
    want = edge_spread(sharp, truth, 5)
    assert np.abs(edge_spread(noisy, truth, 5) - want).max() < 0.12
    assert np.abs(edge_spread(dim, truth, 5) - want).max() < 0.12


def test_sigma_law():
    cell = np.full((1, 4), 5.0)
    assert_allclose(corner_sigma(np.full((1, 4), 0.5), cell, 0.1), 0.1, rtol=0.02)  # sharp
    wide = corner_sigma(np.array([[0.5, 2.0, 0.5, 0.5]]), cell, 0.1)[0]
    assert wide[1] == pytest.approx(wide[2])  # the corners at either end of the wide side
    assert wide[0] == pytest.approx(wide[3]) == pytest.approx(0.1, rel=0.02)
    assert wide[1] > 0.5
    spreads = np.linspace(0.3, 3.0, 20)[:, None] * np.ones(4)
    assert (np.diff(corner_sigma(spreads, np.full((20, 4), 5.0), 0.1), axis=0) >= 0).all()
    small, large = (corner_sigma(spreads, np.full((20, 4), c), 0.1) for c in (3.0, 9.0))
    assert (small >= large).all()


@pytest.mark.parametrize(
    ("family", "cells", "side", "blur", "noise"),
    [
        ("tagStandard41h12", 5, 20, 0, 3),
        ("tagStandard41h12", 5, 20, 4, 3),
        ("tagStandard41h12", 5, 20, 6, 3),
        ("tagStandard41h12", 5, 40, 6, 3),
        ("tag36h11", 8, 25, 0, 3),
        ("tag36h11", 8, 25, 4, 3),
        ("tag36h11", 8, 40, 6, 3),
    ],
)
def test_sigma_tells_the_truth_about_corners(family, cells, side, blur, noise):
    """Measured corner errors against the sigma read from the image: NIS per axis near 1.

    The law leans to caution: at 2 to 4 px of motion sigma is up to twice the error.
    """
    rng = np.random.default_rng(17)
    pitch = side * (2.3 if family == "tagStandard41h12" else 1.7)
    tag_map = board(family, side, int(300 // pitch), int(220 // pitch), rng)
    detector = AprilTagDetector(tag_map.family, 1.5)
    nis, least = [], []
    for angle in rng.uniform(0, np.pi, 4):
        motion = (blur * np.cos(angle), blur * np.sin(angle))
        image, truth = view(tag_map, rng, motion, noise=noise)
        det = detector.detect(image)
        inside = (det.corners_px >= 5.5) & (det.corners_px <= np.array(CAMERA.resolution) - 6.5)
        det = det[inside.all(axis=(1, 2))]
        error = det.corners_px - truth[tag_map.rows(det.tag_id)]
        sigma = measured_sigma(image, det.corners_px, cells, 0.03)
        assert sigma.shape == (len(det), 4)
        nis.append(np.square(error / sigma[..., None]).reshape(-1))
        least.append(sigma.min(initial=np.inf))
    values = np.concatenate(nis)
    assert len(values) > 100
    assert min(least) >= 0.03 * (1 - 1e-9)
    assert 0.15 < values.mean() < 2.2
    assert 0.02 < np.median(values) < 0.8  # chi2 of one degree: 0.455


def test_nothing_to_measure():
    image = np.zeros((240, 320), dtype=np.uint8)
    assert measured_sigma(image, np.zeros((0, 4, 2)), 8, 0.1).shape == (0, 4)
    quads = np.array([[[50, 50], [90, 50], [90, 90], [50, 90]]], dtype=float)
    assert_allclose(measured_sigma(image, quads, 8, 0.1), 0.1)
    assert_allclose(measured_sigma(image[:0], quads, 8, 0.1), 0.1)
    assert np.isnan(measured_sigma(image, quads * np.nan, 8, 0.1)).all()  # the configured one
    assert np.isfinite(measured_sigma(image, quads * 0.0, 8, 0.1)).all()
