"""Scenes: laying errors by their statistics; what is hidden, torn or littered is so in pictures."""

import numpy as np
import pytest
from pydantic import ValidationError
from scenes import camera_of, floor_of, gliding, picture, pixels_of, scene_of, still, tilted
from scipy.stats import chi2
from simulated import DOWN

from tagvo import geometry as geo
from tagvo.config import validated
from tagvo.detect import make_detector
from tagvo.errors import ConfigError
from tagvo.render.cells_hit import BLOB, TORN
from tagvo.render.scene import LensConfig, SceneConfig, displaced

ABOVE = np.array([0.0, 0.0, 0.85])  # 6 x 6 tags fill the picture
FAST = LensConfig(supersample=4)


def ids_seen(scene, camera=None, R_WC=DOWN, p_WC=ABOVE, lens=FAST):
    detector = make_detector("apriltag", scene.tag_map.family)
    image = picture(scene, camera or camera_of(width=640, height=480), still(R_WC, p_WC), lens)
    return set(detector.detect(image.astype(np.uint8)).tag_id.tolist())


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
def test_laying_errors_have_the_maps_statistics(scale):
    sigma = {"xy": 0.004, "z": 0.001, "yaw_deg": 2.0, "tilt_deg": 0.5}
    tag_map, runs = floor_of(12, sigma=sigma), 6
    d = []
    for seed in range(runs):
        laid = scene_of(tag_map, seed=seed, laying_scale=scale).tag_map
        R_TW = np.swapaxes(tag_map.R_WT, 1, 2)
        dp = np.einsum("nij,nj->ni", R_TW, laid.p_WT - tag_map.p_WT)
        d.append(np.concatenate([dp, geo.log(R_TW @ laid.R_WT)], axis=1) / tag_map.laying_sigma)
    d = np.concatenate(d) / scale
    low, high = chi2.ppf([0.0005, 0.9995], len(d)) / len(d)
    assert ((d**2).mean(axis=0) > low).all()
    assert ((d**2).mean(axis=0) < high).all()
    assert np.abs(np.corrcoef(d.T) - np.eye(6)).max() < 4.0 / np.sqrt(len(d))
    assert np.abs(d.mean(axis=0)).max() < 4.0 / np.sqrt(len(d))


def test_without_laying_errors_the_map_is_the_world():
    tag_map = floor_of()
    laid = scene_of(tag_map).tag_map
    np.testing.assert_array_equal(laid.p_WT, tag_map.p_WT)
    np.testing.assert_allclose(laid.R_WT, tag_map.R_WT, atol=1e-15)


def test_a_picture_shows_the_tags_where_they_truly_lie():
    tag_map = floor_of(sigma={"xy": 0.004, "z": 0.001, "yaw_deg": 1.0, "tilt_deg": 0.5})
    scene, camera = scene_of(tag_map, laying_scale=1.0), camera_of("none", 640, 480)
    detector = make_detector("apriltag", tag_map.family)
    image = picture(scene, camera, still(tilted(), ABOVE)).astype(np.uint8)
    found = detector.detect(image)
    errors = []
    for world in (scene.tag_map, tag_map):
        exact = pixels_of(camera, tilted(), ABOVE, world.corners_W[world.rows(found.tag_id)])
        errors.append(np.sqrt(np.mean((found.corners_px - exact) ** 2)))
    assert len(found) >= 20
    assert errors[0] < 0.06
    assert errors[1] > 1.0


def test_hidden_tags_are_not_there_and_the_others_are():
    tag_map = floor_of()
    all_ids = set(tag_map.tag_id.tolist())
    none, half = scene_of(tag_map), scene_of(tag_map, hidden_share=0.5)
    assert ids_seen(none) == all_ids
    assert len(half.hidden) == 18
    assert set(half.tag_map.tag_id.tolist()) == all_ids - set(half.hidden.tolist())
    assert ids_seen(half) == all_ids - set(half.hidden.tolist())
    assert len(scene_of(tag_map, hidden_share=1.0).tag_map) == 0
    assert ids_seen(scene_of(tag_map, hidden_share=1.0)) == set()


def test_a_larger_share_hides_the_same_tags_and_more_and_moves_none():
    tag_map = floor_of(sigma={"xy": 0.004})
    scenes = [scene_of(tag_map, hidden_share=s, laying_scale=1.0) for s in (0.0, 0.2, 0.6)]
    hidden = [set(s.hidden.tolist()) for s in scenes]
    assert hidden[0] < hidden[1] < hidden[2]
    shared = scenes[2].tag_map.tag_id
    for scene in scenes:
        at = scene.tag_map.p_WT[scene.tag_map.rows(shared)]
        np.testing.assert_array_equal(at, scenes[2].tag_map.p_WT)


