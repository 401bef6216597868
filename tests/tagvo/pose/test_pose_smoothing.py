"""FIR: lag of both sets of taps, the start, gaps and stamps that run backwards."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from strategies import rotvecs, seeds

from tagvo import geometry as geo
from tagvo.pose.smoothing import TAPS, Fir

STEP = 50_000_000  # 20 Hz
V, W = np.array([0.5, -0.2, 0.1]), np.array([0.0, 0.0, 0.3])


def ramp(taps, count=8, gap_s=0.25, start=0):
    fir = Fir(taps, gap_s)
    t = 0.05 * np.arange(count)
    out = [fir(start + k * STEP, V * s, geo.exp(W * s)) for k, s in enumerate(t)]
    return t, out


def test_endpoint_taps_are_those_of_a_line():
    assert_allclose(TAPS["endpoint"](5), [-0.2, 0.0, 0.2, 0.4, 0.6], atol=1e-15)
    for count in range(1, 6):
        t = np.arange(count)
        y = np.random.default_rng(count).standard_normal(count)
        line = np.polyval(np.polyfit(t, y, min(1, count - 1)), t[-1])
        assert_allclose(TAPS["endpoint"](count) @ y, line, atol=1e-12)
        assert_allclose(TAPS["paper"](count).sum(), 1.0)


def test_endpoint_has_no_lag_at_constant_velocity_even_at_the_start():
    t, out = ramp("endpoint")
    for s, (p, R) in zip(t, out, strict=True):
        assert_allclose(p, V * s, atol=1e-12)
        assert_allclose(R, geo.exp(W * s), atol=1e-5)


def test_paper_taps_lag_two_frames():
    t, out = ramp("paper")
    for s, (p, R) in list(zip(t, out, strict=True))[4:]:
        assert_allclose(p, V * (s - 0.1), atol=1e-12)
        assert_allclose(geo.log(R), W * (s - 0.1), atol=1e-6)


@pytest.mark.parametrize("taps", TAPS)
def test_the_first_pose_passes_unchanged(taps):
    _, out = ramp(taps, count=1)
    assert_allclose(out[0][0], 0.0)
    assert_allclose(out[0][1], np.eye(3))


@pytest.mark.parametrize("taps", TAPS)
@pytest.mark.parametrize("jump", [250_000_001, 0, -1, -10 * STEP])
def test_a_gap_or_a_stamp_that_is_not_later_restarts(taps, jump):
    fir = Fir(taps, 0.25)
    for k in range(5):
        fir(k * STEP, np.zeros(3), np.eye(3))
    p, R = fir(4 * STEP + jump, np.ones(3), geo.exp(W))
    assert_allclose(p, 1.0)
    assert_allclose(R, geo.exp(W), atol=1e-12)


def test_a_gap_of_just_the_limit_does_not_restart():
    fir = Fir("paper", 0.25)
    fir(0, np.zeros(3), np.eye(3))
    assert_allclose(fir(250_000_000, np.ones(3), np.eye(3))[0], 0.5)


@given(rotvecs, st.sampled_from(sorted(TAPS)))
def test_a_standing_pose_stays(phi, taps):
    fir, R = Fir(taps, 0.25), geo.exp(phi)
    for k in range(7):
        _, out = fir(k * STEP, np.ones(3), R @ geo.exp(np.array([1e-9 * (-1) ** k, 0, 0])))
        assert_allclose(out, R, atol=1e-7)  # also where the sign of the quaternion flips


@given(seeds, st.sampled_from(sorted(TAPS)))
def test_any_rotations_give_a_rotation(seed, taps):
    rng, fir = np.random.default_rng(seed), Fir(taps, 0.25)
    for k in range(7):
        _, R = fir(k * STEP, np.zeros(3), geo.exp(3.0 * rng.standard_normal(3)))
        assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
