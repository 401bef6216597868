"""The live view: a client gets scene, image and plots; a stalled one costs the flight nothing."""

import json
import socket
import struct
import threading
import time

import numpy as np
import pytest
from cli_calls import tagvio
from live_client import TOPICS, Client
from oracles.suspect_study import flight
from simulated import grid_map, pinhole

from tagvo.pipeline import TagVO
from tagvo.records import Frame
from vio.errors import VioError
from vio.records import NavState
from vio.sinks.live_messages import expected

pytest.importorskip("foxglove")
from vio.sinks.live_view import LiveView


@pytest.fixture(scope="module")
def flown():
    recording, seen = flight(1, "t1_qr", ("stream.rate_hz=10", "flight.takeoff=false"))
    vo = TagVO(recording.camera, recording.tag_map)
    return recording, [(frame, vo.trace(frame)) for frame in seen[:60]]


def play(view, recording, shown, image):
    for k, (frame, trace) in enumerate(shown):
        view.event(Frame(frame.t_ns, image, trace.detections))
        view.look(trace)
        pose = trace.pose
        if pose is not None:
            known_ns = frame.t_ns + 1000 * k
            state = NavState(frame.t_ns, pose.p_WC, pose.R_WC, np.zeros(3), pose.cov, known_ns)
            view.output("vio", state)
        time.sleep(0.005)


def test_a_client_gets_image_scene_and_plots(flown):
    recording, shown = flown
    view = LiveView(recording.tag_map, recording.camera, port=0)
    try:
        client = Client(view.port)
        topics = client.subscribe()
        assert set(topics.values()) == TOPICS
        time.sleep(0.2)
        image = np.full(recording.camera.resolution[::-1], 90, dtype=np.uint8)
        player = threading.Thread(target=play, args=(view, recording, shown, image))
        player.start()
        got, until = {}, time.monotonic() + 20.0
        wanted = TOPICS - {"/log", "/filter/health"}
        while not wanted <= set(got) and time.monotonic() < until:
            opcode, payload = client.frame()
            if opcode == 2 and payload[0] == 1:
                subscription, t_ns = struct.unpack_from("<IQ", payload, 1)
                got.setdefault(topics[subscription], (t_ns, payload[13:]))
        player.join()
    finally:
        view.close()
    assert wanted <= set(got)
    assert b"\xff\xd8\xff" in got["/camera/image"][1]  # a JPEG
    state = json.loads(got["/filter/state"][1])
    assert set(state["position_m"]) == {"x", "y", "z"}
    assert state["sigma_m"]["x"] > 0.0
    assert json.loads(got["/filter/figures"][1])["tags_seen"] > 0
    assert got["/filter/state"][0] in {frame.t_ns for frame, _ in shown}
    assert view.counters["live_frames"] > 10
    assert "live_faults" not in view.counters


def test_a_stalled_client_does_not_make_the_flight_wait(flown):
    """Time that the flight spends on the view, five pairs, with a client that reads and without."""
    recording, shown = flown
    image = np.random.default_rng(0).integers(0, 255, recording.camera.resolution[::-1],
                                              dtype=np.uint8)  # fmt: skip

    def cost(stalled):
        view = LiveView(recording.tag_map, recording.camera, port=0)
        try:
            client = None
            if stalled:
                client = Client(view.port)
                client.subscribe()
                client.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            taken = []
            for frame, trace in shown:
                start = time.perf_counter()
                view.event(Frame(frame.t_ns, image, trace.detections))
                view.look(trace)
                taken.append(time.perf_counter() - start)
                time.sleep(0.004)
            return 1e3 * float(np.median(taken))
        finally:
            start = time.monotonic()
            view.close()
            assert time.monotonic() - start < 2.5  # a stalled viewer does not hold up the end
            if client is not None:
                client.socket.close()

    pairs = [(cost(False), cost(True)) for _ in range(5)]
    alone, stalled = np.median(pairs, axis=0)
    assert stalled - alone <= max(0.1 * alone, 2.0)
    assert stalled < 2.0


def test_what_is_expected_in_the_picture_is_where_the_tags_are(flown):
    recording, shown = flown
    trace = next(t for _, t in shown if t.pose is not None and len(t.observations) >= 4)
    corners = expected(recording.tag_map, recording.camera, trace.pose.R_WC, trace.pose.p_WC)
    found = trace.observations.corners_px
    nearest = [min(np.abs(c - want).max() for c in corners) for want in found]
    assert np.median(nearest) < 4.0  # tags are laid to 2 mm, seen from half a metre


def test_a_port_in_use_is_said(flown):
    recording, _ = flown
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with pytest.raises(VioError, match=r"live view 127\.0\.0\.1"):
            LiveView(recording.tag_map, recording.camera, port=taken.getsockname()[1])


def test_run_writes_an_mcap_that_opens(tmp_path):
    from flying_log import write_flying_log

    log = write_flying_log(tmp_path, seconds=3.0)
    done = tagvio("run", log, "--out", tmp_path / "out", "--mcap", tmp_path / "view.mcap")
    assert done.code == 0, done.err
    assert (tmp_path / "view.mcap").stat().st_size > 10_000
    plain = tagvio("run", log, "--out", tmp_path / "plain")
    assert plain.code == 0
    same = [(tmp_path / d / "vio.tum").read_bytes() for d in ("out", "plain")]
    assert same[0] == same[1]
    data = (tmp_path / "view.mcap").read_bytes()
    assert data[:8] == data[-8:] == b"\x89MCAP0\r\n"  # whole to its end
    assert all(t.encode() in data for t in ("/filter/state", "/filter/figures", "/scene", "/tf"))
    again = tagvio("run", log, "--out", tmp_path / "again", "--mcap", tmp_path / "view.mcap")
    assert again.code == 1
    assert "view.mcap" in again.err


def test_states_are_thinned_by_their_own_clock_which_may_start_anew():
    """At most 20 a second of the states' own time; a clock that goes back is followed."""
    view, shown = LiveView(grid_map(), pinhole()), []
    try:
        view._put = lambda waiting, item, limit, what: shown.append(item.t_ns)
        ms = 1_000_000
        for t_ms in (1000, 1010, 1049, 1050, 1060, 1100, 200, 210, 250):
            known_ns = 10**15 + t_ms * ms * 7  # of another clock, which does not count
            view.output("vio", NavState(t_ms * ms, np.zeros(3), np.eye(3), known_ns=known_ns))
            view.output("vo", NavState(t_ms * ms + 1, np.zeros(3), np.eye(3), known_ns=known_ns))
    finally:
        view.close()
    assert [t // ms for t in shown] == [1000, 1050, 1100, 200, 250]
