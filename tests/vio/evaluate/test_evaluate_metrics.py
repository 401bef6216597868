"""The figures of both views, each computed a second, slow way, and by evo where it is there."""

import dataclasses
import time

import numpy as np
import pytest
from evaluate_flights import MS, T0, Truth, empty, estimate, make_truth, pose_at, stamps
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tagvo import geometry as geo
from vio.evaluate.metrics import capture_errors, nees, now_errors, stats
from vio.evaluate.records import Errors, Window
from vio.evaluate.truth import clean_truth

ALL = Window()
KEYS = {
    "position_rmse_m", "position_mean_m", "position_median_m", "position_std_m",
    "position_p95_m", "position_max_m", "rotation_rmse_deg", "rotation_mean_deg",
    "rotation_median_deg", "rotation_std_deg", "velocity_rmse_m_s", "nees_pose", "coverage", "n",
}  # fmt: skip


def slow_now(trajectory, truth, start):
    """(stamp, row of the last output to have arrived) by looking through all, for each row."""
    pairs = []
    for i, t in enumerate(truth.t_ns):
        if t < start:
            continue
        arrived = [k for k in range(len(trajectory)) if trajectory.known_ns[k] <= t]
        if arrived:
            pairs.append((i, max(arrived, key=lambda k: (trajectory.known_ns[k], k))))
    return pairs


def test_now_is_the_last_output_to_have_arrived():
    rng = np.random.default_rng(0)
    truth = clean_truth(make_truth(60))
    x = estimate(stamps(40, 67.0, 400.0), rng)
    late = rng.integers(0, 300, size=40) * MS  # out of order
    x = dataclasses.replace(x, known_ns=x.t_ns + late)
    start = int(truth.t_ns[5])
    errors = now_errors(x, truth, Window(start))
    pairs = slow_now(x, truth, start)
    assert_array_equal(errors.t_ns, [truth.t_ns[i] for i, _ in pairs])
    assert_allclose(errors.p_W, [x.p_WI[k] - truth.p_WI[i] for i, k in pairs])
    angles = [(Rotation.from_matrix(truth.R_WI[i]).inv() * Rotation.from_matrix(x.R_WI[k]))
              .magnitude() for i, k in pairs]  # fmt: skip
    assert_allclose(np.linalg.norm(errors.rotation_I, axis=-1), angles, atol=1e-12)
    assert errors.coverage == pytest.approx(len(pairs) / 55)
    assert 0.5 < errors.coverage < 1.0


def test_an_output_known_just_at_the_stamp_counts_and_a_nanosecond_later_does_not():
    truth = clean_truth(make_truth(3))
    x = estimate(truth.t_ns[:1], np.random.default_rng(0))
    assert len(now_errors(x, truth, ALL)) == 3
    late = dataclasses.replace(x, known_ns=x.known_ns + 1)
    assert len(now_errors(late, truth, ALL)) == 2


def test_latency_costs_the_way_flown_meanwhile():
    truth = clean_truth(make_truth(400, 10.0))
    x = estimate(stamps(400, 10.0), np.random.default_rng(0), sigma=0.0, latency_ms=200.0)
    figures = stats(now_errors(x, truth, ALL))
    speed = np.linalg.norm(pose_at(truth.t_ns)[2], axis=-1)
    assert figures["position_mean_m"] == pytest.approx(0.2 * speed[20:].mean(), rel=0.02)
    assert stats(capture_errors(x, truth, ALL))["position_max_m"] < 1e-9


def test_capture_coverage_is_the_share_of_truth_with_a_pose_within_50_ms():
    truth = clean_truth(make_truth(100))
    x = estimate(stamps(7, 613.0, 120.0), np.random.default_rng(0))
    start = int(truth.t_ns[10])
    asked = truth.t_ns[10:]
    near = [any(abs(int(t) - int(c)) <= 50 * MS for c in x.t_ns) for t in asked]
    errors = capture_errors(x, truth, Window(start))
    assert errors.coverage == pytest.approx(np.mean(near))
    assert len(errors) == np.sum((x.t_ns >= start) & (x.t_ns <= truth.t_ns[-1]))


