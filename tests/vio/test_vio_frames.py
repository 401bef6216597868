"""NED and FRD: golden vectors, an independent way by scipy and by sampling, levelling, headings."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from strategies import seeds

from tagvo import geometry as geo
from vio.frames import (
    Alignment,
    body_velocity,
    euler_321,
    heading_of_map,
    level_frame,
    levelled,
    relevelled,
    tilt,
    to_ned,
    triangle,
)
from vio.records import NavState

EYE, ZERO = np.eye(3), np.zeros(3)
UP = np.array([0.0, 0.0, -1.0])  # gravity of a map that lies on the floor
HEADINGS = (0, 60, 90, 180, 270)


def aligned(heading_deg, down_W=UP, R_BI=EYE, p_BI=ZERO):
    return Alignment(levelled(down_W), np.radians(heading_deg), R_BI, p_BI)


def nav(p=(0, 0, 0), R=EYE, v=(0, 0, 0), cov=None):
    return NavState(0, np.array(p, float), R, np.array(v, float), cov)


GOLDEN = {  # heading of the map's x: north, east, down of (1, 2, 3); yaw of a body along its x
    0: ((1.0, -2.0, -3.0), 0.0),
    60: ((0.5 + np.sqrt(3.0), np.sqrt(0.75) - 1.0, -3.0), 60.0),
    90: ((2.0, 1.0, -3.0), 90.0),
    180: ((-1.0, 2.0, -3.0), 180.0),
    270: ((-2.0, -1.0, -3.0), -90.0),
}


@pytest.mark.parametrize("heading", HEADINGS)
def test_golden_places_and_yaws(heading):
    """Worked by hand: x of the map points at the heading, y to its left, z up."""
    place, yaw = GOLDEN[heading]
    pose = to_ned(nav((1, 2, 3), v=(1, 2, 3)), aligned(heading))
    assert_allclose(pose.p_NB, place, atol=1e-12)
    assert_allclose(pose.v_NB, place, atol=1e-12)
    assert_allclose(np.degrees(euler_321(pose.R_NF)), [0, 0, yaw], atol=1e-9)


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize(
    ("turn_deg", "rpy"),  # about body x (ahead), y (left), z (up): what FRD calls it
    [((20, 0, 0), (20, 0, 0)), ((0, 10, 0), (0, -10, 0)), ((0, 0, 30), (0, 0, -30))],
)
def test_golden_tilts(heading, turn_deg, rpy):
    """Left side up rolls right, +; a turn about left lowers the nose, -; a left turn is yaw -."""
    R = geo.exp(np.radians(np.array(turn_deg, float)))
    got = np.degrees(euler_321(to_ned(nav(R=R), aligned(heading)).R_NF))
    expected = np.array([rpy[0], rpy[1], rpy[2] + heading], float)
    expected[2] = 180 - (180 - expected[2]) % 360
    assert_allclose(got, expected, atol=1e-9)


@given(seeds, st.sampled_from(HEADINGS), st.booleans())
def test_any_body_in_any_map_by_scipy(seed, heading, inside):
    """Build the state from the wanted NED pose the other way round, with scipy's rotations."""
    rng = np.random.default_rng(seed)
    yaw, pitch, roll = rng.uniform([-180, -89, -180], [180, 89, 180])
    R_NF = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    p_N, v_N, w_F = rng.normal(size=(3, 3))
    down_W = rng.normal(size=3)
    down_W /= np.linalg.norm(down_W)
    R_FI = Rotation.from_quat(rng.normal(size=4)) if inside else Rotation.from_euler("x", 180, True)
    lever_F = rng.normal(size=3) * inside  # I in the body
    h = np.radians(heading)
    axis = np.eye(3)[0 if abs(down_W[0]) < 0.9 else 1]  # of the map that bears the heading
    ahead_W = np.cross(np.cross(down_W, axis), down_W)
    ahead_W /= np.linalg.norm(ahead_W)
    right_W = np.cross(down_W, ahead_W)
    ahead_N, right_N = np.array([np.cos(h), np.sin(h), 0]), np.array([-np.sin(h), np.cos(h), 0])
    down_N = np.array([0.0, 0.0, 1.0])
    R_WN = np.stack([ahead_W, right_W, down_W], -1) @ np.stack([ahead_N, right_N, down_N])
    R_WI = R_WN @ R_NF.as_matrix() @ R_FI.as_matrix()
    p_WI = R_WN @ (p_N + R_NF.apply(lever_F))
    v_WI = R_WN @ (v_N + R_NF.apply(np.cross(w_F, lever_F)))
    flip = np.diag([1.0, -1.0, -1.0])
    where = Alignment(levelled(down_W), h, flip @ R_FI.as_matrix(), flip @ lever_F)
    pose = to_ned(NavState(0, p_WI, R_WI, v_WI), where, R_FI.inv().apply(w_F))
    assert_allclose(pose.p_NB, p_N, atol=1e-9)
    assert_allclose(pose.v_NB, v_N, atol=1e-9)
    assert_allclose(pose.w_F, w_F, atol=1e-9)
    assert_allclose(pose.R_NF, R_NF.as_matrix(), atol=1e-9)
    got = euler_321(pose.R_NF)
    assert_allclose(np.degrees(got), [roll, pitch, yaw], atol=1e-6)
    assert ((got > -np.pi) & (got <= np.pi)).all()


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("lever", [(0, 0, 0), (0.3, -0.2, 0.1)])
def test_covariance_by_sampling(heading, lever):
    """Errors drawn of [p, right rotation in I, v], each put through scipy: their scatter in NED."""
    rng = np.random.default_rng(heading)
    A = rng.normal(size=(9, 9)) * np.repeat([0.02, 0.01, 0.03], 3)[:, None]
    cov = A @ A.T
    down_W, w_I = np.array([0.3, -0.8, -0.5]), np.array([0.5, -1.0, 0.8])
    R_BI = Rotation.from_rotvec([0.2, -0.4, 1.0]).as_matrix()
    R_WI = Rotation.from_rotvec([1.0, 0.5, -0.7]).as_matrix()
    where = aligned(heading, down_W, R_BI, np.array(lever, float))
    pose = to_ned(nav((1, 2, 3), R_WI, (0.5, 0.2, -0.3), cov), where, w_I)
    errors = rng.multivariate_normal(np.zeros(9), cov, size=40_000, method="cholesky")
    turns = Rotation.from_matrix(R_WI) * Rotation.from_rotvec(errors[:, 3:6])
    R_NW = where.R_NW
    p_IB = -R_BI.T @ np.array(lever, float)
    p = (np.array([1, 2, 3]) + errors[:, :3] + turns.apply(p_IB)) @ R_NW.T
    v = (np.array([0.5, 0.2, -0.3]) + errors[:, 6:] + turns.apply(np.cross(w_I, p_IB))) @ R_NW.T
    R_NF = Rotation.from_matrix(R_NW) * turns * Rotation.from_matrix(R_BI.T @ np.diag([1, -1, -1]))
    angles = (R_NF * Rotation.from_matrix(pose.R_NF).inv()).as_rotvec()  # about the axes of N
    scatter = np.cov(np.hstack([p - pose.p_NB, angles, v - pose.v_NB]).T)
    scale = np.sqrt(np.outer(np.diag(scatter), np.diag(scatter)))
    assert_allclose(pose.cov / scale, scatter / scale, atol=0.03)
    v_F, v_cov = body_velocity(pose)
    in_body = R_NF.inv().apply(v)
    assert_allclose(v_F, R_NF.mean().inv().apply(pose.v_NB), atol=1e-3)
    spread = np.cov(in_body.T)
    scale = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    assert_allclose(v_cov / scale, spread / scale, atol=0.03)


