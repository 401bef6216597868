"""Inertial propagation against second ways: finite differences, dense algebra, van Loan, RK4."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.kernels.so3 import exp_quat
from vio.filter import state as at
from vio.filter.propagation import (
    _relax_bias,
    add_noise,
    mechanise,
    propagate,
    spread,
    transition_into,
)

Q = at.ProcessNoise(*np.square([3e-4, 5e-3, 2e-5, 5e-4, 1e-5, 1e-5]).tolist(), 0.2, 9.81)
PLAIN, BIASED = at.layout(), at.layout(["pose_bias"])
FULL = at.layout(["pose_bias", "lever_arm"])
LEVERED = at.layout(["lever_arm"])
LAYOUTS = [PLAIN, BIASED, LEVERED, FULL]


def a_state(seed):
    rng = np.random.default_rng(seed)
    x = np.zeros(at.NOMINAL)
    x[: at.X_RECENT] = rng.normal(size=at.X_RECENT)
    for i in (at.X_Q, at.X_QIC, at.X_QWL):
        x[i : i + 4] /= np.linalg.norm(x[i : i + 4])
    x[at.X_BG : at.X_BG + 3] *= 0.05
    x[at.X_TD] *= 0.02
    x[at.X_BIAS : at.X_BIAS + 6] *= 0.02
    return x, rng


def retract(x, d, layout=FULL):
    """The state x with the error d (n,) added, by plain NumPy from the table of blocks."""
    x = x.copy()
    for e, size, at_x, turns in layout.rows:
        if not turns:
            x[at_x : at_x + size] += d[e : e + size]
            continue
        phi = np.append(d[e : e + size], np.zeros(3 - size))
        R = geo.matrix_from_quat(x[at_x : at_x + 4]) @ geo.exp(phi)
        x[at_x : at_x + 4] = geo.quat_from_matrix(R)
    return x


def minus(a, b, layout=FULL):
    """The error d (n,) with a = retract(b, d); a level frame's turn about its own z left out."""
    d = np.zeros(layout.n)
    for e, size, at_x, turns in layout.rows:
        if not turns:
            d[e : e + size] = a[at_x : at_x + size] - b[at_x : at_x + size]
            continue
        R_a, R_b = (
            geo.matrix_from_quat(a[at_x : at_x + 4]),
            geo.matrix_from_quat(b[at_x : at_x + 4]),
        )
        d[e : e + size] = geo.log(R_b.T @ R_a)[:size]
    return d


def step(x, w, f, dt):
    x = x.copy()
    mechanise(x, w, f, dt, 9.81, np.empty((3, 3)))
    return x


def dense_transition(x, w, f, dt, n):
    """F (n, n) from the kernel's blocks, about the state before the step."""
    R_mid, B = np.empty((3, 3)), np.empty((6, 11))
    y = x.copy()
    mechanise(y, w, f, dt, 9.81, R_mid)
    transition_into(B, y, w, f, dt, 9.81, R_mid)
    F = np.eye(n)
    columns = [*range(at.TH, at.TH + 9), at.LEVEL, at.LEVEL + 1]
    F[at.P : at.P + 3, at.V : at.V + 3] = dt * np.eye(3)
    F[at.P : at.P + 3, columns] = 0.5 * dt * B[:3]
    F[at.V : at.V + 3, columns] = B[:3]
    F[at.TH : at.TH + 3, at.TH : at.TH + 6] = B[3:, :6]
    return F, B, R_mid


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dt", [0.005, 0.05])
def test_transition_is_the_derivative_of_the_step(seed, dt):
    x, rng = a_state(seed)
    w, f = rng.normal(size=3) * 2.0, rng.normal(size=3) * 10.0
    F, _, _ = dense_transition(x, w, f, dt, 24)
    after, h = step(x, w, f, dt), 1e-6
    numeric = np.zeros((24, 24))
    for i in range(24):
        d = np.zeros(30)
        d[i] = h
        plus, less = step(retract(x, d), w, f, dt), step(retract(x, -d), w, f, dt)
        numeric[:, i] = (minus(plus, after) - minus(less, after))[:24] / (2.0 * h)
    assert_allclose(F, numeric, atol=2e-8)


@pytest.mark.parametrize("n", [layout.n for layout in LAYOUTS])
def test_spread_equals_the_dense_product(n):
    x, rng = a_state(7)
    w, f = rng.normal(size=3), rng.normal(size=3) * 9.0
    A = rng.normal(size=(n, n))
    P = A @ A.T
    F, B, _ = dense_transition(x, w, f, 0.01, n)
    expected = F @ P @ F.T
    spread(P, B, 0.01)
    assert_allclose(P, expected, atol=1e-12 * np.abs(expected).max())
    assert np.array_equal(P, P.T)


