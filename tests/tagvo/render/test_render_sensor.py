"""The sensor's laws: photon transfer, conservation of light, radial fall-off, gamma, JPEG."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import camera_of, floor_of, picture, scene_of, still, tilted
from scipy.stats import chi2, poisson
from simulated import DOWN

from tagvo.render.scene import LensConfig
from tagvo.render.sensor import defocused, develop, disc, exposed, falloff, pad_of

CAMERA = camera_of("none")


def flat(grey, shape=(200, 200)):
    return np.full(shape, grey, dtype=np.float32)


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_noise_follows_the_photon_transfer_curve(gain):
    lens, n = LensConfig(full_well_e=8000, read_noise_grey=1.2, gain=gain), 40_000
    low, high = chi2.ppf([1e-4, 1 - 1e-4], n - 1) / (n - 1)
    for k, grey in enumerate((0.0, 2.0, 30.0, 128.0, 220.0)):
        noisy = exposed(flat(grey), lens, gain, rng(k))
        expected = grey * 255.0 * gain / 8000 + (1.2 * gain) ** 2
        assert low < noisy.var(ddof=1) / expected < high
        assert abs(noisy.mean() - grey) < 4.0 * np.sqrt(expected / n)


def test_few_photons_are_counted():
    lens = LensConfig(full_well_e=100)  # 2.55 greys an electron
    counts = exposed(flat(10.0), lens, 1.0, rng()) / 2.55
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-4)
    seen = np.bincount(np.rint(counts).astype(int).ravel(), minlength=15)[:10]
    expected = counts.size * poisson.pmf(np.arange(10), 10.0 / 2.55)
    assert (np.abs(seen - expected) < 5.0 * np.sqrt(expected)).all()


def test_both_ways_to_draw_photons_meet():
    """Skewness too is near Poisson's, 1/sqrt(lambda), on either side of the change."""
    lens = LensConfig(full_well_e=2550)  # 0.1 greys an electron
    below, above = (exposed(flat(g, (500, 500)), lens, 1.0, rng()) for g in (5.9, 6.1))
    assert below.std() == pytest.approx(np.sqrt(0.59), rel=0.01)
    assert above.std() == pytest.approx(np.sqrt(0.61), rel=0.01)


def test_noise_in_a_picture_is_that_of_the_sensor():
    scene = scene_of(floor_of(2, 0.2, 0.36), floor_grey=128.0)
    pose = still(DOWN, np.array([0.0, 0.0, 0.8]))
    lens = LensConfig(full_well_e=4000, read_noise_grey=2.0)
    clean = picture(scene, CAMERA, pose)
    noise = picture(scene, CAMERA, pose, lens, seed=1) - clean
    for grey in (25.0, 128.0, 225.0):
        sigma = np.sqrt(grey * 255.0 / 4000 + 4.0 + 1.0 / 12.0)  # and rounding
        assert noise[clean == grey].std() == pytest.approx(sigma, rel=0.04)
    assert (picture(scene, CAMERA, pose) == clean).all()


def test_what_is_too_bright_is_white_and_nothing_is_below_black():
    lens = LensConfig(read_noise_grey=30.0)
    assert develop(flat(400.0), CAMERA, lens, rng()).min() >= 200
    image = develop(flat(0.0), CAMERA, lens, rng())
    assert image.min() == 0
    assert np.mean(image == 0) == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("radius", [0.3, 0.7, 1.0, 2.5, 6.0])
def test_defocus_moves_light_and_loses_none(radius):
    pad = pad_of(radius)
    light = np.zeros((61 + 2 * pad, 61 + 2 * pad), np.float32)
    light[pad + 30, pad + 30] = 1000.0
    out = defocused(light, radius, pad)
    assert out.shape == (61, 61)
    assert out.sum() == pytest.approx(1000.0, rel=1e-5)
    y, x = np.mgrid[-30:31, -30:31]
    assert (out * x).sum() == pytest.approx(0.0, abs=1e-2)
    second = (out * (x * x + y * y)).sum() / 1000.0
    if radius >= 1.0:  # of a disc r^2 / 2, and of the pixels' own squares 1/6; coarse when small
        assert second == pytest.approx(radius**2 / 2 + 1.0 / 6.0, rel=0.2 if radius < 2 else 0.05)
    assert out[np.hypot(x, y) > radius + 0.71].sum() == pytest.approx(0.0, abs=1e-4)
    assert disc(radius).sum() == pytest.approx(1.0, rel=1e-6)