def test_a_body_beside_i_has_no_velocity_without_a_rate():
    where = aligned(0, p_BI=np.array([0.1, 0.0, 0.0]))
    state = nav(v=(1, 0, 0), cov=np.eye(9))
    assert to_ned(state, where).v_NB is None
    assert to_ned(state, where).cov.shape == (6, 6)
    assert to_ned(state, where, ZERO).v_NB is not None
    assert to_ned(state, aligned(0)).v_NB is not None
    assert body_velocity(to_ned(state, where)) is None


def test_the_triangle_is_row_major_or_all_nan():
    cov = np.arange(81.0).reshape(9, 9)
    cov = cov + cov.T
    got = triangle(cov)
    assert len(got) == 21
    assert got == [cov[i, j] for i in range(6) for j in range(i, 6)]
    diagonal = [got[k] for k in (0, 6, 11, 15, 18, 20)]
    assert diagonal == list(np.diag(cov)[:6])
    broken = []
    for value in (np.nan, np.inf, -np.inf, 1e39, -1.0):
        one = np.eye(6)
        one[2, 2] = value
        broken.append(one)
    for bad in (None, *broken):
        got = triangle(bad)
        assert len(got) == 21
        assert np.isnan(got).all()


# levelling


def test_axes_of_a_map_on_a_wall_or_upside_down():
    """x level stays x; where x stands, y bears the heading."""
    for down in ([0, -1, 0], [0, 0, 1], [0.1, -0.9, 0.2]):
        R = level_frame(np.array(down, float))
        assert R[0, 0] > 0.9
        assert_allclose(R[:, 2], -np.array(down) / np.linalg.norm(down), atol=1e-12)
    for down in ([1, 0, 0], [-1, 0, 0], [-0.98, 0.1, 0.1]):
        R = level_frame(np.array(down, float))
        assert R[1, 0] > 0.9
        assert levelled(np.array(down, float)).axis == 1
    for down in np.random.default_rng(1).normal(size=(50, 3)):
        R = level_frame(down)
        assert_allclose(R.T @ R, EYE, atol=1e-12)
        assert np.linalg.det(R) > 0.0


