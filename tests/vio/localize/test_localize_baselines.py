"""The VO arms: the lever arm, the clock, the covariance carried from camera to IMU, the FIR."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from simulated import pinhole

from tagvo import geometry as geo
from tagvo.records import Frame, PoseMeasurement
from vio.localize.baselines import VoFir, VoOnly, imu_state

R_CI, P_CI = geo.exp(np.array([0.3, -0.7, 1.9])), np.array([0.2, -0.1, 0.05])
CAMERA = pinhole(R_CI=R_CI, p_CI=P_CI, timeshift_s=-0.0123)


def measured(t_ns=100, seed=0):
    rng = np.random.default_rng(seed)
    R_WC = geo.exp(rng.standard_normal(3))
    root = rng.standard_normal((6, 6))
    return PoseMeasurement(t_ns, rng.standard_normal(3), R_WC, root @ root.T, (1,))


def imu_pose(p_WC, R_WC):
    return p_WC + R_WC @ P_CI, R_WC @ R_CI


@given(st.integers(0, 10_000))
def test_pose_of_the_imu_from_that_of_the_camera(seed):
    m = measured(seed=seed)
    out = imu_state(Frame(100), m, CAMERA)
    T_WC, T_CI = np.eye(4), np.eye(4)
    T_WC[:3, :3], T_WC[:3, 3] = m.R_WC, m.p_WC
    T_CI[:3, :3], T_CI[:3, 3] = R_CI, P_CI
    T_WI = T_WC @ T_CI
    assert_allclose(out.R_WI, T_WI[:3, :3], atol=1e-12)
    assert_allclose(out.p_WI, T_WI[:3, 3], atol=1e-12)


def test_covariance_is_carried_by_the_jacobian_that_differences_show():
    m, step = measured(), 1e-6
    p0, R0 = imu_pose(m.p_WC, m.R_WC)
    G = np.zeros((6, 6))
    for k in range(6):
        d = np.zeros(6)
        d[k] = step
        p, R = imu_pose(m.p_WC + d[:3], m.R_WC @ geo.exp(d[3:]))
        G[:, k] = np.concatenate([p - p0, geo.log(R0.T @ R)]) / step
    out = imu_state(Frame(100), m, CAMERA)
    assert_allclose(out.cov, G @ m.cov @ G.T, rtol=1e-4, atol=1e-4)


def test_stamps_move_by_the_timeshift_and_arrival_is_the_frames():
    m = measured(t_ns=10**18 + 1)
    out = imu_state(Frame(10**18 + 1, arrival_ns=10**18 + 77), m, CAMERA)
    assert out.t_ns == 10**18 + 1 - 12_300_000
    assert out.known_ns == 10**18 + 77
    assert imu_state(Frame(10**18 + 1), m, CAMERA).known_ns == 10**18 + 1


def test_vo_says_nothing_without_a_pose():
    assert VoOnly(CAMERA).pose(Frame(1), None) is None
    assert VoFir(CAMERA, "paper", 0.25).pose(Frame(1), None) is None


@pytest.mark.parametrize(("taps", "lag_steps"), [("paper", 2.0), ("endpoint", 0.0)])
def test_fir_lags_as_its_taps_say_on_a_straight_line(taps, lag_steps):
    arm, step_ns, step_m = VoFir(CAMERA, taps, 0.25), 50_000_000, 0.02
    for k in range(8):
        p_WC = np.array([step_m * k, 1.0, 2.0])
        m = PoseMeasurement(k * step_ns, p_WC, np.eye(3), np.eye(6), (1,))
        out = arm.pose(Frame(k * step_ns), m)
    p_true, R_true = imu_pose(p_WC, np.eye(3))
    assert_allclose(out.p_WI, p_true - [lag_steps * step_m, 0, 0], atol=1e-12)
    assert_allclose(out.R_WI, R_true, atol=1e-12)
    assert out.cov is None


def test_two_arms_keep_their_own_past():
    a, b = VoFir(CAMERA, "paper", 0.25), VoFir(CAMERA, "paper", 0.25)
    a.pose(Frame(0), measured(0, seed=1))
    m = measured(1, seed=2)
    assert_allclose(b.pose(Frame(1), m).p_WI, imu_state(Frame(1), m, CAMERA).p_WI, atol=1e-12)
