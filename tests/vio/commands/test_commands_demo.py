"""The flight of `tagvio demo` is one a multirotor could fly; the command runs in test_readme."""

import itertools

import numpy as np
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from vio.commands.demo import sentence
from vio.config.shipped import config_path
from vio.records import ImuNoise
from vio.sim.demo import demo_flight, imu_samples, seconds, stamps
from vio.sim.world.trajectory import GRAVITY


def test_the_imu_is_that_of_the_rendered_flight():
    """Integrated from the true start, without noise or bias, it comes back to the true end."""
    flight, (frame_ns, _) = demo_flight(), stamps(quick=True)
    t0 = seconds(frame_ns[0]) - 1.0
    clean = ImuNoise(0.0, 0.0, 0.0, 0.0, 1000.0)
    track = list(imu_samples(flight, clean, quick=True, turn_on=(0.0, 0.0)))
    assert seconds(np.array(track[0].t_ns)) == t0
    assert track[-1].t_ns == frame_ns[-1]
    start = np.array([t0])
    first = flight(start)
    p, v, R = first.p_WI[0], first.v_WI[0], first.R_WI[0]
    for a, b in itertools.pairwise(track):
        dt = (b.t_ns - a.t_ns) * 1e-9
        turn = geo.exp(0.25 * dt * (a.gyro_I + b.gyro_I))
        force_W = R @ turn @ (0.5 * (a.accel_I + b.accel_I)) - [0.0, 0.0, GRAVITY]
        p, v, R = p + dt * v + 0.5 * dt**2 * force_W, v + dt * force_W, R @ turn @ turn
    end = flight(seconds(frame_ns[-1:]))
    assert_allclose(p, end.p_WI[0], atol=1e-4)
    assert_allclose(v, end.v_WI[0], atol=1e-4)
    assert np.degrees(geo.angle(R.T @ end.R_WI[0])) < 1e-3


def test_the_flight_begins_at_rest_on_the_ground():
    flight, (frame_ns, truth_ns) = demo_flight(), stamps(quick=False)
    rest = seconds(truth_ns)[seconds(truth_ns) < 0.0]
    assert len(rest) == 200
    assert_allclose(flight(rest).p_WI, flight(np.zeros(1)).p_WI.repeat(200, axis=0), atol=1e-12)
    assert_allclose(flight(rest).v_WI, 0.0, atol=1e-9)
    samples = imu_samples(flight, ImuNoise(0.0, 0.0, 0.0, 0.0, 200.0), False, turn_on=(0.0, 0.0))
    first = next(iter(samples))
    assert first.t_ns == frame_ns[0] - 10**9
    assert_allclose(first.accel_I, [0.0, 0.0, GRAVITY], atol=1e-9)
    assert_allclose(first.gyro_I, 0.0, atol=1e-9)


def test_the_flight_is_smooth_and_gentle():
    flight, (frame_ns, truth_ns) = demo_flight(), stamps(quick=False)
    t = seconds(truth_ns)
    p, v, a, R = (getattr(flight(t), name) for name in ("p_WI", "v_WI", "a_WI", "R_WI"))
    assert_allclose(np.gradient(p, t, axis=0)[1:-1], v[1:-1], atol=2e-3)
    assert_allclose(np.gradient(v, t, axis=0)[1:-1], a[1:-1], atol=5e-3)
    assert_allclose(v[[0, -1]], 0.0, atol=1e-9)
    assert_allclose(a[[0, -1]], 0.0, atol=1e-9)
    assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    tilt = np.degrees(np.arccos(R[:, 2, 2]))
    assert 1.0 < tilt.max() < 12.0
    force_I = np.einsum("nji,nj->ni", R, a + np.array([0.0, 0.0, GRAVITY]))
    assert_allclose(force_I[:, :2], 0.0, atol=1e-9)  # rotors push along z of the body alone
    assert 0.2 < p[:, 2].min() < 0.4
    assert 1.6 < p[:, 2].max() < 2.2
    assert np.degrees(geo.angle(np.swapaxes(R[:-1], -1, -2) @ R[1:])).max() < 1.0
    assert (frame_ns[0], frame_ns[-1]) == (truth_ns[0], truth_ns[-1])


def test_the_sentence_does_not_flatter():
    def content(mm, live=1.0):
        figures = {"position_rmse_m": 1e-3 * mm, "rotation_rmse_deg": 0.1}
        now = {"position_rmse_m": 1e-3 * live, "rotation_rmse_deg": 0.1}
        held = {**now, "position_rmse_m": 2e-3}
        return {"estimators": {"vo": {"capture": figures, "now": held}, "vio": {"now": now}}}

    assert "2.0 times closer on" in sentence(content(4.0), content(2.0))
    assert "no closer on" in sentence(content(2.0), content(4.0))
    assert "2.0 times closer, at" in sentence(content(1.0), content(1.0))
    assert "no closer, at" in sentence(content(1.0), content(1.0, live=3.0))
    unstarted = content(1.0)
    unstarted["estimators"]["vio"]["now"]["position_rmse_m"] = None
    assert "gave nothing" in sentence(content(1.0), unstarted)
    nothing = {"estimators": {"vo": {"capture": None}}}
    assert sentence(nothing, nothing) == "No pose met truth, so there is nothing to compare."


def test_assets_are_there():
    for name in ("maps/arena.yaml", "cameras/arena.yaml", "paper/NEW.yaml", "arena.yaml"):
        assert config_path(name).is_file()
