"""Light on the floor: lamps by the law of the cosine, mirror images, shadows, flicker."""

import numpy as np
import pytest
from scenes import camera_of, floor_of, picture, pixels_of, scene_of, still
from simulated import DOWN

from tagvo import geometry as geo
from tagvo.render.config import GlareConfig, LightConfig, ShadowConfig
from tagvo.render.lighting import even_light, flicker, glare_grey, lamps_over, shaded_share
from tagvo.render.scene import LensConfig

CAMERA = camera_of("none", 640, 480)
BARE = {"hidden_share": 1.0}  # a plain floor of grey 128
ROUGH = LensConfig(supersample=1)
ABOVE = np.array([0.0, 0.0, 0.8])
LAMP = (0.4, -0.2, 2.5)
GRID = np.stack(
    [*np.meshgrid(np.linspace(-0.5, 0.5, 61), np.linspace(-0.4, 0.4, 49)), np.zeros((49, 61))], -1
)


def floor_seen(pose=(DOWN, ABOVE), lens=ROUGH, tags=1, **config):
    return picture(scene_of(floor_of(tags), **BARE, **config), CAMERA, still(*pose), lens)


def test_light_falls_off_with_the_fourth_power_of_the_cosine():
    image = floor_seen(light={"lamps_m": [LAMP], "hot_spot_share": 1.0})
    places = np.array([[0.4, -0.2, 0.0], [0.1, 0.1, 0.0], [-0.3, 0.3, 0.0], [-0.2, -0.25, 0.0]])
    px = np.rint(pixels_of(CAMERA, DOWN, ABOVE, places)).astype(int)
    d = places - np.array(LAMP)
    cosine4 = (2.5 / np.linalg.norm(d, axis=1)) ** 4
    seen = image[px[:, 1], px[:, 0]]
    np.testing.assert_allclose(seen / seen[0], cosine4 / cosine4[0], atol=0.012)


def test_light_has_the_mean_of_one_over_the_tags():
    scene = scene_of(
        floor_of(), light={"hot_spot_share": 0.8, "gradient_share": 0.5, "gradient_deg": 30.0}
    )
    light = scene.light_scale * even_light(
        scene.config.light, scene.places, scene.lamps, scene.places
    )
    assert light.mean() == pytest.approx(1.0)
    assert light.std() > 0.1


def test_a_gradient_grows_along_its_direction_alone():
    image = floor_seen(tags=6, light={"gradient_share": 0.5, "gradient_deg": 90.0})
    assert np.abs(image - image[:, :1]).max() <= 1.0  # nothing along x
    at = pixels_of(CAMERA, DOWN, ABOVE, np.array([[0.0, 0.3, 0.0], [0.0, -0.3, 0.0]]))
    (x0, y0), (x1, y1) = np.rint(at).astype(int)
    bright, dark = image[y0, x0], image[y1, x1]
    assert bright == pytest.approx(192.0, abs=2.0)  # the map's tags end at y = 0.3
    assert dark == pytest.approx(64.0, abs=2.0)


@pytest.mark.parametrize("p_WC", [(0.0, 0.0, 0.8), (0.3, 0.1, 0.8), (0.0, 0.0, 0.5)])
def test_glare_is_where_a_mirror_would_show_the_lamp(p_WC):
    p = np.array(p_WC)
    config = {"light": {"lamps_m": [LAMP]}, "glare": {"peak_grey": 100.0, "width_deg": 3.0}}
    image = floor_seen((DOWN, p), **config)
    mirrored = np.array(LAMP) * [1, 1, -1]
    (expected,) = pixels_of(CAMERA, DOWN, p, mirrored[None])
    added = image - 128.0
    y, x = np.mgrid[:480, :640]
    middle = np.array([(added * x).sum(), (added * y).sum()]) / added.sum()
    assert added.max() == pytest.approx(100.0, abs=1.5)
    np.testing.assert_allclose(middle, expected, atol=12.0)  # aslant it is a little lopsided
    peak = np.unravel_index(np.argmax(added), added.shape)
    np.testing.assert_allclose(peak[::-1], expected, atol=6.0)


def test_glare_at_the_mirror_is_the_peak_and_narrow():
    config = GlareConfig(peak_grey=50.0, width_deg=4.0)
    lamp, camera = np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 0.0, 1.0]])
    X = np.zeros((1, 2, 3))
    X[0, 1, 0] = np.tan(np.radians(8.0)) * 2.0 / 3.0 * 2  # half vector turned by about 8 degrees
    grey = glare_grey(config, lamp, camera, X)[0, :, 0]
    assert grey[0] == pytest.approx(50.0)
    assert grey[1] < 50.0 * np.exp(-2.0)


def shade(config, lamps, X_W, p_WC=ABOVE, R_WC=DOWN):
    rows = len(X_W)
    R, p = np.broadcast_to(R_WC, (rows, 3, 3)), np.broadcast_to(p_WC, (rows, 3))
    return shaded_share(config, np.atleast_2d(lamps), R, p, X_W)


