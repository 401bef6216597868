"""Corrections against second ways: finite differences, Joseph form, filterpy, dense stacking."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from test_filter_propagation import FULL, LAYOUTS, PLAIN, a_state, minus, retract

from tagvo import geometry as geo
from tagvo.records import PoseMeasurement
from vio.filter import state as at
from vio.filter.adaptive_noise import Trust
from vio.filter.measurements import constraints, kinds, pose
from vio.filter.measurements.camera import camera_jacobian, camera_pose
from vio.filter.measurements.pose import pivot_of, pivot_rows
from vio.filter.update import inject

TRUST, OPEN_GATE = Trust(1.0, 0.0, 0.0, 1.0), Trust(1.0, 0.0, 0.0, np.inf)
W = np.array([0.3, -0.4, 0.2])


def predicted(x):
    R, p = np.empty((3, 3)), np.empty(3)
    camera_pose(x, R, p)
    return R, p


def spread_of(rng, n=30):
    A = rng.normal(size=(n, n)) * 0.01
    return A @ A.T + 1e-5 * np.eye(n)


def measured(x, rng, exact=False):
    R, p = predicted(x)
    A = rng.normal(size=(6, 6)) * 0.02
    cov = A @ A.T + 1e-5 * np.eye(6)
    e = np.zeros(6) if exact else np.linalg.cholesky(cov) @ rng.normal(size=6)
    return PoseMeasurement(0, p + e[:3], R @ geo.exp(e[3:]), cov, (0,))


def residual(x, z):
    r, y, R = np.empty(6), np.empty(3), np.empty((3, 3))
    pose.residual(x, pose.unpack(z), r, y, R)
    return r, y, R


@pytest.mark.parametrize("seed", range(4))
def test_camera_jacobian_is_the_derivative_of_the_pose(seed):
    x, _ = a_state(seed)
    H = np.empty((6, 30))
    camera_jacobian(x, W, H, FULL)
    R0, _ = predicted(x)
    numeric, h = np.zeros((6, 30)), 1e-6
    for i in range(at.TD):
        d = np.zeros(30)
        d[i] = h
        (Ra, pa), (Rb, pb) = predicted(retract(x, d)), predicted(retract(x, -d))
        numeric[:, i] = np.concatenate([pa - pb, geo.log(R0.T @ Ra) - geo.log(R0.T @ Rb)]) / (2 * h)
    assert_allclose(H[:, : at.TD], numeric[:, : at.TD], atol=1e-8)
    for i in range(FULL.p_IC, FULL.n):
        d = np.zeros(30)
        d[i] = h
        (_, pa), (_, pb) = predicted(retract(x, d)), predicted(retract(x, -d))
        assert_allclose(H[:3, i], (pa - pb) / (2 * h), atol=1e-8)


def test_time_offset_column_is_the_motion_of_the_camera():
    x, _ = a_state(5)
    H = np.empty((6, 21))
    camera_jacobian(x, W, H, PLAIN)
    h, b = 1e-5, x.copy()
    w = W - x[at.X_BG : at.X_BG + 3]
    poses = []
    for s in (h, -h):
        y = b.copy()
        y[:3] += s * b[at.X_V : at.X_V + 3]
        R = geo.matrix_from_quat(b[at.X_Q : at.X_Q + 4]) @ geo.exp(s * w)
        y[at.X_Q : at.X_Q + 4] = geo.quat_from_matrix(R)
        poses.append(predicted(y))
    (Ra, pa), (Rb, pb) = poses
    assert_allclose(H[:3, at.TD], (pa - pb) / (2 * h), atol=1e-8)
    assert_allclose(H[3:, at.TD], geo.log(Rb.T @ Ra) / (2 * h), atol=1e-8)


def test_pivot_rows_are_the_derivative_of_the_residual():
    x, rng = a_state(9)
    z = pose.pack(measured(x, rng, exact=True))[kinds.HEAD :]
    _, y, R = residual(x, z)
    H = np.empty((6, 30))
    camera_jacobian(x, W, H, FULL)
    pivot_rows(H, R, y)
    h = 1e-6
    for i in [*range(at.TD), *range(FULL.p_IC, FULL.n)]:
        d = np.zeros(30)
        d[i] = h
        slope = (residual(retract(x, -d), z)[0] - residual(retract(x, d), z)[0]) / (2 * h)
        assert_allclose(H[:, i], slope, atol=1e-6)


def test_pivot_decouples_position_and_rotation():
    rng = np.random.default_rng(0)
    R, y = geo.exp(rng.normal(size=3)), np.array([0.2, -0.1, 1.5])
    place, turn = np.diag([1e-6, 1e-6, 4e-6]), np.diag([1e-3, 2e-3, 1e-4])
    T = np.eye(6)  # [dp_WC, dtheta] from [place in C, dtheta]
    T[:3, :3], T[:3, 3:] = -R, R @ geo.hat(y)
    cov = T @ np.block([[place, np.zeros((3, 3))], [np.zeros((3, 3)), turn]]) @ T.T
    assert_allclose(pivot_of(R, cov), y, atol=1e-6)
    row = pose.pack(PoseMeasurement(0, np.zeros(3), R, cov, (0,)))
    assert_allclose(pose.unpack(row[kinds.HEAD :]).cov[:3, :3], place, atol=1e-9)
    assert_allclose(pivot_of(R, np.eye(6)), 0.0, atol=1e-12)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("share", [0.0, 0.4])
@pytest.mark.parametrize("seed", range(3))
def test_correction_equals_joseph_form_and_filterpy(layout, seed, share):
    from filterpy.kalman import update

    x, rng = a_state(seed)
    n, first = layout.n, layout.pose_bias
    P = spread_of(rng, n)
    z = pose.pack(measured(x, rng))[kinds.HEAD :]
    r, y, R_WC = residual(x, z)
    H = np.empty((6, n))
    camera_jacobian(x, W, H, layout)
    pivot_rows(H, R_WC, y)
    cov = pose.unpack(z).cov
    share = share if first != at.OFF else 0.0
    slow = np.repeat([share, 0.3 * share], 3)
    white = np.diag(np.sqrt(1.0 - slow))
    R = 2.0 * white @ cov @ white
    if share > 0.0:  # the pose bias is in units of the covariance's Cholesky factor
        H[:, first : first + 6] = np.diag(np.sqrt(slow)) @ np.linalg.cholesky(cov)
        r = r - H[:, first : first + 6] @ x[at.X_BIAS : at.X_BIAS + 6]
    S = H @ P @ H.T + R
    K = np.linalg.solve(S, H @ P).T
    dx = K @ r
    joseph = (np.eye(n) - K @ H) @ P @ (np.eye(n) - K @ H).T + K @ R @ K.T
    theirs, P_theirs = update(np.zeros(n), P, r, R, H)
    assert_allclose(theirs, dx, atol=1e-10)
    assert_allclose(P_theirs, joseph, atol=1e-10)
    G = np.eye(n)
    for i in (at.TH, at.EX):
        G[i : i + 3, i : i + 3] -= 0.5 * geo.hat(dx[i : i + 3])
    ours, P_ours = x.copy(), P.copy()
    trust = Trust(2.0, share, 0.3 * share, np.inf)
    verdict, nis = pose.update(ours, P_ours, W, z, trust, np.empty(6), layout)
    assert verdict == kinds.ACCEPTED
    assert nis == pytest.approx(r @ np.linalg.solve(S, r))
    assert_allclose(minus(ours, retract(x, dx, layout), layout), 0.0, atol=1e-10)
    assert_allclose(P_ours, G @ joseph @ G.T, atol=1e-10)
    assert np.array_equal(P_ours, P_ours.T)


def test_reset_jacobian_is_the_derivative_of_the_new_error():
    phi, h = np.array([0.02, -0.03, 0.01]), 1e-6
    G = np.eye(3) - 0.5 * geo.hat(phi)
    numeric = np.stack(
        [
            (
                geo.log(geo.exp(phi).T @ geo.exp(phi + e))
                - geo.log(geo.exp(phi).T @ geo.exp(phi - e))
            )
            / (2 * h)
            for e in h * np.eye(3)
        ],
        axis=-1,
    )
    assert_allclose(G, numeric, atol=5e-4)  # first order in phi
    x, rng = a_state(0)
    P, dx = spread_of(rng, 21), np.zeros(21)
    dx[at.TH : at.TH + 3] = phi
    expected = np.eye(21)
    expected[at.TH : at.TH + 3, at.TH : at.TH + 3] = G
    expected = expected @ P @ expected.T
    inject(x, P, dx, PLAIN)
    assert_allclose(P, expected, atol=1e-14)


@pytest.mark.parametrize(
    ("shift", "turn", "verdict"),
    [
        (0.0, 0.0, kinds.ACCEPTED),
        (0.0, 2.5, kinds.POSITION_ONLY),
        (3.0, 0.0, kinds.ROTATION_ONLY),
        (3.0, 2.5, kinds.REJECTED),
    ],
)
def test_gate_takes_position_and_rotation_apart(shift, turn, verdict):
    x, _ = a_state(4)
    P = 1e-4 * np.eye(21)
    R, p = predicted(x)
    m = PoseMeasurement(
        0, p + np.array([shift, 0.0, 0.0]), R @ geo.exp(np.array([0.0, turn, 0.0])),
        1e-4 * np.eye(6), (0,),
    )  # fmt: skip
    before, P_before = x.copy(), P.copy()
    came, nis = pose.update(x, P, W, pose.pack(m)[kinds.HEAD :], TRUST, np.empty(6), PLAIN)
    assert came == verdict
    assert (nis > 22.0) == (verdict != kinds.ACCEPTED)
    if verdict == kinds.REJECTED:
        assert np.array_equal(x, before)
        assert np.array_equal(P, P_before)


def test_singular_or_broken_covariance_changes_nothing():
    x, _ = a_state(4)
    P, before = 1e-4 * np.eye(21), x.copy()
    z = pose.pack(measured(x, np.random.default_rng(0)))[kinds.HEAD :]
    for broken in (np.zeros((6, 6)), np.full((6, 6), np.nan), -np.eye(6)):
        pose.unpack(z).cov[:] = broken
        verdict, _ = pose.update(x, P, W, z, TRUST, np.empty(6), PLAIN)
        assert verdict == kinds.SINGULAR
        assert np.array_equal(x, before)


def test_still_rig_and_clock_pull_their_states():
    x, _ = a_state(6)
    P = 0.01 * np.eye(21)
    x[at.X_V : at.X_V + 3] = [0.05, -0.05, 0.02]
    z = constraints.still(1e-3)[kinds.HEAD :]
    assert constraints.update_still(x, P, z, 1.0, PLAIN)[0] == kinds.ACCEPTED
    assert np.abs(x[at.X_V : at.X_V + 3]).max() < 1e-4
    z = constraints.clock(0.004, 1e-5)[kinds.HEAD :]
    assert constraints.update_clock(x, P, z, PLAIN)[0] == kinds.ACCEPTED
    assert x[at.X_TD] == pytest.approx(0.004, abs=1e-6)
    R_file = geo.matrix_from_quat(x[at.X_QIC : at.X_QIC + 4]) @ geo.exp(np.array([0.01, 0.02, 0.0]))
    z = constraints.rotation(geo.quat_from_matrix(R_file), 1e-5)[kinds.HEAD :]
    assert constraints.update_rotation(x, P, z, PLAIN)[0] == kinds.ACCEPTED
    assert geo.angle(R_file.T @ geo.matrix_from_quat(x[at.X_QIC : at.X_QIC + 4])) < 1e-5