def test_torn_tags_cannot_be_read_and_the_others_can():
    for family in ("tagStandard41h12", "tag36h11"):
        tag_map = floor_of(6, 0.06, 0.125, family)
        scene = scene_of(tag_map, torn_share=0.5, texture={"kind": "tiles"})
        assert len(scene.torn) == 18
        expected = set(tag_map.tag_id.tolist()) - set(scene.torn.tolist())
        assert ids_seen(scene) == expected


def test_a_tear_takes_a_third_to_a_half_of_the_tag_and_leaves_the_rest():
    tag_map = floor_of(1, 0.2)
    camera = camera_of("none")
    whole = picture(scene_of(tag_map, floor_grey=128.0), camera, still(DOWN, ABOVE))
    for seed in range(8):
        scene = scene_of(tag_map, seed=seed, torn_share=1.0)
        torn = picture(scene, camera, still(DOWN, ABOVE))
        tag = whole != 128.0
        gone = (torn == 128.0) & tag
        assert 0.3 < gone.sum() / tag.sum() < 0.52
        same = (torn == whole) & tag
        assert (same | gone)[tag].mean() > 0.95  # all but the torn edge
        assert (torn == 128.0)[~tag].mean() > 0.999  # an edge's mean may be 128 by chance


@pytest.mark.parametrize("height_m", [0.0, 0.1])
def test_an_object_hides_the_tags_below_it(height_m):
    tag_map = floor_of(4, 0.06, 0.12)
    scene = scene_of(
        tag_map,
        seed=3,
        laying_scale=2.0,
        occluders={"count": 4, "size_m": 0.1, "height_m": height_m},
    )
    camera, kinds = camera_of("none", 640, 480), scene.patches.kind[len(tag_map) :]
    assert (kinds == (0 if height_m else BLOB)).all()
    image = picture(scene, camera, still(DOWN, ABOVE))
    plain = picture(scene_of(tag_map, seed=3, laying_scale=2.0), camera, still(DOWN, ABOVE))
    for i in range(len(tag_map), len(scene.patches.kind)):
        if scene.patches.R_WP[i, 2, 2] > 0.99:  # tops
            code = scene.patches.cells[scene.patches.first[i]]
            at = np.rint(pixels_of(camera, DOWN, ABOVE, scene.patches.p_WP[i])).astype(int)
            assert image[at[1], at[0]] == round(scene.grey[code])
    covered = image != plain
    assert 0.01 < covered.mean() < 0.3
    lost = ids_seen(scene_of(tag_map, seed=3, laying_scale=2.0)) - ids_seen(scene)
    assert lost


def test_a_box_is_closed_and_shows_its_sides_aslant():
    tag_map = floor_of(2, 0.06, 0.12)
    scene = scene_of(tag_map, seed=1, occluders={"count": 1, "size_m": 0.12, "height_m": 0.1})
    camera = camera_of("none")
    greys = {float(round(g)) for g in scene.grey[4:7]}
    middle = scene.patches.p_WP[len(tag_map)]
    for yaw in (0.3, 2.0, 4.0):
        R = geo.exp(np.array([0.0, 0.0, yaw])) @ DOWN @ geo.exp(np.array([0.6, 0.0, 0.0]))
        image = picture(scene, camera, still(R, middle - 0.6 * R[:, 2]))
        shown = [np.isclose(image, g).sum() for g in sorted(greys)]
        assert sum(n > 150 for n in shown) >= 2  # the top and at least one side


def test_objects_are_where_they_were_from_every_view():
    scene = scene_of(floor_of(3), seed=2, occluders={"count": 2, "size_m": 0.08})
    one = picture(scene, camera_of(), still(DOWN, ABOVE))
    two = picture(scene, camera_of(), still(DOWN, ABOVE))
    np.testing.assert_array_equal(one, two)
    other = scene_of(floor_of(3), seed=3, occluders={"count": 2, "size_m": 0.08})
    assert np.abs(picture(other, camera_of(), still(DOWN, ABOVE)) - one).max() > 20.0


def test_grey_levels_are_those_of_the_config():
    scene = scene_of(floor_of(2), black_grey=40.0, white_grey=180.0, floor_grey=90.0)
    assert set(np.unique(picture(scene, camera_of(), still(DOWN, ABOVE)))) >= {40.0, 90.0, 180.0}


