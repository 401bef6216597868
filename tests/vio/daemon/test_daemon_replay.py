"""`tagvio replay` into an in-test autopilot: poses on time and stamped; what users get wrong."""

import json
import re
import shutil
import socket
import subprocess
import time
from contextlib import contextmanager

import numpy as np
import pytest
import yaml
from cli_calls import tagvio
from fc_ardupilot import ArduPilot
from fc_live import Live, free_port, udp_to
from flying_log import write_flying_log
from still_flight import CONFIGS, TAGVIO, write_config, write_images

from vio.sources.flight_log.log import FlightLog

VISION = "VISION_POSITION_ESTIMATE"


def call(*words, timeout=90.0):
    return subprocess.run([*TAGVIO, *map(str, words)], capture_output=True, text=True,
                          timeout=timeout)  # fmt: skip


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    return write_flying_log(tmp_path_factory.mktemp("logs"), 5.0)


def test_a_log_is_flown_into_an_autopilot_in_real_time(flying, tmp_path):
    port = free_port()
    with Live(udp_to(port), ArduPilot) as live:
        start = time.monotonic()
        done = call("replay", flying, "--connect", f"udpin:127.0.0.1:{port}",
                    "--set", f"mavlink.state_file={tmp_path / 'state.json'}")  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert time.monotonic() - start > 5.0
        got = live.fc.heard[VISION]
    assert re.search(r"^51 frames and 1001 IMU samples played; 51 frames looked at, 51 with a pose",
                     done.stdout)  # fmt: skip
    sent = int(re.search(r"^(\d+) poses sent", done.stdout, re.M)[1])
    assert sent == len(got)
    assert "VISO_DELAY_MS" in done.stdout
    stamps_are_captures(flying, live, got)


def stamps_are_captures(log, live, got):
    """Stamps of poses at captures lie as far apart as the log's frames, whatever jitter is."""
    frames = FlightLog.open(log).frames.t_ns
    usec = np.array([m.usec for _, m in got]) * 1000
    off = usec[:, None] - frames
    candidates = off.ravel()
    support = [int((np.abs(off - c).min(axis=1) < 2000).sum()) for c in candidates[:600]]
    at = candidates[int(np.argmax(support))]
    matched = np.abs(off - at).min(axis=1) < 2000
    assert matched.sum() >= 15, "poses at captures"
    arrival = live.start_ns + np.array([t for t, _ in got])
    age_ms = (arrival - usec)[matched] * 1e-6
    assert age_ms.min() > 59.0, "the log's corners are known 60 ms after their capture"
    assert np.median(age_ms) < 110.0


def test_in_quick_motion_a_log_takes_half_the_time(flying, tmp_path):
    port = free_port()
    with Live(udp_to(port)) as live:
        done = call("replay", flying, "--connect", f"udpin:127.0.0.1:{port}", "--speed", 2,
                    "--set", f"mavlink.state_file={tmp_path / 'state.json'}")  # fmt: skip
        assert done.returncode == 0, done.stderr
        t = [t for t, _ in live.fc.heard[VISION]]
    assert 1.0 < (t[-1] - t[0]) * 1e-9 < 2.6


# what users get wrong: one line, exit 1, nothing sent


