"""Courses and motions against finite differences of positions and attitudes alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from strategies import seeds
from study_flights import t1, t3

from tagvo import geometry as geo
from vio.sim.world import course as crs
from vio.sim.world.dynamics import DOWN_W, body_flight, inertial, tilt
from vio.sim.world.trajectory import GRAVITY, t1_command, t2_command, t3_command

H = 1e-4  # [s] of central differences


def sines(rng, channels=4, count=5, size=0.3):
    return crs.Sines(
        rng.uniform(0.2, 1.5, count), rng.normal(0.0, size, (count, channels)),
        rng.uniform(0.0, 6.0, (count, channels)),
    )  # fmt: skip


def some_course(seed):
    """Any of what flights are made of, on top of one another."""
    rng = np.random.default_rng(seed)
    command = (t1_command, t2_command, t3_command)[seed % 3]()
    course = crs.later(crs.faster(crs.followed(command), rng.uniform(0.5, 2.0)), 3.0)
    window = lambda t: crs.step(t, 1.0, 2.9) - crs.step(t, 30.0, 32.0)  # noqa: E731
    course = crs.from_the_ground(course, 0.1, window)
    return crs.shaken(course, sines(rng, channels=3, size=0.02), window), window


def slope(f, t, h=H):
    """Fourth-order central difference of f at times (n,)."""
    return (8 * (f(t + h) - f(t - h)) - (f(t + 2 * h) - f(t - 2 * h))) / (12 * h)


@given(seed=seeds)
@settings(max_examples=12)
def test_each_derivative_is_the_slope_of_the_one_before(seed):
    course, _ = some_course(seed)
    t = np.random.default_rng(seed).uniform(0.0, 33.0, 40)
    values = course(t)
    for order in range(crs.ORDERS - 1):
        numeric, rough = (slope(lambda x, k=order: course(x)[k], t, h) for h in (H, 1.7 * H))
        scale = 1.0 + np.abs(values[order + 1]).max()
        smooth = np.abs(numeric - rough).max(axis=1) < 2e-6 * scale  # else across a joint
        assert smooth.sum() >= len(t) - 3
        assert_allclose(values[order + 1][smooth], numeric[smooth], atol=3e-6 * scale)


@pytest.mark.parametrize(
    "course",
    [
        crs.shuttle((1.5, 2.5, 0.9, 1.0), np.array([0.2, 1.5, 0.1]), 0.4, 20.0),
        lambda t: crs.weighed(crs.step(t, 0.2, 1.7), sines(np.random.default_rng(3)).at(t)),
    ],
)
def test_derivatives_of_the_other_courses(course):
    t = np.linspace(-0.513, 20.489, 301)  # beside the joints, where the fourth derivative jumps
    values = course(t)
    for order in range(crs.ORDERS - 1):
        numeric = slope(lambda x, k=order: course(x)[k], t)
        assert_allclose(values[order + 1], numeric, atol=1e-5)


@given(seed=seeds)
@settings(max_examples=12)
def test_the_imu_is_that_of_positions_and_attitudes(seed):
    """Nothing but p_WI(t) and R_WI(t) is looked at: the IMU is their second and first slope."""
    course, window = some_course(seed)
    rng = np.random.default_rng(seed)
    down_W = geo.exp(np.array([*rng.normal(0.0, 0.05, 2), 0.0])) @ DOWN_W
    flight = body_flight(
        course, down_W=down_W, drag_per_s=rng.uniform(0.0, 0.5),
        sway=sines(rng, channels=3, size=0.02), window=window,
    )  # fmt: skip
    t, h = rng.uniform(0.0, 33.0, 40), 1e-4
    gyro, accel = inertial(flight(t), down_W)
    before, now, after = flight(t - h), flight(t), flight(t + h)
    turned = np.swapaxes(before.R_WI, -1, -2) @ after.R_WI
    assert_allclose(gyro, geo.log(turned) / (2 * h), atol=5e-4)
    a_W = (before.p_WI - 2 * now.p_WI + after.p_WI) / h**2
    force_W = a_W - GRAVITY * down_W
    assert_allclose(accel, np.einsum("nji,nj->ni", now.R_WI, force_W), atol=5e-4)
    assert_allclose(now.v_WI, (after.p_WI - before.p_WI) / (2 * h), atol=1e-4)


def test_dead_reckoning_from_the_imu_comes_back_to_the_flight():
    """Integrated from the true start without noise it ends where the flight ends."""
    flight, dt = body_flight(crs.followed(t3_command())), 1e-3
    t = np.arange(0.0, 40.0, dt)
    gyro, accel = inertial(flight(t + 0.5 * dt))
    start, end = flight(t[:1]), flight(t[-1:] + dt)
    p, v, R = start.p_WI[0], start.v_WI[0], start.R_WI[0]
    for w, f, turn in zip(gyro, accel, geo.exp(0.5 * dt * gyro), strict=True):
        assert w.shape == (3,)
        a_W = R @ turn @ f + GRAVITY * DOWN_W
        p, v, R = p + dt * v + 0.5 * dt * dt * a_W, v + dt * a_W, R @ turn @ turn
    assert_allclose(p, end.p_WI[0], atol=1e-3)
    assert np.degrees(geo.angle(R.T @ end.R_WI[0])) < 1e-3


@pytest.mark.parametrize(("command", "old"), [(t1_command, t1), (t3_command, t3)])
def test_the_same_flight_as_that_of_the_filters_study(command, old):
    was, duration = old()
    t = np.linspace(0.0, duration - 0.1, 200)
    a, b = was(t), body_flight(crs.followed(command()))(t)
    for name in ("p_WI", "v_WI", "a_WI", "R_WI"):
        assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12)


def test_rotors_push_along_z_alone_and_drag_asks_for_a_lasting_tilt():
    """A steady 2 m/s: without drag it flies level, with drag k its tilt is atan(k v / g)."""

    def steady(t):
        out = np.zeros((crs.ORDERS, len(t), 4))
        out[0, :, 0], out[1, :, 0] = 2.0 * t, 2.0
        return out

    t = np.array([0.0, 1.0])
    assert_allclose(tilt(body_flight(steady)(t)), 0.0, atol=1e-7)
    motion = body_flight(steady, drag_per_s=0.3)(t)
    assert_allclose(tilt(motion), np.arctan(0.6 / GRAVITY), atol=1e-12)
    assert (motion.R_WI[:, 0, 2] > 0.0).all()  # it leans forward
    thrust_I = inertial(motion)[1] + np.einsum("nji,nj->ni", motion.R_WI, 0.3 * motion.v_WI)
    assert_allclose(thrust_I[:, :2], 0.0, atol=1e-12)


def test_on_the_ground_nothing_moves():
    course, window = some_course(1)
    flight = body_flight(course, window=window, sway=sines(np.random.default_rng(0), 3))
    motion = flight(np.linspace(0.0, 0.99, 50))
    assert_allclose(motion.p_WI[:, 2], 0.1, atol=1e-12)
    assert_allclose(motion.v_WI, 0.0, atol=1e-12)
    assert_allclose(motion.w_WI_I, 0.0, atol=1e-12)
    assert_allclose(inertial(motion)[1], [[0.0, 0.0, GRAVITY]] * 50, atol=1e-9)


@given(seed=seeds, rms=st.floats(0.01, 3.0))
@settings(max_examples=8)
def test_a_random_motion_has_its_power_in_its_band(seed, rms):
    band = (0.5, 4.0)
    waves = crs.band_limited(rms, band, 3, np.random.default_rng(seed))
    rate, n = 50.0, 50 * 400
    x = waves.at(np.arange(n) / rate)[0]
    assert_allclose(x.std(axis=0), rms, rtol=0.1)
    power = np.abs(np.fft.rfft(x * np.hanning(n)[:, None], axis=0)) ** 2
    hz = np.fft.rfftfreq(n, 1.0 / rate)
    outside = power[(hz < 0.45) | (hz > 4.05)].sum(axis=0)
    assert (outside < 1e-4 * power.sum(axis=0)).all()
