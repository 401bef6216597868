"""`tagvio demo --quick` from end to end, and that its flight is one a multirotor could fly."""

import json

import numpy as np
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from tagvo import geometry as geo
from vio.assets import config_path
from vio.cli import app
from vio.commands.demo import sentence
from vio.commands.demo_flight import GRAVITY, demo_flight, seconds, stamps
from vio.sources.log import FlightLog


def test_quick_demo(tmp_path):
    done = CliRunner().invoke(app, ["demo", "--quick", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    log = FlightLog.open(tmp_path / "log")
    assert (log.frame_count, len(log.truth), log.warnings) == (61, 401, [])
    rms = {}
    for name in ("new", "joint"):
        content = json.loads((tmp_path / name / "comparison.json").read_text())
        assert content["frames"] == {"total": 61, "with_pose": 61, "fused": None, "rejected": None}
        rms[name] = content["estimators"]["vo"]["capture"]["position_rmse_m"]
        assert content["estimators"]["vo"]["capture"]["coverage"] == 1.0
        for file in ("report.html", "run.json", "vo.tum", "vo_fir.tum"):
            assert (tmp_path / name / file).stat().st_size > 100
    assert rms["joint"] < rms["new"] < 0.02
    last = done.output.strip().splitlines()[-1]
    assert f"the joint pose is {1e3 * rms['joint']:.1f} mm" in last
    assert f"the paper's {1e3 * rms['new']:.1f} mm" in last


def test_the_flight_is_smooth_and_gentle():
    flight, (frame_ns, truth_ns) = demo_flight(), stamps(quick=False)
    t = seconds(truth_ns)
    assert_allclose(np.gradient(flight.p(t), t, axis=0)[1:-1], flight.v(t)[1:-1], atol=2e-3)
    assert_allclose(np.gradient(flight.v(t), t, axis=0)[1:-1], flight.a(t)[1:-1], atol=5e-3)
    assert_allclose(flight.v(t[[0, -1]]), 0.0, atol=1e-9)
    assert_allclose(flight.a(t[[0, -1]]), 0.0, atol=1e-9)
    R = flight.R_WI(t)
    assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    tilt = np.degrees(np.arccos(R[:, 2, 2]))
    assert 1.0 < tilt.max() < 12.0
    force_I = np.einsum("nji,nj->ni", R, flight.a(t) + np.array([0.0, 0.0, GRAVITY]))
    assert_allclose(force_I[:, :2], 0.0, atol=1e-9)  # rotors push along z of the body alone
    assert 0.2 < flight.p(t)[:, 2].min() < 0.4
    assert 1.6 < flight.p(t)[:, 2].max() < 2.2
    assert np.degrees(geo.angle(np.swapaxes(R[:-1], -1, -2) @ R[1:])).max() < 1.0
    assert (frame_ns[0], frame_ns[-1]) == (truth_ns[0], truth_ns[-1])


def test_the_sentence_does_not_flatter():
    def content(mm):
        figures = {"position_rmse_m": 1e-3 * mm, "rotation_rmse_deg": 0.1}
        return {"estimators": {"vo": {"capture": figures}}}

    assert "2.0 times closer" in sentence(content(4.0), content(2.0))
    assert "no closer" in sentence(content(2.0), content(4.0))
    nothing = {"estimators": {"vo": {"capture": None}}}
    assert sentence(nothing, nothing) == "No pose met truth, so there is nothing to compare."


def test_assets_are_there():
    for name in ("maps/arena.yaml", "cameras/arena.yaml", "paper/NEW.yaml", "arena.yaml"):
        assert config_path(name).is_file()
