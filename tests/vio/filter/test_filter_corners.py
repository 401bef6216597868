"""The corner update against second ways: a camera model, finite differences, dense stacking."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from test_filter_propagation import BIASED, FULL, PLAIN, a_state, minus, retract
from test_filter_update import W, predicted, spread_of

from tagvo import geometry as geo
from tagvo.config import IntrinsicsErrorConfig
from tagvo.kernels.tag_residual import residual_covariance, tag_rows
from tagvo.records import Observations
from tagvo.tags.tag_map import map_from_dict
from vio.filter import state as at
from vio.filter.adaptive_noise import Trust
from vio.filter.measurements import corners, kinds
from vio.filter.measurements.camera import camera_jacobian

F, CENTRE, SIGMA = 500.0, np.array([320.0, 240.0]), 0.4
FLOOR = IntrinsicsErrorConfig(focal_rel=0.002, principal_px=0.3)
TRUST = Trust(1.0, 0.0, 0.0, 1.0)


def scene(seed, tags=5):
    """A state, and a map of tags spread before the camera that it predicts."""
    x, rng = a_state(seed)
    R_WC, p_WC = predicted(x)
    rows = []
    for i in range(tags):
        p_C = np.array([*rng.uniform(-0.6, 0.6, 2), rng.uniform(1.0, 2.0)])
        R_CT = geo.exp(np.array([np.pi, 0.0, 0.0])) @ geo.exp(rng.normal(size=3) * 0.4)
        q = geo.quat_from_matrix(R_WC @ R_CT)
        rows.append({"id": i, "size": 0.2, "p": (p_WC + R_WC @ p_C).tolist(), "q": q.tolist()})
    sigma = {"xy": 0.003, "z": 0.002, "yaw_deg": 0.5, "tilt_deg": 0.3}
    data = {"family": "tag36h11", "sigma": sigma, "tags": rows}
    return x, map_from_dict(data, "scene"), rng


def project(x, corners_W):
    R_WC, p_WC = predicted(x)
    p_C = (corners_W - p_WC) @ R_WC
    return p_C[..., :2] / p_C[..., 2:]


def seen(x, tag_map, rng=None, sigma=SIGMA):
    x_n = project(x, tag_map.corners_W)
    if rng is not None:
        x_n = x_n + sigma / F * rng.normal(size=x_n.shape)
    n = len(tag_map)
    J = np.broadcast_to(F * np.eye(2), (n, 4, 2, 2)).copy()
    return Observations(
        np.arange(n), tag_map.tag_id, x_n * F + CENTRE, x_n, J, np.full((n, 4), SIGMA)
    )


def packed(obs, tag_map):
    return corners.pack(obs, tag_map, CENTRE, FLOOR, 48)


def tags_of(row):
    return corners.unpack(row[kinds.HEAD :], int(row[1]))


def rows_of(x, tags, i):
    """Residual (8,), Jacobian by xi (8, 6) and covariance (8, 8) of one tag, in pixels."""
    R_WC, p_WC = predicted(x)
    rows, L, S = np.empty((8, 7)), np.empty((8, 6)), np.zeros((8, 8))
    assert tag_rows(R_WC, p_WC, tags, i, rows, L, np.empty((16, 3)))
    residual_covariance(L, tags.laying[i], tags.sigma_px[i], S)
    return rows[:, 0], rows[:, 1:], np.tril(S) + np.tril(S, -1).T


def test_the_row_bears_the_camera_s_index():
    x, tag_map, _ = scene(0)
    obs = seen(x, tag_map)
    row = packed(replace(obs, camera=3), tag_map)
    assert (row[kinds.KIND], row[kinds.COUNT], row[kinds.CAMERA]) == (kinds.CORNERS, len(obs), 3)
    assert_array_equal(row[kinds.HEAD :], packed(obs, tag_map)[kinds.HEAD :])


def test_residual_and_its_jacobian():
    x, tag_map, _ = scene(0)
    obs = seen(x, tag_map)
    tags = tags_of(packed(obs, tag_map))
    i = int(np.flatnonzero((tag_map.p_WT == tags.p_WT[0]).all(axis=1))[0])
    r, J, _ = rows_of(x, tags, 0)
    assert_allclose(r, 0.0, atol=1e-9)
    H = np.empty((6, 21))
    camera_jacobian(x, W, H, PLAIN)
    h = 1e-6
    for k in range(at.TD):
        d = np.zeros(30)
        d[k] = h
        plus, less = (F * project(retract(x, s * d), tag_map.corners_W[i]) for s in (1, -1))
        assert_allclose((J @ H)[:, k], ((plus - less) / (2 * h)).ravel(), atol=1e-7 * F)


def test_noise_is_that_of_corners_and_of_laying():
    """By drawing both: the laying errors move the tag in its own frame."""
    x, tag_map, rng = scene(1, tags=1)
    _, _, S = rows_of(x, tags_of(packed(seen(x, tag_map), tag_map)), 0)
    d = rng.normal(size=(20000, 6)) * tag_map.laying_sigma[0]
    X_T = np.einsum("nij,kj->nki", geo.exp(d[:, 3:]), tag_map.corners_T[0]) + d[:, None, :3]
    x_px = F * project(x, X_T @ tag_map.R_WT[0].T + tag_map.p_WT[0])
    x_px = x_px + SIGMA * rng.normal(size=x_px.shape)
    assert_allclose(S, np.cov(x_px.reshape(-1, 8).T), atol=0.04 * np.abs(S).max())


@pytest.mark.parametrize(("layout", "share"), [(PLAIN, 0.0), (BIASED, 0.0), (FULL, 0.3)])
def test_update_equals_all_corners_stacked(layout, share):
    x, tag_map, rng = scene(2)
    n, first = layout.n, layout.pose_bias
    P, inflation = spread_of(rng, n), 3.0
    row = packed(seen(x, tag_map, rng), tag_map)
    tags, H6 = tags_of(row), np.empty((6, n))
    camera_jacobian(x, W, H6, layout)
    parts = [rows_of(x, tags, i) for i in range(len(tags.sigma_px))]
    r = np.concatenate([b[0] for b in parts])
    H = np.concatenate([b[1] for b in parts]) @ H6
    R = np.zeros((len(r), len(r)))
    for i, b in enumerate(parts):
        R[8 * i : 8 * i + 8, 8 * i : 8 * i + 8] = b[2]
    B = np.concatenate(tags.shift_px)
    # the floor is common to all tags and does not change how they are weighed: as in tagvo's joint
    A = np.concatenate([b[1] for b in parts]).T @ np.linalg.inv(R)
    info = A @ np.concatenate([b[1] for b in parts])
    D = np.linalg.solve(info, A @ B)
    cov = np.linalg.inv(info)  # of R without inflation: `blocks` asks for none
    xi = np.linalg.solve(info, A @ r)
    if share > 0.0:  # in units of the upper factor of that covariance
        C = np.linalg.inv(np.linalg.cholesky(info)).T
        H6[:, first : first + 6] = np.sqrt(share) * C
        xi = xi - H6[:, first : first + 6] @ x[at.X_BIAS : at.X_BIAS + 6]
    R_xi = inflation * ((1.0 - share) * cov + D @ D.T)
    S = H6 @ P @ H6.T + R_xi
    K = np.linalg.solve(S, H6 @ P).T
    dx = K @ xi
    ours, P_ours = x.copy(), P.copy()
    trust = Trust(inflation, share, share, np.inf)
    verdict, nis = corners.update(ours, P_ours, W, row, trust, np.empty(6), layout)
    assert verdict == kinds.ACCEPTED
    assert nis > 0.0
    assert_allclose(minus(ours, retract(x, dx, layout), layout), 0.0, atol=1e-8)
    spread = np.diag((np.eye(n) - K @ H6) @ P)
    assert_allclose(np.diag(P_ours), spread, atol=0.02 * spread.max())
    assert H.shape == (40, n)


def test_a_moved_tag_is_gated_and_the_others_count():
    x, tag_map, rng = scene(3)
    obs = seen(x, tag_map, rng)
    obs.corners_n[1] += 60.0 / F
    P = 1e-6 * np.eye(21)
    before = x.copy()
    verdict, _ = corners.update(x, P, W, packed(obs, tag_map), TRUST, np.empty(6), PLAIN)
    assert verdict == kinds.ACCEPTED
    assert np.linalg.norm(minus(x, before, PLAIN)[:3]) < 0.01


def test_nothing_but_moved_tags_is_rejected():
    x, tag_map, rng = scene(4, tags=2)
    obs = seen(x, tag_map, rng)
    obs.corners_n[:] += 60.0 / F
    P, before = 1e-6 * np.eye(21), x.copy()
    verdict, _ = corners.update(x, P, W, packed(obs, tag_map), TRUST, np.empty(6), PLAIN)
    assert verdict == kinds.REJECTED
    assert np.array_equal(x, before)


def test_tags_behind_the_camera_and_without_noise_do_no_harm():
    x, tag_map, rng = scene(5, tags=3)
    row = packed(seen(x, tag_map, rng), tag_map)
    tags = tags_of(row)
    tags.p_WT[0] = predicted(x)[1]  # it stands at the camera
    tags.sigma_px[1] = tags.laying[1] = 0.0  # no noise, laid exactly: S is singular
    P = 1e-4 * np.eye(21)
    open_gate = TRUST._replace(gate=np.inf)
    verdict, _ = corners.update(x, P, W, row, open_gate, np.empty(6), PLAIN)
    assert verdict == kinds.ACCEPTED
    assert np.isfinite(x).all()
    tags.sigma_px[2] = tags.laying[2] = 0.0
    verdict, _ = corners.update(x, P, W, row, TRUST, np.empty(6), PLAIN)
    assert verdict == kinds.REJECTED


def test_pack_drops_what_is_not_finite_and_keeps_the_largest():
    x, tag_map, rng = scene(6)
    obs = seen(x, tag_map, rng)
    obs.sigma_px[0] = np.nan
    obs.J_px_n[1] = np.nan
    tags = tags_of(packed(obs, tag_map))
    assert len(tags.p_WT) == len(tag_map) - 2
    assert not (tags.p_WT[:, None] == tag_map.p_WT[:2]).all(axis=-1).any()
    a, b = obs.corners_n[:, 2] - obs.corners_n[:, 0], obs.corners_n[:, 3] - obs.corners_n[:, 1]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    two = tags_of(corners.pack(obs, tag_map, CENTRE, FLOOR, 2))
    largest = 2 + np.argsort(-area[2:])[:2]
    assert_allclose(two.p_WT, tag_map.p_WT[largest])
    obs.sigma_px[:] = np.nan
    assert packed(obs, tag_map) is None
