"""The filter at a moment of the past or of now, as a vehicle is told of it."""

import numpy as np
import pytest
from flights import CAMERA, CLEAN, events, feed, fly

from tagvo import geometry as geo
from tagvo.records import PoseMeasurement
from vio.config.filter import VioConfig
from vio.filter import state as at
from vio.filter.adaptive_noise import NoisePolicy
from vio.filter.eskf import ErrorStateFilter
from vio.filter.history import History
from vio.filter.measurements import kinds, pose
from vio.filter.noise_model import Model
from vio.filter.outputs import moment
from vio.sim.sensors.simple_imu import PIXHAWK


def flown(seconds=6.0):
    flight = fly("T3", 3, CLEAN, seconds=seconds)
    estimator = ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK)
    assert estimator.moment() is None
    for what in events(flight):
        feed(estimator, what)
    return flight, estimator


def test_at_a_capture_it_is_as_good_as_at_the_newest_sample_and_knows_that_frame():
    """Every pose, asked for as soon as it is fused: state at its own stamp beside the truth."""
    flight = fly("T3", 4, CLEAN, seconds=8.0)
    estimator = ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK)
    errors, before, after = [], [], []
    for what in events(flight):
        known = isinstance(what, PoseMeasurement) and estimator.moment(what.t_ns)
        feed(estimator, what)
        if isinstance(what, PoseMeasurement) and what.t_ns > 4e9:
            made = estimator.moment(what.t_ns)
            assert made.t_ns == what.t_ns
            offset = estimator.state()[20]
            assert made.nav.t_ns == pytest.approx(what.t_ns + offset * 1e9, abs=2)
            truth = flight.flight(np.array([what.t_ns * 1e-9]))
            errors.append(np.linalg.norm(made.nav.p_WI - truth.p_WI[0]))
            before.append(np.trace(known.nav.cov[:3, :3]))
            after.append(np.trace(made.nav.cov[:3, :3]))
            assert np.linalg.eigvalsh(made.nav.cov).min() > 0.0
    assert np.sqrt(np.mean(np.square(errors))) < 0.015
    assert np.all(np.array(after) < np.array(before)), "it holds the frame that was just fused"


def test_between_two_samples_it_lies_between_them():
    _, estimator = flown()
    w, s = estimator._history, estimator._history.snapshots
    shift = round(estimator.state()[20] * 1e9)
    k = w.last - 20
    there = (estimator.moment(int(s.t[k + j]) - shift).nav for j in (0, 1))
    a, b = there
    middle = estimator.moment((int(s.t[k]) + int(s.t[k + 1])) // 2 - shift).nav
    np.testing.assert_allclose(middle.p_WI, 0.5 * (a.p_WI + b.p_WI), atol=2e-5)
    half = geo.log(a.R_WI.T @ middle.R_WI)
    np.testing.assert_allclose(half, 0.5 * geo.log(a.R_WI.T @ b.R_WI), atol=1e-6)


def test_going_back_and_forth_is_the_same_way():
    """From the snapshot after a stamp back to it, against the one before on to it: same state."""
    from vio.filter.propagation import propagate

    _, estimator = flown()
    w, s = estimator._history, estimator._history.snapshots
    k = w.last - 3  # no frame is that new
    due = (int(s.t[k]) + int(s.t[k + 1])) // 2
    x, P = s.x[k].copy(), s.P[k].copy()
    propagate(x, P, s.imu[k + 1], (due - int(s.t[k])) * 1e-9, w.model.q, w.model.layout)
    back = estimator.moment(due - round(estimator.state()[20] * 1e9)).nav
    np.testing.assert_allclose(back.p_WI, x[0:3], atol=1e-9)
    np.testing.assert_allclose(back.v_WI, x[3:6], atol=1e-9)
    np.testing.assert_allclose(np.diag(back.cov)[:3], np.diag(P)[:3], rtol=1e-3)


def test_now_and_the_limits_of_memory():
    _, estimator = flown()
    w, s = estimator._history, estimator._history.snapshots
    shift = round(estimator.state()[20] * 1e9)
    newest = estimator.moment()
    assert newest.nav.t_ns == w.now_ns
    np.testing.assert_array_equal(newest.nav.p_WI, estimator.nav().p_WI)
    assert estimator.moment(int(s.t[0]) - shift - 1_000_000) is None
    ahead = estimator.moment(w.now_ns - shift + 20_000_000)
    assert np.trace(ahead.nav.cov) > np.trace(newest.nav.cov)
    assert estimator.moment(w.now_ns - shift + 60_000_000) is None


def test_gravity_and_rate_come_along():
    flight, estimator = flown()
    made = estimator.moment()
    assert np.degrees(np.arccos(-made.down_W[2])) < 1.0
    assert np.linalg.norm(made.down_W) == pytest.approx(1.0)
    h = 1e-4
    t = made.nav.t_ns * 1e-9
    R = flight.flight(np.array([t - h, t + h])).R_WI
    rate = geo.log(R[0].T @ R[1]) / (2 * h)
    np.testing.assert_allclose(made.w_I, rate, atol=0.1)


@pytest.mark.parametrize("back_ns", [1_000_000, 4_000_000])
def test_going_back_takes_no_noise_away(back_ns):
    """Noise that time adds is not subtracted: an IMU a thousand times as bad changes nothing."""
    rng, R = np.random.default_rng(1), np.diag([1e-4] * at.BASE)
    q = at.ProcessNoise(*np.full(8, 1e-4).tolist())
    policy = NoisePolicy(1.0, False, False, 0.0, 1.0)
    history = History((8, 4, kinds.HEAD + pose.NUMBERS), Model(q, policy, at.layout()))
    x = np.zeros(at.NOMINAL)
    x[[at.X_Q, at.X_QIC, at.X_QWL]] = 1.0
    x[at.X_V : at.X_V + 3] = rng.normal(size=3)
    history.start(0, x, R)
    s, history.last = history.snapshots, 1
    s.t[1], s.x[1], s.P[1] = 5_000_000, x, R
    s.imu[1] = np.r_[0.1, -0.2, 0.3, 0.2, 0.1, 9.8, np.ones(6)]
    cov = moment(history, 5_000_000 - back_ns).nav.cov
    loud = {name: 100.0 for name in q._fields if name not in ("gravity", "pose_bias_rate")}
    history.model = history.model._replace(q=q._replace(**loud))
    np.testing.assert_array_equal(moment(history, 5_000_000 - back_ns).nav.cov, cov)
    assert np.linalg.eigvalsh(cov).min() > 0.0
    on = moment(history, 5_000_000 + back_ns).nav.cov
    assert np.trace(on) > np.trace(cov) + 0.1, "and forward it is added"