def test_process_noise_is_van_loans_to_the_order_it_keeps():
    from filterpy.common import van_loan_discretization

    x, _ = a_state(3)
    f, dt = np.array([0.3, -0.2, 9.7]), 0.005
    R = geo.matrix_from_quat(x[at.X_Q : at.X_Q + 4])
    A, G = np.zeros((15, 15)), np.zeros((15, 12))
    A[0:3, 3:6] = np.eye(3)
    A[3:6, 6:9], A[3:6, 12:15] = -R @ geo.hat(f), -R
    A[6:9, 9:12] = -np.eye(3)
    sigma = np.sqrt([Q.accel, Q.gyro, Q.gyro_walk, Q.accel_walk])
    G[3:6, 0:3], G[6:9, 3:6] = R * sigma[0], np.eye(3) * sigma[1]
    G[9:12, 6:9], G[12:15, 9:12] = np.eye(3) * sigma[2], np.eye(3) * sigma[3]
    _, expected = van_loan_discretization(A, G, dt)
    P = np.zeros((21, 21))
    add_noise(P, R, dt, Q, np.ones(6), PLAIN)
    assert_allclose(np.diag(P)[3:15], np.diag(expected)[3:15], rtol=2e-2)
    assert_allclose(P[0:3, 3:6], expected[0:3, 3:6], atol=2e-2 * P[3, 3] * dt)
    assert P[0, 0] == pytest.approx(expected[0, 0], rel=2e-2)


def test_a_wide_axis_widens_that_axis_alone():
    P, scale = np.zeros((21, 21)), np.ones(6)
    scale[1] = scale[5] = 100.0
    add_noise(P, np.eye(3), 0.005, Q, scale, PLAIN)
    assert P[at.TH + 1, at.TH + 1] == pytest.approx(100.0 * P[at.TH, at.TH])
    assert P[at.V + 2, at.V + 2] == pytest.approx(100.0 * P[at.V, at.V])


def test_ten_seconds_of_midpoint_equal_a_fine_integration():
    def rates(t):
        return np.array([0.8 * np.sin(2 * t), 0.5 * np.cos(3 * t), 0.4]), np.array(
            [np.sin(t), 0.7 * np.cos(2 * t), 9.81]
        )

    def integrate(hz):
        x, _ = a_state(1)
        x[at.X_BG : at.X_BG + 6] = 0.0
        t = np.arange(int(10 * hz) + 1) / hz
        for a, b in pairwise(t):
            (w0, f0), (w1, f1) = rates(a), rates(b)
            x = step(x, 0.5 * (w0 + w1), 0.5 * (f0 + f1), b - a)
        return x

    coarse, fine = integrate(200.0), integrate(4000.0)
    assert np.linalg.norm(coarse[:3] - fine[:3]) < 0.02
    assert geo.angle(
        geo.matrix_from_quat(coarse[6:10]).T @ geo.matrix_from_quat(fine[6:10])
    ) < np.radians(0.01)


@given(st.integers(0, 10_000), st.sampled_from([0.0, 1e-12, 1e-5, 1e-4, 1.0, 3.1]))
def test_exponential_equals_tagvos(seed, size):
    phi = np.random.default_rng(seed).normal(size=3)
    phi *= size / np.linalg.norm(phi)
    R = geo.matrix_from_quat(np.array(exp_quat(*phi)))
    assert_allclose(R, geo.exp(phi), atol=1e-12)


@pytest.mark.parametrize("layout", [BIASED, FULL])
def test_the_pose_bias_forgets_and_keeps_its_stationary_spread(layout):
    x, _ = a_state(2)
    P, first = np.eye(layout.n) * 1e-4, layout.pose_bias
    b = x[at.X_BIAS]
    for _ in range(20000):
        propagate(x, P, np.array([0.0] * 5 + [9.81] + [1.0] * 6), 0.005, Q, layout)
    assert abs(x[at.X_BIAS]) < abs(b) * 1e-6
    assert_allclose(np.diag(P)[first : first + 6], 1.0, rtol=1e-3)


def test_relaxing_the_pose_bias_is_a_gauss_markov_step():
    rng = np.random.default_rng(4)
    A = rng.normal(size=(FULL.n, FULL.n))
    P, first = A @ A.T, FULL.pose_bias
    F, Q_dense = np.eye(FULL.n), np.zeros_like(P)
    keep = np.exp(-0.2 * Q.pose_bias_rate)
    for i in range(first, first + 6):
        F[i, i], Q_dense[i, i] = keep, 1.0 - keep**2
    expected = F @ P @ F.T + Q_dense
    _relax_bias(P, first, keep)
    assert_allclose(P, expected, atol=1e-12 * np.abs(expected).max())
    assert np.array_equal(P, P.T)