@pytest.mark.parametrize("kind", ["wood", "tiles", "concrete"])
def test_a_floor_has_its_grey_and_its_strength_and_does_not_flicker_with_distance(kind):
    scene = scene_of(
        floor_of(1), hidden_share=1.0, texture={"kind": kind, "strength_share": 0.3}
    )  # fmt: skip
    means, spreads = [], []
    for height in (0.3, 0.8, 2.4):
        image = picture(scene, camera_of(), still(tilted(), np.array([0.4, 0.7, height])), FAST)
        means.append(image.mean())
        spreads.append(image.std())
        assert image.min() >= 128.0 * 0.69
        assert image.max() <= 128.0 * 1.31
    np.testing.assert_allclose(means, 128.0, atol=12.0)
    assert 2.0 < min(spreads) <= max(spreads) < 0.3 * 128.0
    assert means[2] == pytest.approx(128.0, abs=4.0)  # most of a period in view


def test_a_texture_stands_still_while_the_camera_moves():
    scene = scene_of(floor_of(1), hidden_share=1.0, texture={"kind": "wood"})
    camera = camera_of("none")
    here = picture(scene, camera, still(DOWN, np.array([0.0, 0.0, 1.0])))
    there = picture(scene, camera, still(DOWN, np.array([20.0 / 265.0, 0.0, 1.0])))
    assert here.std() > 5.0
    assert np.abs(here[:, 20:] - there[:, :-20]).max() <= 2.0
    blurred = picture(scene, camera, gliding(DOWN, ABOVE), LensConfig(exposure_s=0.05))
    assert blurred.std() < picture(scene, camera, still(DOWN, ABOVE)).std()


def test_a_floor_seen_along_itself_fades_and_does_not_shimmer():
    scene = scene_of(floor_of(1), hidden_share=1.0, texture={"kind": "wood"})
    R = DOWN @ geo.exp(np.array([np.radians(80.0), 0.0, 0.0]))
    image = picture(scene, camera_of("none"), still(R, np.array([0.0, 0.0, 0.5])), FAST)
    horizon = int(120 - 265 * np.tan(np.radians(10.0)))
    steps = np.abs(np.diff(image, axis=1)).mean(axis=1)
    assert steps[horizon + 2 : horizon + 12].max() < 0.5 < steps[-20:].mean()


def test_a_tag_map_may_be_displaced_by_other_sigmas():
    tag_map = floor_of(20)
    sigma = (0.01, 0.0, 0.0, 0.0)
    moved = displaced(tag_map, np.random.default_rng(1), sigma, scale=2.0)
    d = moved.p_WT - tag_map.p_WT
    assert d[:, :2].std() == pytest.approx(0.02, rel=0.1)
    assert np.abs(d[:, 2]).max() < 1e-12


@pytest.mark.parametrize(
    ("model", "data", "says"),
    [
        (SceneConfig, {"hidden_shar": 0.1}, "unknown 'hidden_shar'; choose one of laying_scale"),
        (
            SceneConfig,
            {"texture": {"kind": "carpet"}},
            "unknown 'carpet'; choose one of plain, wood",
        ),
        (SceneConfig, {"torn_share": 1.5}, "torn_share"),
        (SceneConfig, {"occluders": {"count": 81}}, "occluders.count"),
        (SceneConfig, {"light": {"lamps_m": []}}, "light.lamps_m"),
        (LensConfig, {"exposure_ms": 5}, "unknown 'exposure_ms'"),
        (LensConfig, {"gamma": float("nan")}, "gamma"),
        (LensConfig, {"jpeg_quality": 0}, "jpeg_quality"),
    ],
)
def test_a_wrong_key_or_value_is_named(model, data, says):
    with pytest.raises(ConfigError, match=r"scenario\.yaml") as err:
        validated(model, data, "scenario.yaml")
    assert says in str(err.value)
    with pytest.raises(ValidationError):
        SceneConfig().hidden_share = 0.5


def test_torn_ids_are_there_and_kept_with_their_patches():
    scene = scene_of(floor_of(), torn_share=0.3, hidden_share=0.3)
    assert set(scene.torn.tolist()) <= set(scene.tag_map.tag_id.tolist())
    kinds = scene.patches.kind[: len(scene.tag_map)]
    torn = scene.tag_map.tag_id[kinds == TORN]
    assert set(torn.tolist()) == set(scene.torn.tolist())
