"""The daemon as a process against an in-test PX4: what it sends, records, says, and how it ends."""

import json
import os
import signal
import socket
import time

import numpy as np
import pytest
from cli_calls import tagvio
from fc_live import Live, free_port, udp_to, until
from still_flight import P_WI, Daemon, limit_s, write_config, write_images

VISION = "VISION_POSITION_ESTIMATE"
TRACK = ("--set", "tagvo.track.mode=on")


@pytest.fixture(scope="module")
def hover(tmp_path_factory):
    """A folder with images; each test makes its own configuration in a folder beside."""
    return write_images(tmp_path_factory.mktemp("hover") / "images")


@pytest.fixture
def place(hover, tmp_path):
    (tmp_path / "images").symlink_to(hover)
    return tmp_path


def vision(live):
    return live.fc.heard.get(VISION, [])


def rerun(log, out, *words):
    done = tagvio("run", log, "--out", out, *words)
    assert done.code == 0, done.err
    return out


def same_bytes(log, out):
    """The offline run's trajectories are the recorded ones, byte for byte."""
    for name in ("vo.tum", "vio.tum"):
        flown, again = (log / "flown" / name).read_text(), (out / name).read_text()
        assert flown.count("\n") > 20, name
        assert flown == again, name


def test_flight_end_to_end(place):
    """By tracking, which the replay of its corners need not know of (images would be searched)."""
    port = free_port()
    config = write_config(place, port, record={"folder": "flights", "images_every": 5,
                                               "min_free_mb": 0})  # fmt: skip
    notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notify.bind(str(place / "notify"))
    notify.settimeout(5.0)
    env = {"NOTIFY_SOCKET": str(place / "notify"), "WATCHDOG_USEC": "1000000"}
    with notify, Live(udp_to(port)) as live, Daemon(config, *TRACK, env=env) as daemon:
        until(lambda: len(vision(live)) > 80, 60.0, "vision")
        until(lambda: settled(daemon.status()), 20.0, "status")
        status = daemon.status()
        words = [notify.recv(4096).decode() for _ in range(5)]
        assert words[0].startswith("READY=1")
        took = daemon.stop()
        words += recv_all(notify)
        assert daemon.process.returncode == 0
        assert took < limit_s(1.0)
    check_words(words)
    check_status(status)
    counters = status["counters"]
    assert counters["tracked_frames"] > 0.5 * counters["detected"]
    assert counters["search_no_prior"] > 0
    check_poses(live)
    assert "stopped: no more poses" in " ".join(m.text for _, m in live.fc.heard["STATUSTEXT"])
    log = daemon.log()
    same_bytes(log, rerun(log, place / "out", "--detections"))
    run = json.loads((place / "out/run.json").read_text())
    assert run["frames"]["fused"] > 50
    assert len(list((log / "mav0/cam0/data").glob("*.png"))) >= 10
    check_sent(log, live)


def settled(status):
    return status and status["latency_ms"] and status["state"] == "TRACKING"


def recv_all(notify):
    notify.settimeout(0.2)
    words = []
    try:
        while True:
            words.append(notify.recv(4096).decode())
    except TimeoutError:
        return words


def check_words(words):
    text = "\n".join(words)
    assert "STATUS=TRACKING: " in text
    assert "WATCHDOG=1" in text
    assert "STOPPING=1" in text


def check_status(status):
    assert status["state"] == "TRACKING"
    assert status["vehicle"] == "PX4"
    assert status["recording"]["stopped"] is None
    assert {"m", "deg"} == set(status["sigma"])
    assert status["latency_ms"]["p99"] >= status["latency_ms"]["p50"] > 0.0
    assert {"detect", "tagpose", "filter", "loop"} <= set(status["timing_ms"])
    assert status["counts"]["with_pose"] > 20


def check_poses(live):
    """Where the still vehicle truly is, in NED with the map's x to the north."""
    poses = [m for _, m in vision(live)][30:]
    p = np.array([[m.x, m.y, m.z] for m in poses])
    assert np.abs(p - [P_WI[0], -P_WI[1], -P_WI[2]]).max() < 0.02
    usec = np.array([m.usec for m in poses])
    assert (np.diff(usec) > 0).all(), "no pose twice"
    rate = (len(usec) - 1) / (usec[-1] - usec[0]) * 1e6
    assert 10.0 < rate < 32.0


def check_sent(log, live):
    """sent.jsonl holds the poses that the autopilot got."""
    rows = [json.loads(line) for line in (log / "flown/sent.jsonl").read_text().splitlines()]
    sent = [(r["usec"], np.float32(r["x"])) for r in rows if r["name"] == VISION]
    got = [(m.usec, np.float32(m.x)) for _, m in vision(live)]
    assert sent == got
    states = [line.split(",")[1] for line in (log / "flown/health.csv").read_text().splitlines()]
    assert "TRACKING" in states


def test_camera_unplugged_and_back_then_the_link_cut_and_back(place):
    port = free_port()
    config = write_config(place, port, record={})
    live = Live(udp_to(port))
    live.__enter__()
    with Daemon(config) as daemon:
        until(lambda: len(vision(live)) > 20, 60.0, "vision")
        hidden = place / "away"
        (place / "images").rename(hidden)  # the images of this round are still given: wait
        until(lambda: daemon.said("the camera has gone"), 10.0, "loss")
        until(lambda: (daemon.status() or {})["state"] != "TRACKING", what="coasting")
        n = len(vision(live))
        time.sleep(1.0)
        assert len(vision(live)) <= n + 20, "coasting ends after half a second"
        quiet = len(vision(live))
        hidden.rename(place / "images")
        until(lambda: daemon.said("the camera is back"), 10.0, "return")
        until(lambda: len(vision(live)) > quiet + 20, 10.0, "vision")
        until(lambda: daemon.status()["state"] == "TRACKING", what="tracking")
        counters = daemon.status()["counters"]
        assert counters["camera_lost"] == counters["camera_returned"] == 1
        until(lambda: "camera is back" in texts(live), what="the word at the ground station")
        assert "camera lost" in texts(live)
        live.__exit__()
        time.sleep(1.5)
        with Live(udp_to(port), seed=1) as again:
            until(lambda: len(vision(again)) > 20, 20.0, "vision after the cut")
            assert daemon.stop() < limit_s(1.0)


def texts(live):
    return " ".join(m.text for _, m in live.fc.heard.get("STATUSTEXT", []))


def test_killed_while_recording_what_was_saved_replays_to_the_same_bytes(place):
    port = free_port()
    config = write_config(place, port, camera={"device": "images", "rate_hz": 20.0,
                                               "repeat": True})  # fmt: skip
    with Live(udp_to(port)) as live, Daemon(config) as daemon:
        until(lambda: len(vision(live)) > 60, 60.0, "vision")
        daemon.stop(signal.SIGKILL)
    log = daemon.log()
    out = rerun(log, place / "out")
    for name in ("vo.tum", "vio.tum"):
        flown, again = (log / "flown" / name).read_text(), (out / name).read_text()
        whole = flown[: flown.rindex("\n") + 1]
        assert whole.count("\n") > 20
        assert again.startswith(whole), "the recording ends before the run does, at most by a row"
        assert again.count("\n") - whole.count("\n") <= 3


def test_stops_while_it_waits_for_the_flight_controller(place):
    with Daemon(write_config(place, free_port())) as daemon:
        until(lambda: (place / "state.json").exists(), 60.0, "the link")
        time.sleep(0.5)
        assert daemon.stop() < limit_s(1.0)
        assert daemon.process.returncode == 0
    assert not (place / "flights").exists() or not os.listdir(place / "flights")
