"""What `tagvio replay --sitl` will do: files, figures and exit code of a whole run."""

import json
import socket
from pathlib import Path

import numpy as np
import pytest
from fc_live import free_port
from fc_px4 import GOOD
from fc_sitl import RunningArduPilot, RunningPx4
from flying_log import write_flying_log

from vio.commands.sitl_replay import replay_into_sitl
from vio.errors import LogError
from vio.offline.choice import Choice
from vio.sinks.tum import read_tum


def choice(log, out, *assignments):
    return Choice(Path(log), Path(out), None, assignments, "imu0", False, None, 1, None, 0.0)


@pytest.mark.parametrize(("autopilot", "kind"), [("ardupilot", RunningArduPilot),
                                                 ("px4", RunningPx4)])  # fmt: skip
def test_a_run_leaves_both_trajectories_and_their_figures(autopilot, kind, tmp_path, capsys):
    log = write_flying_log(tmp_path, seconds=4.0)
    port, link = free_port(socket.SOCK_STREAM), free_port()
    out = tmp_path / "out"
    with kind(port, link) as running:  # it calls on until somebody listens
        if autopilot == "px4":
            running.fc.timesync.good = GOOD - 5  # it has been answered for 50 s before
        replay_into_sitl(choice(log, out), f"udpin:127.0.0.1:{link}", autopilot, 1.0, port)
        running.stopped.set()
    t_ns, p, q = read_tum(out / "fc.tum")
    assert len(t_ns) > 80
    assert (np.diff(t_ns) > 0).all()
    assert np.isfinite(p).all()
    assert np.linalg.norm(q, axis=1) == pytest.approx(1.0)
    content = json.loads((out / "comparison.json").read_text())
    assert set(content["estimators"]) == {"vio", "fc"}
    assert content["estimators"]["fc"]["now"]["position_rmse_m"] < 0.05
    assert content["frames"]["total"] == 40, "the last is known after the end"
    said = capsys.readouterr().out
    assert "poses of the autopilot" in said
    assert "s of simulated time" in said


def test_a_log_without_an_imu_is_refused(tmp_path):
    log = write_flying_log(tmp_path, seconds=1.0, imu=False)
    with pytest.raises(LogError, match="no IMU"):
        replay_into_sitl(choice(log, tmp_path / "out"), f"udpin:127.0.0.1:{free_port()}",
                         "px4", 1.0, 0)  # fmt: skip