def test_capture_leaves_out_poses_without_truth_and_outside_the_window():
    truth = make_truth(100)
    holes = np.delete(np.arange(100), np.r_[40:50])
    truth = clean_truth(Truth(truth.t_ns[holes], truth.p_WI[holes], truth.q_WI[holes]))
    x = estimate(stamps(500, 10.0), np.random.default_rng(0))
    errors = capture_errors(x, truth, Window(T0 + 1000 * MS, T0 + 4000 * MS))
    inside = (errors.t_ns > truth.t_ns[39]) & (errors.t_ns < truth.t_ns[40])
    assert not inside.any()
    assert (errors.t_ns.min(), errors.t_ns.max()) == (T0 + 1000 * MS, T0 + 4000 * MS)


def test_statistics_are_the_contract_and_agree_with_plain_formulas():
    rng = np.random.default_rng(2)
    e = rng.normal(size=(57, 9))
    errors = Errors(stamps(57), e[:, :3], 0.1 * e[:, 3:6], e[:, 6:], None, 0.5)
    s = stats(errors)
    assert set(s) == KEYS
    d = sorted(np.sqrt((e[:, :3] ** 2).sum(axis=1)))
    mean = sum(d) / 57
    assert s["position_rmse_m"] == pytest.approx((sum(x * x for x in d) / 57) ** 0.5)
    assert s["position_mean_m"] == pytest.approx(mean)
    assert s["position_median_m"] == pytest.approx(d[28])
    assert s["position_std_m"] == pytest.approx((sum((x - mean) ** 2 for x in d) / 57) ** 0.5)
    assert s["position_p95_m"] == pytest.approx(d[53] + 0.2 * (d[54] - d[53]))
    assert s["position_max_m"] == d[-1]
    angles = np.degrees(0.1 * np.linalg.norm(e[:, 3:6], axis=1))
    assert s["rotation_rmse_deg"] == pytest.approx(np.sqrt(np.mean(angles**2)))
    assert s["rotation_mean_deg"] == pytest.approx(np.mean(angles))
    assert s["velocity_rmse_m_s"] == pytest.approx(np.sqrt(np.mean(np.sum(e[:, 6:] ** 2, 1))))
    assert (s["nees_pose"], s["coverage"], s["n"]) == (None, 0.5, 57)


def test_velocity_uses_only_rows_where_truth_has_one():
    v = np.array([[3.0, 4.0, 0.0], [np.nan, np.nan, np.nan], [0.0, 0.0, 0.0]])
    zero = np.zeros((3, 3))
    s = stats(Errors(stamps(3), zero, zero, v, None, 1.0))
    assert s["velocity_rmse_m_s"] == pytest.approx(np.sqrt(12.5))
    assert stats(Errors(stamps(3), zero, zero, v * np.nan, None, 1.0))["velocity_rmse_m_s"] is None


def test_nees_is_the_quadratic_form_of_the_inverse():
    rng = np.random.default_rng(3)
    e, root = rng.normal(size=(20, 6)), rng.normal(size=(20, 6, 6)) * [1e-3] * 3 + [[0.0]]
    cov = root @ np.swapaxes(root, -1, -2) + 1e-6 * np.eye(6)
    errors = Errors(stamps(20), e[:, :3], e[:, 3:], None, cov, 1.0)
    slow = [x @ np.linalg.inv(c) @ x for x, c in zip(e, cov, strict=True)]
    assert_allclose(nees(errors), slow, rtol=1e-6)


