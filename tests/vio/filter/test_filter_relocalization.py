"""Start, relocation and the innovations' memory in small, each against what must come out."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.records import PoseMeasurement
from vio.config.filter import RecoveryConfig, VioConfig
from vio.filter import state as at
from vio.filter.adaptive_noise import NoisePolicy, no_memory, remember
from vio.filter.history import History
from vio.filter.initialization import Rig, begin
from vio.filter.measurements import kinds
from vio.filter.measurements.pose import NUMBERS
from vio.filter.noise_model import Model
from vio.filter.preprocessing import Interval
from vio.filter.relocalization import Relocation, relocate, relocation

MS = 1_000_000
G = np.array([0.0, 0.0, 9.80665])


def state(p=(0.0, 0.0, 0.0), v=(0.0, 0.0, 0.0), R=None):
    x = np.zeros(at.NOMINAL)
    x[[at.X_QIC, at.X_QWL]] = 1.0
    x[at.X_P : at.X_P + 3], x[at.X_V : at.X_V + 3] = p, v
    x[at.X_Q : at.X_Q + 4] = geo.quat_from_matrix(np.eye(3) if R is None else R)
    return x


def empty_history():
    q, policy = at.ProcessNoise(*np.zeros(8).tolist()), NoisePolicy(1.0, False, False, 0.0, 1.0)
    return History((16, 4, kinds.HEAD + NUMBERS), Model(q, policy, at.layout()))


def pose(t_ns, p, R=None):
    return PoseMeasurement(t_ns, np.array(p), np.eye(3) if R is None else R, 1e-4 * np.eye(6), (0,))


def test_a_relocation_turns_the_velocity_with_the_vehicle():
    turn = geo.exp(np.array([0.0, 0.0, np.pi / 2.0]))
    move = Relocation(np.array([1.0, 2.0, 3.0]), turn, np.array([0.0, 0.0, 0.1]), 0.02, 0.03)
    x, P = relocate(state(v=(2.0, 0.0, 0.0)), np.eye(at.BASE), move)
    assert_allclose(x[at.X_V : at.X_V + 3], [0.0, 2.0, 0.1], atol=1e-12)
    assert_allclose(x[at.X_P : at.X_P + 3], [1.0, 2.0, 3.0])
    assert_allclose(geo.matrix_from_quat(x[at.X_Q : at.X_Q + 4]), turn, atol=1e-12)
    assert np.isfinite(P).all()


def test_rejected_poses_are_compared_with_predictions_at_their_own_stamps():
    """Snapshots every 100 ms, poses up to 90 ms after them at 3 m/s: 27 cm, were it not led on."""
    history = empty_history()
    v, moved = np.array([3.0, 0.0, 0.0]), np.array([5.0, -2.0, 1.0])
    s = history.snapshots
    for k in range(12):
        s.t[k], s.P[k] = 100 * MS * k, 1e-4 * np.eye(at.BASE)
        s.x[k] = state(0.1 * k * v, v)
    history.last = 11
    stamps = [100 * MS * k + lead * MS for k, lead in zip(range(8), (0, 90) * 4, strict=True)]
    poses = [pose(t, 1e-9 * t * v + moved) for t in stamps]
    found = relocation(history, poses, RecoveryConfig())
    assert found is not None, "one shift explains them all"
    tick, x, _ = found
    assert tick == 7
    assert_allclose(x[at.X_V : at.X_V + 3], v, atol=1e-6)
    assert_allclose(x[at.X_P : at.X_P + 3], 1e-9 * stamps[-1] * v + moved, atol=1e-6)


def test_poses_that_one_shift_does_not_explain_relocate_nothing():
    history = empty_history()
    s = history.snapshots
    for k in range(12):
        s.t[k], s.x[k], s.P[k] = 100 * MS * k, state(), 1e-4 * np.eye(at.BASE)
    history.last = 11
    poses = [pose(100 * MS * k, (float(k % 2), 0.0, 0.0)) for k in range(8)]
    assert relocation(history, poses, RecoveryConfig()) is None


@pytest.mark.parametrize("moving", [False, True])
def test_at_rest_the_gyros_mean_is_its_bias(moving):
    """A turn-on bias of 1.1 deg/s: found where the vehicle rests, left at zero where it turns."""
    rng, bias = np.random.default_rng(5), np.array([0.02, -0.01, 0.015])
    rate = np.array([0.0, 0.0, 0.5 if moving else 0.0])
    steps = [
        Interval(5 * MS * k, 5 * MS * (k + 1), bias + rate + 1e-3 * rng.normal(size=3),
                 G + 0.02 * rng.normal(size=3), np.ones(6))
        for k in range(220)
    ]  # fmt: skip
    poses = [
        replace(pose(50 * MS * k, 1e-3 * rng.normal(size=3)),
                R_WC=geo.exp(0.05 * k * rate + 1e-3 * rng.normal(size=3)))
        for k in range(2, 20)
    ]  # fmt: skip
    found = begin(poses, steps, Rig(np.eye(3), np.zeros(3), 0.0), VioConfig(), None)
    assert found is not None
    wanted = np.zeros(3) if moving else bias
    assert_allclose(found.x[at.X_BG : at.X_BG + 3], wanted, atol=5e-4)


def test_no_innovation_counts_in_the_memory_for_more_than_the_gates_limit():
    """4.7 sigma: one wild innovation must not decide for minutes how errors are correlated."""
    usual, wild = state(), state()
    for x, first in ((usual, 4.7), (wild, 1e4)):
        x[at.X_RECENT :] = no_memory()
        x[at.X_LAST] = 0.0
        for k, y in enumerate([first, 0.5, -0.5]):
            remember(x, np.r_[y, np.zeros(5)], 0.1 + 0.05 * k)
    assert_allclose(wild, usual, rtol=1e-12)
    assert wild[at.X_SUMS] < no_memory()[at.X_SUMS - at.X_RECENT] + 4.7**2 + 1.0
