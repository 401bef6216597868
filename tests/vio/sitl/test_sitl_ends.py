"""Our ends of both simulator protocols: lock step, losses, restarts, silence, whole flights."""

import numpy as np
import pytest
from fc_live import free_port
from fc_sitl import RunningArduPilot, RunningPx4
from flying_log import write_flying_log

from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError, LogError
from vio.evaluate.compare import comparison
from vio.localize.localizer import Localizer
from vio.sim.sensors.simple_imu import PIXHAWK
from vio.sitl.ardupilot import ArduPilotEnd
from vio.sitl.play import play
from vio.sitl.px4 import Px4End
from vio.sitl.records import SimState
from vio.sitl.vision import LogVision
from vio.sources.flight_log.log import FlightLog

MS, S = 1_000_000, 10**9


def state(t_ns):
    q = np.array([1.0, 0, 0, 0])
    return SimState(t_ns, np.array([0.01, 0.02, 0.03]), np.array([0.1, 0.2, -9.8]),
                    np.array([1.0, 2.0, -3.0]), np.array([0.1, 0.2, 0.3]), q)  # fmt: skip


def stepped(end, n):
    """n states in a row, 2.5 ms apart; what `step` said of each."""
    return [end.step(state((k + 1) * 2_500_000)) for k in range(n)]


# ArduPilot


@pytest.mark.parametrize("magic", [18458, 29569])
@pytest.mark.parametrize("rate", [400, 1200])
def test_ardupilot_goes_step_by_step(magic, rate):
    end = ArduPilotEnd(port=0, patience_s=5.0)
    with RunningArduPilot(end.port, free_port(), rate=rate, magic=magic) as fc:
        end.start()
        assert all(stepped(end, 40))
        assert end.period_ns == round(1e9 / rate)
        assert len(end.servos) == (16 if magic == 18458 else 32)
        assert len(fc.seen) == 40, "each state once, none ahead"
        now, gyro, accel, p, q, v = fc.seen[-1]
        assert now == 100 * MS
        np.testing.assert_array_equal(gyro, state(0).gyro_F)
        np.testing.assert_array_equal(accel, state(0).accel_F)
        assert (p, v, q) == ([1.0, 2.0, -3.0], [0.1, 0.2, 0.3], [1.0, 0.0, 0.0, 0.0])
        assert end.counters.total() == 0
        fc.stopped.set()
    end.stop()


def test_ardupilots_lost_answers_are_sent_again_and_lost_packets_counted():
    end = ArduPilotEnd(port=0, patience_s=5.0)
    with RunningArduPilot(end.port, free_port(), lose=lambda c: c in (3, 10, 20),
                          skip=lambda c: c % 11 == 5) as fc:  # fmt: skip
        end.start()
        assert all(stepped(end, 30))
        assert end.counters["asked_again"] == 3
        assert end.counters["packets_lost"] >= 2
        times = [row[0] for row in fc.seen]
        assert times == [round((k + 1) * 2.5 * MS) for k in range(30)], "no time twice, none lost"
        fc.stopped.set()
    end.stop()


def test_an_ardupilot_that_starts_again_is_told():
    end = ArduPilotEnd(port=0, patience_s=5.0)
    with RunningArduPilot(end.port, free_port(), restart_at=10) as fc:
        end.start()
        assert stepped(end, 20) == [True] * 9 + [False] + [True] * 10
        assert end.counters["restarts"] == 1
        fc.stopped.set()
    end.stop()


def test_an_ardupilot_that_is_not_there_or_ends():
    end = ArduPilotEnd(port=0, patience_s=0.1)
    with pytest.raises(LinkError, match=r"no ArduPilot SITL calls; start it with --model JSON"):
        end.start()
    with pytest.raises(LinkError, match="another simulator"):
        ArduPilotEnd(port=end.port)
    with RunningArduPilot(end.port, free_port(), end_at=5) as fc:
        end.start()
        with pytest.raises(LinkError, match="look at its console"):
            stepped(end, 20)
        assert len(fc.seen) == 5
    end.stop()


