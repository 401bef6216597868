"""The map's metres and the accelerometer's sign follow from the motion, gravity unknown."""

from dataclasses import replace

import numpy as np
import pytest
from flights import CAMERA, fly
from study_flights import PoseNoise

from tagvo import geometry as geo
from vio.setup_check.hypotheses import StatedRig, Turns
from vio.setup_check.metric_scale import (
    Path,
    check_scale,
    differences,
    doubled,
    estimate_scale,
)

RIG = StatedRig(CAMERA.R_CI, 0.0, None)


def path(name="T3", seed=0, seconds=24.0, white=(0.003, 0.15)):
    """A simulated flight as the watch would gather it."""
    noise = PoseNoise(white=white, slow=(0.0, 0.0), outliers=0.0, dropouts=0, stamp_s=0.0)
    flown = fly(name, seed, noise, seconds=seconds)
    poses = [p for _, p in flown.poses][::4]
    R, p_WC = (np.array([getattr(p, key) for p in poses]) for key in ("R_WC", "p_WC"))
    t = np.array([p.t_ns for p in poses]) * 1e-9
    turns = Turns(
        t[:-1], t[1:], geo.log(np.swapaxes(R[:-1], -1, -2) @ R[1:]),
        np.full(len(t) - 1, np.radians(0.2)), R[:-1],
        np.array([s.t_ns for s in flown.imu]) * 1e-9,
        np.array([s.gyro_I for s in flown.imu]), np.array([s.accel_I for s in flown.imu]),
    )  # fmt: skip
    return Path(turns, np.stack([p_WC[:-1], p_WC[1:]], axis=1))


@pytest.fixture(scope="module")
def lively():
    return path()


def check(one):
    return check_scale(one, RIG, CAMERA.p_CI)


def with_force(one, factor):
    return replace(one, turns=replace(one.turns, accel=factor * one.turns.accel))


def test_a_right_setup_tells_its_scale_and_earns_no_word(lively):
    scale = estimate_scale(differences(doubled(lively), RIG, CAMERA.p_CI))
    assert scale.k == pytest.approx(1.0, abs=max(0.03, 3.0 * scale.sigma))
    assert scale.g == pytest.approx(9.81, abs=0.3)
    assert check(lively) == ([], True)


@pytest.mark.parametrize("k", [1.35, 1.8, 0.6, 100.0])
def test_wrong_metres_are_named_with_their_factor(lively, k):
    (found,), told = check(replace(lively, p_WC=k * lively.p_WC))
    assert told
    assert (found.code, found.certain) == ("size_kind", True)
    assert found.value == pytest.approx(k, rel=0.05)
    assert ("centimetres for metres" in found.text) == (k == 100.0)


def test_wrong_metres_within_errors_of_a_calibration_are_silent(lively):
    assert check(replace(lively, p_WC=1.05 * lively.p_WC)) == ([], True)


def test_the_accelerometers_sign_is_told_by_the_motion(lively):
    (found,), _ = check(with_force(lively, -1.0))
    assert (found.code, found.certain) == ("gravity", True)
    assert "the accelerometer's sign" in found.text


def test_a_wrong_unit_of_force_is_not_taken_for_the_maps(lively):
    assert check(with_force(lively, 1.3)) == ([], True)


@pytest.mark.parametrize(
    "edit",
    [
        lambda one: replace(one, p_WC=1.3 * one.p_WC + 0.03 * np.sin(1e3 * one.p_WC)),  # noise
        lambda one: replace(one, p_WC=np.broadcast_to(one.p_WC[:1, :1], one.p_WC.shape)),  # rest
        lambda one: Path(one.turns.window(slice(0, 30)), 1.8 * one.p_WC[:30]),  # few
    ],
)
def test_what_tells_nothing_is_silent(lively, edit):
    assert check(edit(lively)) == ([], False)


def test_frames_that_are_missing_break_the_chain(lively):
    one = lively.turns
    broken = replace(one, b_s=one.b_s - 0.01 * (np.arange(len(one.b_s)) == 10))
    assert one.a_s[10] in doubled(lively).turns.a_s
    assert one.a_s[10] not in doubled(Path(broken, lively.p_WC)).turns.a_s