def test_a_map_on_a_wall_gives_a_level_pose():
    """x right along the wall, y up, z out of it; heading 90: the wall's right is east, z south."""
    where = aligned(90, np.array([0.0, -1.0, 0.0]))
    pose = to_ned(nav((1, 2, 3), Rotation.from_euler("x", -90, degrees=True).as_matrix()), where)
    assert_allclose(pose.p_NB, [-3, 1, -2], atol=1e-12)
    assert_allclose(np.degrees(euler_321(pose.R_NF)), [0, 0, 90], atol=1e-9)


def test_levelling_stays_until_gravity_has_moved_half_a_degree():
    before = levelled(UP)
    small = Rotation.from_euler("y", 0.49, degrees=True).apply(UP)
    same, moved = relevelled(before, small)
    assert same is before
    assert not moved
    large = Rotation.from_euler("y", 0.51, degrees=True).apply(UP)
    after, moved = relevelled(before, large)
    assert moved
    assert tilt(after, large) < 1e-9
    assert np.degrees(tilt(before, large)) == pytest.approx(0.51, abs=1e-6)


def test_levelling_waits_for_a_gravity_that_is_still_being_learnt():
    before, down = levelled(UP), Rotation.from_euler("x", 2.0, degrees=True).apply(UP)
    assert relevelled(before, down, np.radians(0.6))[0] is before
    assert relevelled(before, down, np.radians(0.4))[1]


def test_levelling_anew_keeps_the_axis_that_bears_the_heading():
    """Near the limit between x and y gravity's noise must not turn the map by 90 degrees."""
    before = levelled(np.array([-0.89, 0.0, -np.sqrt(1 - 0.89**2)]))
    assert before.axis == 0
    down = np.array([-0.91, 0.0, -np.sqrt(1 - 0.91**2)])
    after, moved = relevelled(before, down)
    assert moved
    assert after.axis == 0
    assert levelled(down).axis == 1
    assert relevelled(before, np.array([-1.0, 0.0, 1e-3]))[0].axis == 1  # now it stands


@given(seeds)
def test_the_heading_by_a_yaw_gives_that_yaw(seed):
    rng = np.random.default_rng(seed)
    yaw = rng.uniform(-np.pi, np.pi)
    R_WI, R_BI = (Rotation.from_rotvec(r).as_matrix() for r in rng.normal(size=(2, 3)) * 0.7)
    levelling = levelled(np.array([0.2, 0.1, -1.0]))
    heading = heading_of_map(yaw, levelling, R_WI, R_BI)
    assert -np.pi < heading <= np.pi
    pose = to_ned(nav(R=R_WI), Alignment(levelling, heading, R_BI, ZERO))
    assert_allclose(np.exp(1j * euler_321(pose.R_NF)[2]), np.exp(1j * yaw), atol=1e-9)