def test_defocus_brings_light_in_from_beyond_the_picture():
    scene, pose = scene_of(floor_of()), still(tilted(), np.array([0.0, 0.0, 0.4]))
    shifted = CAMERA.intrinsics + np.array([0.0, 0.0, 10.0, 10.0])
    wide = replace(CAMERA, resolution=(340, 260), intrinsics=shifted)
    blurred = picture(scene, CAMERA, pose, LensConfig(defocus_px=4.0))
    larger = picture(scene, wide, pose, LensConfig(defocus_px=4.0))[10:-10, 10:-10]
    assert np.abs(blurred - larger).max() <= 1.0
    sharp = picture(scene, CAMERA, pose)
    assert blurred.mean() == pytest.approx(sharp.mean(), abs=0.6)
    assert blurred.std() < 0.9 * sharp.std()


def test_vignetting_is_radial_about_the_principal_point():
    camera = camera_of("radtan", 640, 480)
    left = falloff(camera, 0.4)
    assert left.max() == pytest.approx(1.0, abs=1e-5)
    assert left.min() == pytest.approx(0.6, abs=1e-6)
    y, x = np.mgrid[:480, :640]
    r = np.hypot(x - camera.intrinsics[2], y - camera.intrinsics[3]).ravel()
    order = np.argsort(r)
    assert (np.diff(left.ravel()[order]) <= 1e-6).all()  # a function of r alone, falling
    theta = np.arctan(r / r.max() * np.sqrt(0.6**-0.5 - 1.0))
    np.testing.assert_allclose(left.ravel(), np.cos(theta) ** 4, atol=1e-5)


def test_a_picture_darkens_by_the_vignetting():
    scene, pose = scene_of(floor_of(1), hidden_share=1.0), still(DOWN, np.array([0, 0, 1.0]))
    image = picture(scene, CAMERA, pose, LensConfig(vignetting=0.5))
    assert image[120, 160] == 128
    assert image[0, 0] == pytest.approx(64.0, abs=1.0)


def test_gamma_keeps_black_and_white_and_inverts():
    lens = LensConfig(gamma=2.2)
    levels = np.linspace(0, 255, 256, dtype=np.float32)[None]
    image = develop(levels, CAMERA, lens, rng()).astype(float)
    assert image[0, 0] == 0.0
    assert image[0, 255] == 255.0
    back = 255.0 * (image / 255.0) ** 2.2
    np.testing.assert_allclose(back, levels, atol=1.2)
    assert image[0, 128] > 180.0


@pytest.mark.parametrize("grey", [20.0, 128.0, 200.0])
def test_exposure_control_reaches_its_mean_by_gain(grey):
    lens = LensConfig(auto_exposure_grey=100.0, full_well_e=5000)
    image = develop(flat(grey), CAMERA, lens, rng()).astype(float)
    assert image.mean() == pytest.approx(100.0, abs=0.5)
    electrons = grey / 255.0 * 5000  # what is amplified is what was caught
    sigma = np.sqrt(100.0**2 / electrons + 1.0 / 12.0)
    assert image.std() == pytest.approx(sigma, rel=0.04)


def test_exposure_control_has_limits():
    lens = LensConfig(auto_exposure_grey=100.0)
    assert develop(flat(1.0), CAMERA, lens, rng()).max() == 16
    assert develop(flat(0.0), CAMERA, lens, rng()).max() == 0


def test_jpeg_is_that_of_the_codec_and_worse_at_lower_quality():
    scene, pose = scene_of(floor_of()), still(tilted(), np.array([0.0, 0.0, 0.5]))
    plain = picture(scene, CAMERA, pose)
    errors = []
    for quality in (95, 60, 20):
        image = picture(scene, CAMERA, pose, LensConfig(jpeg_quality=quality))
        _, packed = cv2.imencode(
            ".jpg", plain.astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, quality]
        )
        np.testing.assert_array_equal(image, cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))
        errors.append(np.sqrt(np.mean((image - plain) ** 2)))
    assert 0.2 < errors[0] < errors[1] < errors[2]
