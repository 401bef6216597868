"""The daemon's parts alone: recorder and a full disk, watchdog, ground, clocks, queues, meter."""

import os
import socket
import threading
import time

import numpy as np
import pytest
from fc_live import until
from flights import fly
from simulated import grid_map, pinhole

from tagvo.detect.protocol import no_detections
from tagvo.records import Detections, Frame
from vio.config.daemon import RecordConfig
from vio.config.filter import VioConfig
from vio.daemon.detection_threads import Detection
from vio.daemon.ground_detector import GroundJudge
from vio.daemon.latency_meter import Meter
from vio.daemon.preflight import _names
from vio.daemon.recorder import Recorder
from vio.daemon.status import Rates, Status
from vio.daemon.systemd import Systemd
from vio.daemon.time_base import FlightClock
from vio.filter.health import Health, State
from vio.mavlink.messages import Outgoing
from vio.records import Ground, ImuSample, Moment, NavState
from vio.sinks.log_writer import LogWriter
from vio.sources.flight_log.log import FlightLog
from vio.sources.live.live_camera import Latest

MS = 1_000_000


def sample(k, rng):
    return ImuSample(k * 5 * MS, rng.normal(size=3), rng.normal(size=3), k * 5 * MS + 7, k % 2 == 1)


def found(rng, n=3):
    return Detections.of(rng.permutation(9)[:n], rng.uniform(9, 40, (n, 4, 2)), np.zeros(n),
                         rng.uniform(1, 90, n), rng.uniform(0.05, 0.4, (n, 4)))  # fmt: skip


@pytest.fixture
def writer(tmp_path):
    writer = LogWriter(tmp_path / "log")
    writer.setup(grid_map(), pinhole(f=60.0, width=64, height=48))
    return writer


def recorder(writer, said=None, **keys):
    config = RecordConfig.model_validate({"min_free_mb": 0.0, **keys})
    return Recorder(writer, config, lambda text, bad: said.append(text))


def test_what_is_recorded_is_read_to_the_last_bit(writer):
    rng, rec = np.random.default_rng(1), recorder(writer, images_every=2)
    samples = [sample(k, rng) for k in range(6)]
    image = rng.integers(0, 256, (48, 64), dtype=np.uint8)
    frames = [Frame(k * 50 * MS + 3, image, found(rng), 300 * MS + k, 200 * MS + k)
              for k in range(3)]  # fmt: skip
    rec.start()
    for event in [*samples, Ground(31 * MS, True), *frames, Ground(400 * MS, False)]:
        rec.event(event)
    rec.stop()
    log = FlightLog.open(writer.path)
    events = list(log.events())
    assert [type(e) for e in events] == [ImuSample] * 6 + [Ground] + [Frame] * 3 + [Ground]
    for a, b in zip(events[:6], samples, strict=True):
        assert (a.t_ns, a.arrival_ns, a.mean) == (b.t_ns, b.arrival_ns, b.mean)
        np.testing.assert_array_equal([a.gyro_I, a.accel_I], [b.gyro_I, b.accel_I])
    assert [e.on_ground for e in events if isinstance(e, Ground)] == [True, False]
    tags = [e for e in FlightLog.open(writer.path, use_detections=True).events()
            if isinstance(e, Frame)]  # fmt: skip
    for a, b in zip(tags, frames, strict=True):
        for field in ("tag_id", "corners_px", "hamming", "margin", "sigma_px"):
            np.testing.assert_array_equal(getattr(a.detections, field),
                                          getattr(b.detections, field))  # fmt: skip
    with_image = [e.image is not None for e in events[7:10]]
    assert with_image == [True, False, True]
    received = [t for t, e in log.as_received() if isinstance(e, Frame)]
    assert received == [200 * MS, 200 * MS + 2, 300 * MS + 1], "corners come when they were known"