def test_strange_packets_are_passed_over():
    import socket

    end = ArduPilotEnd(port=0, patience_s=5.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        for data in (b"hello", b"\x00" * 40, b"\x1a\x48" + b"\x00" * 70):
            other.sendto(data, ("127.0.0.1", end.port))
    with RunningArduPilot(end.port, free_port()) as fc:
        end.start()
        assert all(stepped(end, 3))
        fc.stopped.set()
    assert end.counters["strange"] == 3
    end.stop()


# PX4


def px4_end(**keys):
    return Px4End(np.random.default_rng(0), port=0, **{"patience_s": 5.0, **keys})


def test_px4_runs_free_until_it_answers_and_then_in_step():
    end = px4_end(gps=True)
    with RunningPx4(end.port, free_port(), free=10) as fc:
        end.start()
        assert all(end.step(state((k + 1) * 4 * MS)) for k in range(200))
        assert end.counters["free_steps"] == 10
        assert end.counters["unanswered"] == 0
        assert len(fc.seen) == 200
        assert end.controls == pytest.approx([0.1] * 16)
        sensor = fc.messages["HIL_SENSOR"][-1]
        assert sensor.time_usec == 1_000_000 + 800_000
        assert [sensor.xacc, sensor.yacc, sensor.zacc] == pytest.approx([0.1, 0.2, -9.8])
        assert [sensor.xgyro, sensor.ygyro, sensor.zgyro] == pytest.approx([0.01, 0.02, 0.03])
        assert sensor.pressure_alt == pytest.approx(488.0 + 3.0)
        assert sensor.abs_pressure == pytest.approx(955.8, abs=0.5)  # standard atmosphere, 491 m
        assert sensor.fields_updated == 0x1FFF
        baro = np.array([m.abs_pressure for m in fc.messages["HIL_SENSOR"]])
        assert len(set(baro.tolist())) > 150, "a sensor that never changes counts as stuck"
        gps = fc.messages["HIL_GPS"]
        assert len(gps) == pytest.approx(4, abs=1)
        assert (gps[0].lat - 473977420) * 1e-7 * 111_319 == pytest.approx(1.0, abs=0.02)
        assert gps[0].alt == 491_000
        truth = fc.messages["HIL_STATE_QUATERNION"]
        assert len(truth) == pytest.approx(40, abs=2)
        assert (truth[0].vx, truth[0].vy, truth[0].vz) == (10, 20, 30)
        fc.stopped.set()
    end.stop()


def test_a_px4_that_misses_an_answer_is_not_waited_for_for_ever(monkeypatch):
    monkeypatch.setattr("vio.sitl.px4._PATIENCE_S", 0.05)
    end = px4_end()
    with RunningPx4(end.port, free_port(), free=2, mute=lambda n: n in (20, 21)) as fc:
        end.start()
        assert all(end.step(state((k + 1) * 4 * MS)) for k in range(40))
        assert end.counters["unanswered"] == 2
        fc.stopped.set()
    end.stop()
    end = px4_end()
    with RunningPx4(end.port, free_port(), free=2, mute=lambda n: n > 10) as fc:
        end.start()
        with pytest.raises(LinkError, match="has not answered"):
            [end.step(state((k + 1) * 4 * MS)) for k in range(60)]
        fc.stopped.set()
    end.stop()


def test_a_px4_that_starts_again_is_told_and_one_that_never_comes():
    end = px4_end()
    with RunningPx4(end.port, free_port(), free=2, restart_at=15) as fc:
        end.start()
        said = [end.step(state((k + 1) * 4 * MS)) for k in range(30)]
        assert said.count(False) == 1
        assert end.counters["restarts"] == 1
        fc.stopped.set()
    end.stop()
    nobody = px4_end(patience_s=0.1)
    with pytest.raises(LinkError, match="no PX4 SITL connects"):
        nobody.start()
    with pytest.raises(LinkError, match="another simulator"):
        Px4End(np.random.default_rng(0), port=nobody.port)
    nobody.stop()


# whole flights


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return FlightLog.open(write_flying_log(tmp_path_factory.mktemp("sitl"), seconds=6.0))


def fed(log):
    return LogVision(log, Localizer(log.camera, log.tag_map, imu_noise=PIXHAWK), lambda: None)


def config(port, **keys):
    url = {"url": f"udpin:127.0.0.1:{port}", "imu": {"message": "none"}, "map_heading_deg": 60.0}
    return MavlinkConfig.model_validate({**url, **keys})


def judged(played, log):
    frames = {"total": None, "with_pose": None, "fused": None, "rejected": None}
    content = comparison([played.fc], log.truth, frames=frames, timing_ms={},
                         t_start_ns=log.t0_ns + 2 * S)  # fmt: skip
    return content["estimators"]["fc"]["capture"]


@pytest.mark.parametrize("kind", ["ardupilot", "px4"])
def test_a_logged_flight_ends_as_the_autopilots_own_estimate_in_the_map(log, kind):
    port, vision = free_port(), fed(log)
    if kind == "ardupilot":
        end = ArduPilotEnd(port=0, patience_s=10.0)
        running = RunningArduPilot(end.port, port)
    else:
        end = px4_end()
        running = RunningPx4(end.port, port)
    with running as fc:
        played = play(log, end, vision, config(port), np.eye(3), np.random.default_rng(0),
                      rest_s=1.5)  # fmt: skip
        fc.stopped.set()
    assert played.seconds == pytest.approx(7.5, abs=0.1)
    assert len(fc.fc.used) > 40
    assert fc.fc.origin is not None, "the origin came before the poses"
    assert len(played.fc) > 200
    assert played.fc.name == "fc"
    stats = judged(played, log)
    assert stats["position_rmse_m"] < 0.08  # its gains are fixed and it knows no biases
    assert stats["rotation_rmse_deg"] < 2.0
    assert stats["n"] > 100
    assert abs(np.median(np.diff(played.fc.t_ns)) - 20 * MS) <= 5 * MS


def test_wrong_axes_would_be_seen(log):
    """The measure itself: an autopilot given another IMU than its poses' does not follow."""
    port = free_port()
    end = ArduPilotEnd(port=0, patience_s=10.0)
    wrong = np.diag([1.0, -1.0, -1.0])  # FLU, not FRD
    vision = fed(log)
    with RunningArduPilot(end.port, port) as fc:
        turn = fc.turn
        fc.turn = lambda t, gyro, accel: turn(t, gyro @ wrong, accel @ wrong)
        played = play(log, end, vision, config(port), np.eye(3), np.random.default_rng(0),
                      rest_s=1.0)  # fmt: skip
        fc.stopped.set()
    assert judged(played, log)["rotation_rmse_deg"] > 20.0


def test_an_autopilot_that_starts_again_before_the_log_gets_its_time_once_more(log):
    port = free_port()
    end = ArduPilotEnd(port=0, patience_s=10.0)
    with RunningArduPilot(end.port, port, restart_at=200) as fc:
        seconds = []
        played = play(log, end, fed(log), config(port), np.eye(3), np.random.default_rng(0),
                      rest_s=1.0, each_second=lambda: seconds.append(1),
                      stop=lambda: len(seconds) >= 4)  # fmt: skip
        times = np.array([row[0] for row in fc.seen])
        fc.stopped.set()
    assert played.counters["restarts"] == 1
    assert (np.diff(times) > 0).all(), "simulated time never runs backward"
    assert 3.0 < played.seconds < 5.5


def test_one_that_starts_again_in_the_middle_ends_it(log):
    port = free_port()
    end = ArduPilotEnd(port=0, patience_s=10.0)
    with RunningArduPilot(end.port, port, restart_at=600) as fc:
        with pytest.raises(LinkError, match=r"started again at 1\.\d s"):
            play(log, end, fed(log), config(port), np.eye(3), np.random.default_rng(0), rest_s=0.2)
        fc.stopped.set()


def test_a_log_without_motion_is_refused(tmp_path):
    import shutil

    folder = write_flying_log(tmp_path, seconds=1.0)
    shutil.rmtree(folder / "mav0/state_groundtruth_estimate0")
    bare = FlightLog.open(folder)
    with pytest.raises(LogError, match="no truth"):
        play(bare, None, None, MavlinkConfig(), np.eye(3), np.random.default_rng(0))
