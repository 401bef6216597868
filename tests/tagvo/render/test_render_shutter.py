"""Patterns of samples and times of exposure: evenness, symmetry, and motion told in pixels."""

import numpy as np
import pytest
from scenes import camera_of, gliding, moving, pixels_of, still, tilted
from simulated import DOWN

from tagvo import geometry as geo
from tagvo.render.shutter import Seen, lattice, motion, pattern, row_times, thinned, wander_px, way

CAMERA = camera_of("radtan", 640, 480)
ABOVE = np.array([0.0, 0.0, 0.8])
RAYS = np.stack(np.meshgrid([-0.5, -0.2, 0.1, 0.4], [-0.4, 0.0, 0.3]), axis=-1).reshape(-1, 2)
SEEN = Seen(CAMERA, RAYS, 10.0)


@pytest.mark.parametrize("n", [1, 4, 9, 25, 64, 100, 128])
@pytest.mark.parametrize("dims", [2, 3])
def test_a_pattern_is_even_along_each_axis_and_symmetric(n, dims):
    points = lattice(n, dims)
    assert points.shape == (n, dims)
    even = (np.arange(n) + 0.5) / n - 0.5
    for axis in range(dims):
        np.testing.assert_allclose(np.sort(points[:, axis]), even, atol=1e-12)
    turned = {tuple(np.round(-p, 9) + 0.0) for p in points}
    assert turned == {tuple(np.round(p, 9) + 0.0) for p in points}


def share_below(points, normal, at):
    return (points @ normal < at).mean()


@pytest.mark.parametrize("dims", [2, 3])
def test_a_pattern_is_better_at_edges_than_chance(dims):
    rng = np.random.default_rng(0)
    dense = rng.uniform(-0.5, 0.5, (40_000, dims))
    errors, chance, points = [], [], lattice(64, dims)
    for _ in range(60):
        normal, at = rng.normal(size=dims), rng.uniform(-0.3, 0.3)
        volume = share_below(dense, normal, at)
        errors.append(share_below(points, normal, at) - volume)
        chance.append(share_below(rng.uniform(-0.5, 0.5, (64, dims)), normal, at) - volume)
    assert np.std(errors) < 0.35 * np.std(chance)
    assert abs(np.mean(errors)) < 0.006


def test_instants_have_all_places_each_and_samples_come_in_the_order_of_time():
    instants = pattern(4, 5, 3.0)
    assert len(instants) == 80
    times, counts = np.unique(instants[:, 2], return_counts=True)
    np.testing.assert_allclose(times, [-0.4, -0.2, 0.0, 0.2, 0.4], atol=1e-12)
    assert (counts == 16).all()
    for blur in (0.5, 5.0, 500.0):
        samples = pattern(4, 0, blur)
        assert (np.diff(samples[:, 2]) >= 0.0).all()
        assert len(samples) >= max(32, 2 * blur)
    assert (pattern(4, 0, 0.0)[:, 2] == 0.0).all()
    assert len(pattern(4, 7, 0.0)) == 16  # nothing moves: one instant does


def test_rows_share_the_read_out_evenly_about_the_middle():
    rows = row_times(2.0, 0.02, 480, 0)
    assert rows[[0, -1]].tolist() == pytest.approx([1.99, 2.01])
    assert rows.mean() == pytest.approx(2.0)
    wide = row_times(2.0, 0.02, 480, 3)
    np.testing.assert_allclose(wide[3:-3], rows, atol=1e-15)
    assert (np.diff(wide) > 0).all()
    assert (row_times(2.0, 0.0, 480, 0) == 2.0).all()


def vibrating(t, hz=150.0):
    wave = np.sin(2 * np.pi * hz * t)[:, None] * np.radians([0.1, 0.05, 0.0])
    return tilted() @ geo.exp(wave), ABOVE + t[:, None] * [0.3, 0.0, 0.0]


def test_blur_is_the_length_of_the_way_in_pixels():
    pose, exposure = moving(DOWN, ABOVE, v_W=(0.6, 0.0, 0.0)), 0.01
    flown = way(pose, -0.02, 0.02)
    blur, points = motion(Seen(camera_of("none", 640, 480), RAYS, 10.0), flown, 0.0, exposure)
    assert blur == pytest.approx(0.6 * exposure * 530.0 / 0.8, rel=1e-6)
    assert points == 2  # an even way is a straight line
    assert motion(SEEN, flown, 0.0, 0.0) == (0.0, 1)
    assert motion(SEEN, way(still(DOWN, ABOVE), -0.02, 0.02), 0.0, exposure) == (0.0, 1)
    shaking, points = motion(SEEN, way(vibrating, -0.02, 0.02), 0.0, exposure)
    assert shaking > 4.0  # there and back three times
    assert points >= 9


def test_what_is_near_moves_faster_than_the_floor():
    pose = moving(DOWN, ABOVE, v_W=(0.6, 0.0, 0.0))
    camera = camera_of("none", 640, 480)
    blur, _ = motion(Seen(camera, RAYS, 0.4), way(pose, -0.02, 0.02), 0.0, 0.01)
    assert blur == pytest.approx(0.6 * 0.01 * 530.0 / 0.4, rel=1e-6)


@pytest.mark.parametrize("pose_at", [gliding(tilted(), ABOVE), vibrating])
def test_the_way_between_its_knots_is_within_a_fiftieth_of_a_pixel(pose_at):
    flown = way(pose_at, 0.1, 0.14)
    kept = thinned(flown, SEEN)
    t = np.linspace(0.1, 0.14, 333)
    points = np.array([[0.1, 0.1, 0.0], [-0.3, 0.2, 0.0], [0.2, -0.2, 0.1]])
    exact, follows = pose_at(t), kept.pose(t)
    for k in range(len(t)):
        a = pixels_of(CAMERA, exact[0][k], exact[1][k], points)
        p_C = (points - follows[1][k]) @ follows[0][k]  # not quite a rotation between knots
        b = pixels_of(CAMERA, np.eye(3), np.zeros(3), p_C)
        assert np.abs(a - b).max() < 0.035
    assert len(kept.p_WC) <= len(flown.p_WC)
    if pose_at is not vibrating:
        assert len(kept.p_WC) <= 9  # an even way needs few
    assert wander_px(SEEN, kept) >= 0.0


def test_a_still_camera_is_asked_once():
    asked = []

    def pose_at(t):
        asked.append(t)
        return still(DOWN, ABOVE)(t)

    flown = way(pose_at, 0.5, 0.5)
    assert [len(t) for t in asked] == [1]
    R, p = flown.pose(np.array([[0.5, 0.5]]))
    assert R.shape == (1, 2, 3, 3)
    np.testing.assert_array_equal(p[0, 0], ABOVE)