def test_nees_of_honest_noise_is_one_and_of_twice_the_sigma_four():
    rng = np.random.default_rng(4)
    truth = clean_truth(make_truth(2000))
    x = estimate(truth.t_ns, rng, full=True)
    honest = stats(capture_errors(x, truth, ALL))["nees_pose"]
    assert 0.95 < honest < 1.05  # 12000 degrees of freedom: sigma 0.013
    proud = dataclasses.replace(x, cov=x.cov / 4.0)
    assert stats(capture_errors(proud, truth, ALL))["nees_pose"] == pytest.approx(4.0 * honest)


def test_the_rotation_block_of_the_covariance_is_right_handed_in_the_imu():
    """An error about the body's own x must be weighed with the first rotation variance."""
    t_ns, angle = stamps(1), 0.01
    R_truth = geo.exp(np.array([[0.3, -1.2, 0.8]]))
    truth = clean_truth(Truth(t_ns, np.zeros((1, 3)), geo.quat_from_matrix(R_truth)))
    x = estimate(t_ns, np.random.default_rng(0), full=True)
    cov = np.diag([1.0, 1.0, 1.0, angle**2, 1e-8, 1e-8])[None]
    R = R_truth @ geo.exp(np.array([[angle, 0.0, 0.0]]))
    x = dataclasses.replace(x, p_WI=np.zeros((1, 3)), R_WI=R, cov=cov)
    assert nees(capture_errors(x, truth, ALL))[0] == pytest.approx(1.0)


def test_a_covariance_that_is_none_is_left_out_of_nees():
    rng = np.random.default_rng(5)
    truth = clean_truth(make_truth(4))
    x = estimate(truth.t_ns, rng, full=True)
    cov = x.cov.copy()
    cov[0], cov[1], cov[2] = np.nan, 0.0, np.ones((6, 6))
    values = nees(capture_errors(dataclasses.replace(x, cov=cov), truth, ALL))
    assert_array_equal(np.isfinite(values), [False, False, False, True])


def test_no_output_gives_no_figures_and_no_coverage():
    truth = clean_truth(make_truth(10))
    for errors in (capture_errors(empty(), truth, ALL), now_errors(empty(), truth, ALL)):
        s = stats(errors)
        assert (s["coverage"], s["n"], s["position_rmse_m"]) == (0.0, 0, None)
    after = Window(int(truth.t_ns[-1]) + 1)
    assert stats(now_errors(empty(), truth, after))["coverage"] is None


def test_agrees_with_evo():
    trajectory = pytest.importorskip("evo.core.trajectory", reason="evo is not installed")
    from evo.core.metrics import APE, PoseRelation

    truth = clean_truth(make_truth(150))
    x = estimate(truth.t_ns, np.random.default_rng(6), sigma=0.05)

    def of_evo(p, R):
        t_s = (truth.t_ns - T0) * 1e-9
        return trajectory.PoseTrajectory3D(p, geo.quat_from_matrix(R), t_s)

    ours = stats(capture_errors(x, truth, ALL))
    for relation, names in (
        (PoseRelation.translation_part, "position_{}_m"),
        (PoseRelation.rotation_angle_deg, "rotation_{}_deg"),
    ):
        ape = APE(relation)
        ape.process_data((of_evo(truth.p_WI, truth.R_WI), of_evo(x.p_WI, x.R_WI)))
        theirs = ape.get_all_statistics()
        for key in ("rmse", "mean", "median", "std"):
            assert ours[names.format(key)] == pytest.approx(theirs[key], abs=1e-9)


def test_forty_thousand_rows_take_less_than_half_a_second():
    truth = clean_truth(make_truth(40_000, 5.0))
    x = estimate(stamps(40_000, 5.0, 2.0), np.random.default_rng(7), latency_ms=30.0, full=True)
    took = []
    for _ in range(3):  # the best of three: the machine has other work
        start = time.process_time()
        stats(capture_errors(x, truth, ALL))
        stats(now_errors(x, truth, ALL))
        took.append(time.process_time() - start)
    assert min(took) < 0.5
