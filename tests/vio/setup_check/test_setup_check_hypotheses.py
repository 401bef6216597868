"""The set-up check names each mistake from two windows of a lively flight, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from flights import CAMERA, fly
from simulated import arena
from study_flights import PoseNoise

from tagvo import geometry as geo
from vio.setup_check.findings import axes_words
from vio.setup_check.hypotheses import (
    StatedRig,
    Turns,
    attitudes,
    check_force,
    check_gravity,
    check_setup,
    enough,
    imu_turns,
)
from vio.setup_check.watch import check_sizes, pitch_ratio
from vio.sources.imu_check import check_stamps

VO = PoseNoise(white=(0.004, 0.15), slow=(0.0, 0.0), outliers=0.02, dropouts=0, stamp_s=0.0)
UP = np.array([0.0, 0.0, 1.0])
RIG = StatedRig(CAMERA.R_CI, 0.0, UP)


def turns(name="T3", seed=0, seconds=24.0):
    """Turns of a simulated flight as the watch would gather them."""
    flown = fly(name, seed, VO, seconds=seconds)
    poses = [p for _, p in flown.poses][::4]
    R = np.array([p.R_WC for p in poses])
    t = np.array([p.t_ns for p in poses]) * 1e-9
    return Turns(
        t[:-1], t[1:], geo.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]),
        np.full(len(t) - 1, np.radians(0.2)), R[:-1],
        np.array([s.t_ns for s in flown.imu]) * 1e-9,
        np.array([s.gyro_I for s in flown.imu]), np.array([s.accel_I for s in flown.imu]),
    )  # fmt: skip


@pytest.fixture(scope="module")
def lively():
    return turns()


def through(S):
    return lambda t: replace(t, gyro=t.gyro @ S.T, accel=t.accel @ S.T)


FRD, SWAP = np.diag([1.0, -1.0, -1.0]), np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]])
MISTAKES = {  # edit of what is measured -> code, value within
    "accelerometer's sign": (lambda t: replace(t, accel=-t.accel), "gravity", (175.0, 180.0)),
    "FRD": (through(FRD), "imu_axes", (179.0, 180.1)),
    "swapped": (through(SWAP), "imu_axes", (-1.0, -1.0)),
    "gyro's z": (lambda t: replace(t, gyro=t.gyro * [1, 1, -1]), "imu_axes", (-1.0, -1.0)),
    "all of the gyro": (lambda t: replace(t, gyro=-t.gyro), "imu_axes", (-1.0, -1.0)),
    "0.3 s late": (lambda t: replace(t, t_s=t.t_s + 0.3), "time_offset", (0.29, 0.31)),
    "0.12 s early": (lambda t: replace(t, t_s=t.t_s - 0.12), "time_offset", (-0.13, -0.11)),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named_and_certain(lively, mistake):
    edit, code, (low, high) = MISTAKES[mistake]
    found = check_setup(edit(lively), RIG)
    assert [f.code for f in found] == [code]
    assert found[0].certain
    assert low <= found[0].value <= high


@pytest.mark.parametrize("deg", [90.0, 180.0, -90.0, 47.0, 33.0])
def test_a_turned_camera_is_named_with_its_angle(lively, deg):
    file = replace(RIG, R_CI=RIG.R_CI @ geo.exp(np.array([0.0, 0.0, np.radians(deg)])))
    (found,) = check_setup(lively, file)
    assert found.code == "cam_imu_rotation"
    assert found.certain
    assert found.value == pytest.approx(abs(deg), abs=2.0)


def test_a_mirror_that_is_no_exchange_of_axes_is_called_so(lively):
    mirror = geo.exp(np.array([0.3, -0.5, 0.2])) @ np.diag([1.0, 1.0, -1.0])
    (found,) = check_setup(replace(lively, gyro=lively.gyro @ mirror.T), RIG)
    assert (found.code, found.certain) == ("mirrored", True)


def test_a_tilt_of_ten_degrees_is_said_but_not_certain(lively):
    file = replace(RIG, R_CI=RIG.R_CI @ geo.exp(np.array([np.radians(10.0), 0.0, 0.0])))
    found = check_setup(lively, file)
    assert found
    assert {f.code for f in found} <= {"cam_imu_rotation", "gravity"}
    assert not any(f.certain for f in found)
    assert found[0].value == pytest.approx(10.0, abs=1.5)


@pytest.mark.parametrize("name", ["T1", "T3"])
def test_a_right_set_up_is_silent(name):
    for seed in range(8):
        assert check_setup(turns(name, 100 + seed), RIG) == []


def test_a_calibration_within_its_prior_is_silent(lively):
    off = geo.exp(np.radians(3.0) * np.array([0.6, 0.0, 0.8]))
    assert (
        check_setup(replace(lively, t_s=lively.t_s + 0.03), replace(RIG, R_CI=RIG.R_CI @ off)) == []
    )


def test_without_enough_turning_only_gravity_is_judged():
    still = turns("T1", 5, seconds=8.0)
    calm = replace(still, phi_C=0.02 * still.phi_C, gyro=0.02 * still.gyro)
    assert not enough(calm, RIG)
    assert check_setup(replace(calm, t_s=calm.t_s + 0.3), RIG) == []


def test_gravity_is_not_judged_where_the_map_knows_none(lively):
    unknown = replace(RIG, up_W=None)
    assert check_gravity(lively, unknown) is None
    assert check_setup(replace(lively, accel=-lively.accel), unknown) == []


def test_an_imu_without_specific_force():
    assert check_force(np.full((50, 3), [0.0, 0.0, 9.8])) is None
    found = check_force(np.zeros((50, 3)))
    assert found is not None
    assert (found.code, found.certain) == ("no_specific_force", True)


def test_attitudes_equal_the_product_of_turns_one_by_one():
    rng = np.random.default_rng(0)
    t, w = np.cumsum(rng.uniform(0.004, 0.006, 37)), rng.normal(size=(37, 3))
    R = np.eye(3)
    q = attitudes(t, w)
    for k in range(1, 37):
        R = R @ geo.exp(0.5 * (t[k] - t[k - 1]) * (w[k] + w[k - 1]))
        np.testing.assert_allclose(geo.matrix_from_quat(q[k]), R, atol=1e-12)


def test_turns_of_camera_and_imu_are_the_same_rotation_seen_twice():
    flown = turns(seed=3)
    phi_I = imu_turns(flown, np.array([0.0]))[0]
    left = np.median(np.linalg.norm(flown.phi_C - phi_I @ CAMERA.R_CI.T, axis=1))
    assert left < np.radians(0.5)
    assert np.median(np.linalg.norm(phi_I, axis=1)) > np.radians(2.0)


def test_words_of_axes():
    assert "FRD" in axes_words(FRD)
    assert axes_words(SWAP) == "x is y of what comes, y is x of what comes"


@pytest.mark.parametrize("factor", [1.8, 1.0 / 1.8, 1.0, 1.05])
def test_sizes_are_judged_by_the_pitch_of_the_tags(factor):
    tag_map, rng = arena(), np.random.default_rng(0)
    R_CW = geo.exp(np.array([np.pi - 0.1, 0.2, 0.0]))
    rows = np.array([0, 2, 5, 9])
    ratios = []
    for _ in range(40):
        p_CT = (tag_map.p_WT[rows] @ R_CW.T + [0.0, 0.0, 1.2]) / factor
        noisy = p_CT * (1.0 + 0.02 * rng.normal(size=(4, 1)))
        ratios.append(pitch_ratio(noisy, tag_map.p_WT[rows], tag_map.size[rows]))
    found = check_sizes(np.array(ratios), tag_map)
    if factor in (1.0, 1.05):
        assert found == []
    else:
        assert [(f.code, f.certain) for f in found] == [("size_kind", True)]
        assert found[0].value == pytest.approx(factor, rel=0.03)
        assert "size_kind: total?" in found[0].text


@pytest.mark.parametrize(("divisor", "unit"), [(1000, "microseconds"), (10**6, "milliseconds")])
def test_stamps_in_another_unit(divisor, unit):
    imu = np.arange(1200) * 5_000_000 + 1_700_000_000_000_000_000
    frames = imu[::7]
    assert check_stamps(imu, frames, "log") is None
    found = check_stamps(imu // divisor, frames // divisor, "log")
    assert found is not None
    assert unit in found.text
    assert "nanoseconds are needed" in found.text
    alone = check_stamps(imu, frames // 1000, "log")
    assert alone is not None
    assert alone.code == "stamp_unit"


def test_an_inverted_transform_is_called_by_its_name():
    R_CI = geo.exp(np.array([0.9, 0.3, 0.4]))
    true = turns()
    turned = through(R_CI.T @ CAMERA.R_CI)(true)
    assert check_setup(turned, replace(RIG, R_CI=R_CI)) == []
    (found,) = check_setup(turned, replace(RIG, R_CI=R_CI.T))
    assert found.code == "cam_imu_rotation"
    assert found.certain
    assert "this is T_imu_cam, the inverse" in found.text