def test_a_shadow_is_the_share_of_the_lamp_that_the_hull_hides():
    """Against rays from each place to a lamp's disc, one by one."""
    config = ShadowConfig(vehicle_m=0.6, rotors=0, centre_C_m=(0.0, 0.0, 0.0), lamp_m=0.4)
    lamp, rng = np.array(LAMP), np.random.default_rng(0)
    share = shade(config, lamp, GRID)[..., 0]
    angle, radius = rng.uniform(0, 2 * np.pi, 4000), 0.2 * np.sqrt(rng.uniform(0, 1, 4000))
    on_lamp = lamp + np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], -1)
    for i, j in ((24, 30), (30, 26), (34, 20), (28, 14), (5, 5), (33, 22)):
        X = GRID[i, j]
        at = X + (on_lamp - X) * (ABOVE[2] / lamp[2])
        hidden = (np.hypot(*(at - ABOVE)[:, :2].T) < 0.35 * 0.3).mean()
        assert share[i, j] == pytest.approx(hidden, abs=0.03)
    assert share.max() > 0.5
    assert share.min() == 0.0


def test_rotors_darken_less_than_the_hull_and_turn_with_the_vehicle():
    config = ShadowConfig(vehicle_m=0.6, rotors=4, centre_C_m=(0.0, 0.0, 0.0), lamp_m=0.02)
    over = np.array([0.0, 0.0, 50.0])
    straight = shade(config, over, GRID)[..., 0]
    assert straight[24, 30] == pytest.approx(1.0, abs=1e-3)
    arm = 0.58 * 0.3 * np.sqrt(0.5)
    i, j = 24 + round(arm / 0.8 * 48), 30 + round(arm * 60)
    assert straight[i, j] == pytest.approx(0.35, abs=0.01)
    turned = shade(config, over, GRID, R_WC=geo.exp(np.array([0, 0, np.pi / 4])) @ DOWN)[..., 0]
    assert turned[i, j] < 0.35
    assert turned.mean() == pytest.approx(straight.mean(), rel=0.02)


def test_a_shadow_in_the_picture_moves_with_vehicle_and_lamp():
    """It lies on the line from the lamp through the vehicle, and softens with height."""
    keys = {"shadow": {"darkness_share": 0.6, "rotors": 0, "centre_C_m": (0, 0, 0)}}
    y, x = np.mgrid[:480, :640]
    for lamp, p in ((LAMP, (0, 0, 0.8)), ((-0.3, 0.2, 2.5), (0, 0, 0.8)), (LAMP, (0.2, 0.1, 1.0))):
        image = floor_seen((DOWN, np.array(p, float)), light={"lamps_m": [lamp]}, **keys)
        foot = np.array(lamp) + (np.array(p) - lamp) * lamp[2] / (lamp[2] - p[2])
        (expected,) = pixels_of(CAMERA, DOWN, np.array(p, float), foot[None])
        dark = 128.0 - image
        middle = np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum()
        np.testing.assert_allclose(middle, expected, atol=2.0)
        assert 30.0 < dark.max() <= 0.6 * 128.0 + 1.0


def test_no_shadow_from_a_lamp_below_the_vehicle():
    config = ShadowConfig(darkness_share=0.5)
    assert (shade(config, np.array([0.0, 0.0, 0.5]), GRID) == 0.0).all()


def test_flicker_is_the_mean_over_the_exposure():
    config, t = LightConfig(flicker_share=0.3, flicker_hz=100.0), np.array([0.001, 0.0042, 0.0077])
    fine = (np.arange(4000) + 0.5) / 4000 - 0.5
    for exposure in (0.0, 0.003, 0.01, 0.013):
        seen = flicker(config, t, exposure)
        wave = 1.0 + 0.3 * np.sin(2 * np.pi * 100.0 * (t[:, None] + exposure * fine))
        np.testing.assert_allclose(seen, wave.mean(axis=1), atol=1e-6)


def test_flicker_stripes_a_rolling_shutters_picture():
    lens = LensConfig(readout_s=0.03, exposure_s=0.002, supersample=1)
    image = floor_seen(lens=lens, light={"flicker_share": 0.2})
    rows = image.mean(axis=1)
    assert np.abs(image - rows[:, None]).max() <= 1.0
    ups = np.flatnonzero((rows[1:] >= 128.0) & (rows[:-1] < 128.0))
    assert len(ups) == 3  # 30 ms of 100 Hz
    assert rows.max() - rows.min() == pytest.approx(2 * 0.2 * 128.0 * np.sinc(0.2), abs=3.0)


def test_lamps_hang_over_the_middle_of_the_map_unless_told():
    places = np.array([[0.0, 0.0, 0.1], [2.0, 4.0, 0.1]])
    np.testing.assert_allclose(lamps_over(LightConfig(), places), [[1.0, 2.0, 2.7]])
    assert lamps_over(LightConfig(lamps_m=(LAMP, LAMP)), places).shape == (2, 3)