@contextmanager
def listener():
    """A port at which whatever is sent would be seen."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        s.setblocking(False)
        yield s.getsockname()[1], s


@pytest.fixture(scope="module")
def images(tmp_path_factory):
    return write_images(tmp_path_factory.mktemp("still") / "images", 1)


def mavlink(**keys):
    return lambda c: c["mavlink"].update(keys)


def daemon(**keys):
    return lambda c: c["daemon"].update(keys)


def camera(**keys):
    return lambda c: c["daemon"]["camera"].update(keys)


WRONG = {
    "url": (mavlink(url="tpc:1.2.3.4:5"), "tpc"),
    "port": (mavlink(url="udpin:127.0.0.1:99999"), "99999"),
    "baud": (mavlink(url="serial:/dev/null:57600"), "57600"),
    "misspelt key": (daemon(calibraton="x"), "unknown 'calibraton'; choose one of map, cal"),
    "misspelt camera key": (camera(rate=30), "daemon.camera: unknown 'rate'"),
    "no map": (daemon(map=None), "daemon.map: missing; the tag map"),
    "map not there": (daemon(map="nowhere.yaml"), "nowhere.yaml"),
    "calibration not there": (daemon(calibration="nowhere.yaml"), "nowhere.yaml"),
    "noise not there": (daemon(imu_noise="nowhere.yaml"), "nowhere.yaml"),
    "no camera": (camera(device="/dev/video93"), "/dev/video93: no such device"),
    "no IMU": (mavlink(imu={"message": "none"}), "mavlink.imu.message: none"),
    "folder that cannot be": (daemon(record={"folder": "/proc/flights"}), "/proc/flights"),
    "rate": (camera(rate_hz=0), "daemon.camera.rate_hz"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_a_wrong_configuration_is_one_line_before_anything_is_sent(images, tmp_path, fault):
    (tmp_path / "images").symlink_to(images)
    with listener() as (port, heard):
        path = write_config(tmp_path, free_port())
        change, text = WRONG[fault]
        data = yaml.safe_load(path.read_text())
        data["mavlink"]["url"] = f"udpout:127.0.0.1:{port}"
        change(data)
        path.write_text(yaml.safe_dump(data))
        one_line(call_main("daemon", "--config", str(path)), text)
        with pytest.raises(BlockingIOError):
            heard.recv(100)


def call_main(*words):
    """The command in this process: returns (exit code, stderr)."""
    done = tagvio(*words)
    return done.code, done.err


def one_line(outcome, text):
    code, err = outcome
    assert code == 1, err
    assert text in err
    assert err.startswith("tagvio: ")
    assert err.count("\n") == 1


def test_images_of_another_size_are_refused(images, tmp_path):
    (tmp_path / "images").symlink_to(images)
    text = (CONFIGS / "cameras/arena.yaml").read_text()
    assert "[640, 480]" in text
    (tmp_path / "small.yaml").write_text(text.replace("[640, 480]", "[320, 240]"))
    path = write_config(tmp_path, free_port(), calibration="small.yaml")
    outcome = call_main("daemon", "--check", "--config", str(path))
    one_line(outcome, "images of 640x480; the calibration is for 320x240")


def test_check_says_that_all_is_there_and_sends_nothing(images, tmp_path):
    (tmp_path / "images").symlink_to(images)
    path = write_config(tmp_path, free_port())
    assert call_main("daemon", "--check", "--config", str(path)) == (0, "")


@pytest.mark.parametrize(
    ("url", "text"),
    [
        ("serial:/dev/nosuch:921600", "serial:/dev/nosuch:921600: no such device"),
        ("/dev/nosuch", "serial:/dev/nosuch:921600: no such device"),
        ("serial:/dev/null:921600", "is no serial line"),
        ("serial:/dev/null:1234567", "is not to be had here; one of "),
        ("udpin:nosuch.invalid:14550", "udpin:nosuch.invalid:14550: no such host"),
    ],
)
def test_check_opens_the_link_as_a_flight_does(images, tmp_path, url, text):
    (tmp_path / "images").symlink_to(images)
    path = write_config(tmp_path, free_port())
    checked = call_main("daemon", "--check", "--config", str(path), "--set", f"mavlink.url={url}")
    one_line(checked, text)
    assert call_main("daemon", "--config", str(path), "--set", f"mavlink.url={url}") == checked


def test_who_waits_for_an_autopilot_says_so(images, tmp_path, monkeypatch, caplog):
    (tmp_path / "images").symlink_to(images)
    monkeypatch.setattr("vio.daemon.main._SAY_WAITING_S", 0.1)
    path = write_config(tmp_path, free_port(), vehicle_wait_s=0.6)
    with caplog.at_level("INFO", "vio.daemon"):
        one_line(call_main("daemon", "--config", str(path)), "no heartbeat of an autopilot in")
    said = [record.getMessage() for record in caplog.records]
    assert any(text.startswith("waiting for an autopilot at udpin:") for text in said)
    assert any("still waiting: mavlink.url" in text for text in said)
    status = json.loads((tmp_path / "status.json").read_text())
    assert (status["state"], status["reasons"]) == ("WAITING", ["no_autopilot"])


def test_a_port_in_use_is_one_line(images, tmp_path, flying):
    (tmp_path / "images").symlink_to(images)
    with listener() as (port, _):
        one_line(call_main("daemon", "--config", str(write_config(tmp_path, port))), str(port))
        outcome = call_main("replay", str(flying), "--connect", f"udpin:127.0.0.1:{port}")
        one_line(outcome, str(port))


def test_a_log_without_imu_cannot_be_flown(flying, tmp_path):
    log = tmp_path / "log"
    shutil.copytree(flying, log)
    shutil.rmtree(log / "mav0/imu0")
    one_line(call_main("replay", str(log), "--connect", "udpin:127.0.0.1:0"), "no IMU")


def test_nobody_at_the_other_end_is_one_line(flying, tmp_path, monkeypatch):
    monkeypatch.setattr("vio.daemon.main._REPLAY_WAIT_S", 0.5)
    words = ["replay", str(flying), "--connect", f"udpin:127.0.0.1:{free_port()}",
             "--set", f"mavlink.state_file={tmp_path / 's.json'}"]  # fmt: skip
    one_line(call_main(*words), "no heartbeat of an autopilot in")