def test_a_full_disk_ends_the_recording_once_and_nothing_else(writer):
    """/dev/full is a disk that is full: the kernel says ENOSPC at every write."""
    rng, said = np.random.default_rng(2), []
    (writer.path / "mav0/imu0").mkdir(parents=True)
    (writer.path / "mav0/imu0/data.csv").symlink_to("/dev/full")
    rec = recorder(writer, said)
    rec.start()
    for k in range(5):
        rec.event(Frame(k + 1, None, found(rng), k + 2))
    until(lambda: (writer.path / "mav0/cam0/data.csv").exists())
    for k in range(50):
        rec.event(sample(k, rng))
    until(lambda: rec.stopped is not None)
    for k in range(50):
        rec.event(sample(k, rng))
    rec.stop()
    assert rec.stopped == "No space left on device"
    assert said == ["recording ended: disk"]
    assert rec.counters == {"record_stopped": 1}
    (writer.path / "mav0/imu0/data.csv").unlink()  # to read of /dev/full would never end
    assert len(list(FlightLog.open(writer.path).events())) == 5


def test_recording_ends_before_the_disk_is_full(writer):
    said = []
    rec = recorder(writer, said, min_free_mb=1e12, sync_s=0.01)
    rec.start()
    rng = np.random.default_rng(0)
    rec.event(sample(0, rng))
    time.sleep(0.03)
    rec.event(sample(1, rng))
    until(lambda: rec.stopped is not None)
    assert "are free, less than min_free_mb" in rec.stopped
    rec.stop()


def test_a_slow_disk_loses_images_first_then_rows_and_counts_them(writer, monkeypatch):
    gate = threading.Event()
    monkeypatch.setattr(writer, "frame", lambda frame: gate.wait())
    monkeypatch.setattr("vio.daemon.recorder._MOST_JOBS", 50)
    rec = recorder(writer, images_every=1)
    rec.start()
    image = np.zeros((48, 64), np.uint8)
    for k in range(60):
        rec.event(Frame(k + 1, image, found(np.random.default_rng(k)), k + 1))
    assert rec.counters["record_images_dropped"] >= 20
    assert 5 <= rec.counters["record_rows_dropped"] <= 15
    gate.set()
    rec.stop()


def test_outputs_and_health_are_recorded_as_they_change(writer):
    rec = recorder(writer)
    rec.start()
    for known in (1, 2):
        rec.output("vio", NavState(5, np.full(3, float(known)), np.eye(3), known_ns=known))
    for t in range(0, 3000 * MS, 10 * MS):
        state = State.INIT if t < 1500 * MS else State.LOST
        rec.health(t, Health(state, ("no_imu",), None, 0))
    rec.sent(Outgoing("HEARTBEAT", {}), 3)
    rec.sent(Outgoing("VISION_POSITION_ESTIMATE", {"usec": 7, "covariance": [float("nan")]}), 9)
    rec.stop()
    flown = writer.path / "flown"
    assert (flown / "vio.tum").read_text().splitlines() == [
        "0.000000005 1.000000000 1.000000000 1.000000000"
        " 0.000000000 0.000000000 0.000000000 1.000000000"
    ]
    rows = [r.split(",")[:2] for r in (flown / "health.csv").read_text().splitlines()[1:]]
    assert rows == [["0", "INIT"], [str(1000 * MS), "INIT"], [str(1500 * MS), "LOST"],
                    [str(2500 * MS), "LOST"]]  # fmt: skip
    assert '"usec": 7' in (flown / "sent.jsonl").read_text()
    assert (flown / "sent.jsonl").read_text().count("\n") == 1


# systemd and status


def notified(tmp_path, **environment):
    listening = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    listening.bind(str(tmp_path / "notify"))
    listening.settimeout(2.0)
    return listening, Systemd({"NOTIFY_SOCKET": str(tmp_path / "notify"), **environment})


