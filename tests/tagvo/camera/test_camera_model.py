"""The camera model against OpenCV's, against finite differences and against itself backwards."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tagvo.camera.model import Camera, distort, project, unproject

INTRINSICS = np.array([458.654, 457.296, 367.215, 248.375])
RESOLUTION = (752, 480)
CAMERAS = {
    "none": ("none", []),
    "euroc": ("radtan", [-0.28340811, 0.07395907, 0.00019359, 1.76187114e-05]),
    "line5": ("radtan", [-0.233024, 0.217972, 0.000104351, -9.65731e-05, -0.0913426]),
    "pincushion": ("radtan", [0.3, 0.1, 0.002, -0.003]),
    "rational": ("radtan", [0.9, 0.35, 1e-4, -2e-4, 0.02, 1.25, 0.6, 0.07]),
    "strong": ("radtan", [-0.45, 0.18, 0.001, -0.002, -0.03]),
    "fisheye": ("equidistant", [-0.0137, 0.0208, -0.0128, 0.0025]),
    "strong fisheye": ("equidistant", [0.12, -0.05, 0.03, -0.006]),
}


def camera_named(name: str) -> Camera:
    model, coeffs = CAMERAS[name]
    return Camera(model, INTRINSICS, np.array(coeffs, dtype=float), RESOLUTION)


def points_seen(camera: Camera, rng: np.random.Generator, n: int = 200) -> np.ndarray:
    """Points in C (n, 3) [m] at 0.2 to 10 m, spread to 0.9 of the radius that can be inverted."""
    reach = 0.9 * min(camera.max_radius, 1.2)
    radius, turn = reach * np.sqrt(rng.random(n)), rng.uniform(-np.pi, np.pi, n)
    z = rng.uniform(0.2, 10.0, n)
    return z[:, None] * np.stack([radius * np.cos(turn), radius * np.sin(turn), np.ones(n)], -1)


def opencv_pixels(camera: Camera, p_C: np.ndarray) -> np.ndarray:
    fu, fv, pu, pv = camera.intrinsics
    K, zero = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]]), np.zeros(3)
    if camera.model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(p_C[:, None], zero, zero, K, camera.coeffs)
    else:
        pixels, _ = cv2.projectPoints(p_C[:, None], zero, zero, K, camera.coeffs)
    return pixels[:, 0]


@pytest.mark.parametrize("name", CAMERAS)
def test_projection_is_that_of_opencv(name: str) -> None:
    camera = camera_named(name)
    p_C = points_seen(camera, np.random.default_rng(1))
    pixels, valid = project(camera, p_C)
    assert valid.all()
    assert_allclose(pixels, opencv_pixels(camera, p_C), atol=1e-8)


@pytest.mark.parametrize("name", CAMERAS)
def test_unproject_undoes_project(name: str) -> None:
    camera = camera_named(name)
    p_C = points_seen(camera, np.random.default_rng(2))
    pixels, _ = project(camera, p_C)
    x_n, J, valid = unproject(camera, pixels)
    assert valid.all()
    assert_allclose(x_n, p_C[:, :2] / p_C[:, 2:], atol=1e-8)
    assert_allclose(J, distort(camera, x_n)[1], rtol=1e-6, atol=1e-5)


@pytest.mark.parametrize("name", CAMERAS)
def test_jacobians_are_those_of_finite_differences(name: str) -> None:
    camera = camera_named(name)
    p_C = points_seen(camera, np.random.default_rng(3), n=50)
    step = 1e-6

    def central(function, x):  # derivatives stand in the last axis
        columns = [
            (function(x + step * e) - function(x - step * e)) / (2 * step)
            for e in np.eye(x.shape[-1])
        ]
        return np.stack(columns, axis=-1)

    x_n = p_C[:, :2] / p_C[:, 2:]
    _, J = distort(camera, x_n)
    assert_allclose(J, central(lambda x: distort(camera, x)[0], x_n), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("name", ["euroc", "strong", "rational", "fisheye"])
def test_the_axis_and_its_neighbourhood_are_regular(name: str) -> None:
    camera = camera_named(name)
    x_n = np.array([[0.0, 0.0], [1e-12, 0.0], [0.0, -1e-9], [1e-7, 1e-7]])
    pixels, J = distort(camera, x_n)
    assert_allclose(pixels, x_n * INTRINSICS[:2] + INTRINSICS[2:], atol=1e-6)
    assert_allclose(J, np.broadcast_to(np.diag(INTRINSICS[:2]), (4, 2, 2)), atol=1e-3)
    back, _, valid = unproject(camera, pixels)
    assert valid.all()
    assert_allclose(back, x_n, atol=1e-10)


@pytest.mark.parametrize("name", ["strong", "line5"])  # EuRoC's model never folds
def test_outside_the_fold_nothing_is_valid(name: str) -> None:
    camera = camera_named(name)
    limit = camera.max_radius
    assert np.isfinite(limit)
    radial = np.array([[limit * 1.05, 0.0, 1.0], [limit * 0.95, 0.0, 1.0]])
    assert project(camera, radial)[1].tolist() == [False, True]
    far = np.array([[1e5, 1e5], [-1e5, 0.0], [np.nan, 3.0]])
    x_n, _, valid = unproject(camera, far)
    assert not valid.any()
    assert_allclose(x_n, 0.0)


def test_behind_the_camera_nothing_is_valid() -> None:
    p_C = np.array([[0.1, 0.1, -1.0], [0.0, 0.0, 0.0], [0.1, 0.1, 1.0]])
    for name in CAMERAS:
        pixels, valid = project(camera_named(name), p_C)
        assert valid.tolist() == [False, False, True]
        assert np.isfinite(pixels).all()


def test_batch_axes_are_of_any_shape() -> None:
    camera = camera_named("euroc")
    p_C = points_seen(camera, np.random.default_rng(4), n=24).reshape(2, 3, 4, 3)
    pixels, valid = project(camera, p_C)
    assert pixels.shape == (2, 3, 4, 2)
    assert valid.shape == (2, 3, 4)
    x_n, J, _ = unproject(camera, pixels)
    assert x_n.shape == (2, 3, 4, 2)
    assert J.shape == (2, 3, 4, 2, 2)
    assert_allclose(pixels[1, 2], project(camera, p_C[1, 2])[0])
    empty, _ = project(camera, np.zeros((0, 4, 3)))
    assert empty.shape == (0, 4, 2)


@settings(max_examples=60, deadline=None)
@given(
    k1=st.floats(-0.4, 0.4),
    k2=st.floats(-0.2, 0.2),
    p1=st.floats(-0.005, 0.005),
    p2=st.floats(-0.005, 0.005),
    u=st.floats(0, 751),
    v=st.floats(0, 479),
)
def test_what_unproject_calls_valid_projects_back(k1, k2, p1, p2, u, v) -> None:
    camera = Camera("radtan", INTRINSICS, np.array([k1, k2, p1, p2]), RESOLUTION)
    x_n, _, valid = unproject(camera, np.array([u, v]))
    assert np.isfinite(x_n).all()
    if valid:
        pixel, _ = project(camera, np.append(x_n, 1.0))
        assert_allclose(pixel, [u, v], atol=1e-5)