def test_sd_notify_words_and_its_absence(tmp_path):
    listening, systemd = notified(tmp_path, WATCHDOG_USEC="4000000", WATCHDOG_PID="1")
    assert systemd.watchdog_s is None, "the watchdog of another process"
    systemd.tell("READY=1", "STATUS=fine")
    assert listening.recv(100) == b"READY=1\nSTATUS=fine"
    listening.close()
    systemd.tell("STATUS=nobody listens")
    systemd.close()
    nobody = Systemd({})
    nobody.tell("READY=1")
    assert nobody.watchdog_s is None
    mine = Systemd({"WATCHDOG_USEC": "4000000", "WATCHDOG_PID": str(os.getpid())})
    assert mine.watchdog_s == 4.0


def test_the_watchdog_is_fed_only_while_frames_and_samples_flow(tmp_path, monkeypatch):
    monkeypatch.setattr("vio.daemon.status._FLOWS_S", 0.4)
    listening, systemd = notified(tmp_path, WATCHDOG_USEC="200000")
    counts = {"frames": 0, "imu": 0}

    def collect(rates, now_s):
        for name, n in counts.items():
            rates.per_second(name, n, now_s)
        return {"line": "well"}

    status = Status(collect, tmp_path / "status.json", systemd)
    assert b"WATCHDOG=1" in look(status, listening, 0.0), "before the first of both it is fed"
    counts.update(frames=5, imu=50)
    assert b"WATCHDOG=1" in look(status, listening, 1.0)
    counts.update(imu=100)
    assert b"WATCHDOG=1" in look(status, listening, 1.3)
    counts.update(imu=150)
    assert b"WATCHDOG=1" not in look(status, listening, 1.5), "frames have stopped"
    counts.update(frames=6, imu=200)
    assert b"WATCHDOG=1" in look(status, listening, 1.7)
    assert (tmp_path / "status.json").read_text() == '{\n "line": "well"\n}\n'
    listening.close()


def look(status, listening, now_s):
    status._look(now_s, False)
    return listening.recv(200)


def test_rates_are_of_the_time_between_two_looks():
    rates = Rates()
    assert rates.per_second("imu", 100, 10.0) == 0.0
    assert rates.per_second("imu", 500, 12.0) == 200.0
    assert rates.silent_s("imu", 12.5) == 0.5
    assert rates.silent_s("frames", 12.5) is None


# ground, clock, detection, meter


def judged(imu, armed=lambda t_s: False):
    judge, out = GroundJudge(VioConfig()), []
    for s in imu:
        word = judge.take(s, armed(s.t_ns * 1e-9))
        if word is not None:
            out.append((round(s.t_ns * 1e-9, 2), word))
    return out


def still(seconds, seed=0):
    rng = np.random.default_rng(seed)
    return [ImuSample(k * 5 * MS, 1e-3 * rng.normal(size=3),
                      [0.0, 0.0, 9.81] + 0.02 * rng.normal(size=3), k * 5 * MS)
            for k in range(int(seconds * 200))]  # fmt: skip


def test_a_vehicle_stands_where_it_is_disarmed_and_still_and_no_sooner():
    words = judged(still(4.0), lambda t_s: t_s >= 3.0)
    assert words[0][1] is False
    assert words[1] == (pytest.approx(1.0, abs=0.25), True)
    assert words[2] == (pytest.approx(3.0, abs=0.01), False), "arming counts at once"
    assert len(words) == 3


def test_a_vehicle_that_is_carried_does_not_stand():
    """T3 rests for 2 s but for the rounding of its first corner, then moves off."""
    words = judged(fly("T3", seconds=12.0).imu)
    assert [w for _, w in words] == [False, True, False]
    assert words[-1][0] == pytest.approx(1.7, abs=0.3), "as it moves off it is known to"


@pytest.mark.parametrize("speed", [1.0, 2.0, 0.5])
def test_a_log_in_quick_motion_is_consistent(speed):
    clock = FlightClock(1_700_000_000_000_000_000, 5_000_000_000, speed)
    t = clock.log0_ns + 3_000_000_000
    assert clock.to_now(t) == 5_000_000_000 + round(3e9 / speed)
    assert clock.to_log(clock.to_now(t)) == t
    before, after = (
        clock.moment(Moment(s, NavState(s, np.array([x, 0.0, 0.0]), np.eye(3), np.ones(3)),
                            np.ones(3), np.array([0.0, 0.0, -1.0])))
        for s, x in ((t, 1.0), (t + 10 * MS, 1.01))
    )  # fmt: skip
    dt = (after.t_ns - before.t_ns) * 1e-9
    v = (after.nav.p_WI[0] - before.nav.p_WI[0]) / dt
    assert before.nav.v_WI[0] == pytest.approx(v, rel=1e-6)
    assert before.w_I[0] == pytest.approx(speed)


def test_detection_drops_what_it_cannot_keep_up_with_and_outlives_faults():
    class Slow:
        camera = pinhole(width=2, height=2)

        def detect(self, frame):
            return self.find(frame, None)[0]

        def find(self, frame, prior):
            time.sleep(0.05)
            if frame.t_ns == 1:
                raise RuntimeError("a bug")
            return found(np.random.default_rng(0)), {"tracked_frames": 1}

    latest, seen = Latest(), []
    detection = Detection(latest, [Slow()], seen.append)
    detection.start()
    for t in range(1, 21):
        latest.put(Frame(t, np.zeros((2, 2), np.uint8)))
        time.sleep(0.01)
    latest.close()
    detection.join(2.0)
    assert detection.counters == {
        "detection_faults": 1, "detected": len(seen), "tracked_frames": len(seen)
    }  # fmt: skip
    assert len(seen) + latest.dropped + 1 == 20
    assert seen[-1].t_ns == 20, "the newest wins"
    assert all(f.detections is not None for f in seen)


def test_a_frame_that_a_later_one_has_overtaken_is_dropped_and_counted():
    """The first frame is held up until the second, in the other thread, is handed on."""
    begun, handed = threading.Event(), threading.Event()

    class Held:
        camera = pinhole(width=2, height=2)

        def detect(self, frame):
            return no_detections()

        def find(self, frame, prior):
            if frame.t_ns == 1:
                begun.set()
                assert handed.wait(5.0)
            return no_detections(), {}

    def hand_on(frame):
        seen.append(frame.t_ns)
        handed.set()

    latest, seen, image = Latest(), [], np.zeros((2, 2), np.uint8)
    detection = Detection(latest, [Held(), Held()], hand_on)
    detection.start()
    latest.put(Frame(1, image))
    assert begun.wait(5.0)
    latest.put(Frame(2, image))
    assert handed.wait(5.0)
    latest.close()
    detection.join(5.0)
    assert seen == [2]
    assert detection.counters == {"detected": 2, "detection_overtaken": 1}


def test_the_meter_knows_each_frame_by_its_stamp():
    meter = Meter()
    for k in range(3):
        meter.frame(k * 100 * MS, k * 100 * MS + 5 * MS, k * 100 * MS + 1 * MS)
    for k in (0, 1, 2):
        usec = k * 100_000
        meter.sent(Outgoing("VISION_POSITION_ESTIMATE", {"usec": usec}), k * 100 * MS + 25 * MS)
    meter.sent(Outgoing("VISION_POSITION_ESTIMATE", {"usec": 250_000}), 275 * MS)
    meter.sent(Outgoing("HEARTBEAT", {}), 280 * MS)
    f = meter.figures()
    assert (f.messages, f.of_frames) == (4, 3)
    assert f.latency_ms == (20.0, 20.0)
    assert f.stamp_error_ms == (1.0, 1.0)
    assert f.rate_hz == pytest.approx(3 / 0.25)


def test_recordings_of_one_second_have_names_of_their_own(tmp_path):
    names = _names(tmp_path, "a")
    assert [n.name for n in names[:3]] == ["a", "a-2", "a-3"]
