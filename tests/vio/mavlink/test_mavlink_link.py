"""Real sockets, a real serial line (a pty), real threads: opening, losing, closing, signing."""

import errno
import json
import os
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from fc_live import Live, free_port, pty, tcp_server, udp_to, until
from fc_world import health
from pymavlink.dialects.v20 import ardupilotmega as m

from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError
from vio.mavlink import bridge as bridge_module
from vio.mavlink import transport
from vio.mavlink.bridge import Bridge, now_ns
from vio.mavlink.endpoint import Address, check_baud, parse_url
from vio.mavlink.persistent_state import Saved, first_counter, load_saved, save
from vio.mavlink.transport import TcpClient, UdpSocket, open_transport
from vio.records import Moment, NavState
from vio.sources.live.imu import MavlinkImu

VISION = "VISION_POSITION_ESTIMATE"


@pytest.fixture
def make(tmp_path):
    """Bridges that are stopped whatever happens."""
    made = []

    def bridge(url, **config):
        settings = {
            "state_file": str(tmp_path / "state.json"),
            "imu": {"message": "none"},
            **config,
        }
        made.append(Bridge(MavlinkConfig.model_validate({"url": url, **settings}), np.eye(3),
                           np.zeros(3)))  # fmt: skip
        return made[-1]

    yield bridge
    for one in made:
        one.stop()


def state():
    nav = NavState(0, np.array([1.0, 2.0, 3.0]), np.eye(3), np.zeros(3), np.eye(9) * 1e-4)
    return Moment(now_ns() - 30_000_000, nav, np.zeros(3), np.array([0.0, 0.0, -1.0]))


def fly(bridge, live, n=10):
    """Offer states at 40 Hz until n have arrived."""
    goal = len(live.fc.heard.get(VISION, [])) + n

    def arrived():
        bridge.offer(state(), health(), True)
        time.sleep(0.02)
        return len(live.fc.heard.get(VISION, [])) >= goal

    until(arrived, 8.0, "vision")


# one link of each kind


def check_link(bridge, live):
    bridge.start()
    assert bridge.wait_for_vehicle(5.0) == "PX4"
    samples = []
    imu = MavlinkImu(bridge.companion, np.eye(3), samples.append)
    bridge.listen(imu.heard)
    fly(bridge, live)
    until(lambda: len(samples) > 30, what="IMU")
    for arrival, message in live.fc.heard[VISION]:
        age_ms = (live.start_ns + arrival) * 1e-6 - message.usec * 1e-3
        assert 29.0 < age_ms < 250.0, "stamps are in the one monotonic clock"
    rtt = np.array(live.fc.timesync.rtts) * 1e-6
    assert len(rtt) >= 2
    assert np.median(rtt) < 10.0
    assert np.median([abs(s.arrival_ns - s.t_ns) for s in samples]) < 20e6
    assert bridge.counters["faults"] == 0


def test_udp_that_listens(make):
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}", imu={"message": "HIGHRES_IMU"})
    with Live(udp_to(port)) as live:
        check_link(bridge, live)


def test_udp_that_calls(make):
    port = free_port()
    ends = udp_to(9, own_port=port)
    listening = socket.socket(fileno=os.dup(ends.fileno()))
    peer = []

    def read():
        try:
            data, where = listening.recvfrom(65536)
        except BlockingIOError:
            return b""
        peer[:] = [where]
        return data

    ends.read = read
    ends.write = lambda data: listening.sendto(data, peer[0]) if peer else None
    bridge = make(f"udpout:127.0.0.1:{port}", imu={"message": "HIGHRES_IMU"})
    with Live(ends) as live:
        check_link(bridge, live)
    listening.close()


def test_tcp(make):
    port = free_port(socket.SOCK_STREAM)
    bridge = make(f"tcp:127.0.0.1:{port}", imu={"message": "HIGHRES_IMU"})
    server = []
    waiting = threading.Thread(target=lambda: server.append(tcp_server(port)))
    waiting.start()
    time.sleep(0.05)
    bridge.start()
    waiting.join()
    with Live(server[0]) as live:
        bridge.wait_for_vehicle(5.0)
        fly(bridge, live)
        assert bridge.companion.vehicle.name == "PX4"


def test_a_serial_line(make):
    ends, path = pty()
    bridge = make(f"serial:{path}:921600", imu={"message": "HIGHRES_IMU"})
    with Live(ends) as live:
        check_link(bridge, live)


# losing and finding again


def test_a_server_that_is_not_there_yet_is_waited_for_and_found_again(make, caplog):
    port = free_port(socket.SOCK_STREAM)
    bridge = make(f"tcp:127.0.0.1:{port}")
    bridge.start()
    for _ in range(2):
        with Live(tcp_server(port)) as live:
            fly(bridge, live, 5)
    assert bridge.counters["reconnected"] >= 2
    assert any("trying" in r.message for r in caplog.records)


def test_a_tcp_connection_that_went_deaf_is_opened_anew(make, monkeypatch):
    """A pulled cable ends no connection: only silence tells."""
    monkeypatch.setattr(bridge_module, "_DEAF_NS", 300_000_000)
    port = free_port(socket.SOCK_STREAM)
    server = socket.create_server(("127.0.0.1", port))
    bridge = make(f"tcp:127.0.0.1:{port}")
    bridge.start()
    deaf = server.accept()[0]
    server.settimeout(3.0)
    again = server.accept()[0]
    until(lambda: bridge.counters["reconnected"] == 1)
    for one in (deaf, again, server):
        one.close()


def test_a_simulator_that_comes_back_on_another_port_is_followed(make):
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}")
    bridge.start()
    for _ in range(2):
        with Live(udp_to(port)) as live:
            fly(bridge, live, 5)


def test_a_serial_line_that_is_pulled_does_not_end_it(make):
    ends, path = pty()
    bridge = make(f"serial:{path}:921600")
    with Live(ends) as live:
        bridge.start()
        fly(bridge, live, 3)
    until(lambda: bridge._transport is None, what="the loss")
    bridge.offer(state(), health(), True)
    assert bridge._thread.is_alive()


def test_it_never_spins(make):
    """Idle, without an autopilot, or with a broken link: a hundredth of a core."""
    for url in (f"udpin:127.0.0.1:{free_port()}", f"tcp:127.0.0.1:{free_port(socket.SOCK_STREAM)}"):
        bridge = make(url)
        bridge.start()
        time.sleep(0.2)
        before = time.process_time()
        time.sleep(0.5)
        assert time.process_time() - before < 0.05
        bridge.stop()


def test_it_stops_within_a_second_and_says_so(make):
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}")
    with Live(udp_to(port)) as live:
        bridge.start()
        fly(bridge, live, 3)
        begin = time.monotonic()
        bridge.stop()
        assert time.monotonic() - begin < 1.0
        bridge.stop()
        bridge.offer(state(), health(), True)  # after the end: nothing, and no error
        until(lambda: any("stopped" in f.text for _, f in live.fc.heard.get("STATUSTEXT", [])))


# the state file


def test_the_reset_counter_goes_on_over_restarts(make, tmp_path):
    port, values = free_port(), []
    with Live(udp_to(port)) as live:
        for _ in range(3):
            bridge = make(f"udpin:127.0.0.1:{port}")
            bridge.start()
            fly(bridge, live, 2)
            values.append(live.fc.heard[VISION][-1][1].reset_counter)
            bridge.stop()
    assert values[1] == (values[0] + 1) % 256
    assert values[2] == (values[0] + 2) % 256
    assert json.loads((tmp_path / "state.json").read_text())["reset_counter"] == values[2]


def test_a_reset_in_flight_is_on_disk_before_it_is_sent(make, tmp_path):
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}")
    with Live(udp_to(port)) as live:
        bridge.start()
        fly(bridge, live, 3)
        before = live.fc.heard[VISION][-1][1].reset_counter
        file = tmp_path / "state.json"

        def arrived():
            bridge.offer(state(), health(resets=1), True)
            time.sleep(0.03)
            last = live.fc.heard[VISION][-1][1].reset_counter
            if last != before:
                assert json.loads(file.read_text())["reset_counter"] == last == (before + 1) % 256
            return last != before

        until(arrived)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"reset_counter": "x", "signing_timestamp": 0}'])
def test_a_broken_state_file_is_reported_and_passed_over(tmp_path, text, caplog):
    path = tmp_path / "s.json"
    path.write_text(text)
    assert load_saved(path) == Saved()
    assert "starts anew" in caplog.text
    assert 1 <= first_counter(Saved(), 12345) <= 255
    assert first_counter(Saved(255), 0) == 0


def test_a_state_file_that_cannot_be_written_stops_no_flight(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    assert save(tmp_path / "file" / "state.json", Saved(3)) is False
    assert "may repeat" in caplog.text


# signing


KEY = bytes(range(32))


def test_signed_both_ways(make, tmp_path):
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}", signing={"key_file": str(key)})
    live = Live(udp_to(port))
    for side in (live.fc.mav, live.fc.parser):
        side.signing.secret_key, side.signing.sign_outgoing = KEY, True
        side.signing.timestamp = int((time.time() - 1420070400) * 1e5)
    with live:
        bridge.start()
        fly(bridge, live, 3)
        assert live.fc.parser.signing.goodsig_count > 5
        assert live.fc.parser.signing.badsig_count == 0
        saved = json.loads((tmp_path / "state.json").read_text())["signing_timestamp"]
        assert saved > bridge._codec.timestamp, "no timestamp above it has been used"
        bridge.stop()
        again = make(f"udpin:127.0.0.1:{port}", signing={"key_file": str(key)})
        assert again._codec.timestamp > saved, "grows over a restart, whatever the clock says"


def test_unsigned_or_wrongly_signed_messages_are_not_heard(make, tmp_path):
    key = tmp_path / "key"
    key.write_text("a passphrase")
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}", signing={"key_file": str(key)})
    with Live(udp_to(port)):
        bridge.start()
        with pytest.raises(LinkError, match="no heartbeat"):
            bridge.wait_for_vehicle(0.5)
    assert bridge.counters["heard"] == 0


@pytest.mark.parametrize("text", [None, ""])
def test_a_key_that_is_not_there_is_named(make, tmp_path, text):
    key = tmp_path / "key"
    if text is not None:
        key.write_text(text)
    with pytest.raises(LinkError, match=r"mavlink.signing.key_file .*key"):
        make("udpin:127.0.0.1:9", signing={"key_file": str(key)})


# bad input


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("", "udpin:HOST:PORT"), ("udpin", "udpin:HOST:PORT"), ("http://x:1", "udpin:HOST:PORT"),
        ("udpin:127.0.0.1", "udpin:HOST:PORT"), ("udpin:127.0.0.1:x", "port 'x'"),
        ("udpin:127.0.0.1:0", "from 1 to 65535"), ("udpin:127.0.0.1:65536", "from 1 to 65535"),
        ("udpout::14550", "no host"), ("tcp::5760", "no host"), ("serial:ttyS0:9600", "no device"),
        ("serial:/dev/ttyS0:fast", "baud rate 'fast'"), ("serial:", "no device"),
    ],
)  # fmt: skip
def test_a_wrong_url_is_named_with_what_is_allowed(make, url, says):
    with pytest.raises(LinkError) as caught:
        make(url)
    assert says in str(caught.value)
    assert repr(url) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("url", "address"),
    [
        ("udpin:0.0.0.0:14550", Address("udpin", "0.0.0.0", 14550)),
        ("udp:127.0.0.1:14550", Address("udpin", "127.0.0.1", 14550)),
        ("udp://:14540", Address("udpin", "0.0.0.0", 14540)),
        ("udpout://pi.local:14550", Address("udpout", "pi.local", 14550)),
        ("tcp://127.0.0.1:5760", Address("tcp", "127.0.0.1", 5760)),
        ("serial:///dev/ttyACM0:57600", Address("serial", "/dev/ttyACM0", 57600)),
        ("serial:/dev/ttyAMA0", Address("serial", "/dev/ttyAMA0", 921600)),
        ("/dev/ttyUSB0,460800", Address("serial", "/dev/ttyUSB0", 460800)),
    ],
)
def test_urls_as_other_tools_write_them(url, address):
    assert parse_url(url) == address


def test_a_port_in_use_is_named(make):
    port = free_port()
    taken = UdpSocket(bind=("127.0.0.1", port))
    with pytest.raises(LinkError, match=r"in use"):
        make(f"udpin:127.0.0.1:{port}").start()
    taken.close()


@pytest.mark.parametrize(
    ("path", "says"),
    [("/dev/no_such_line", "no such device"), ("/dev/null", "no serial line"),
     (str(Path(__file__)), "is no device")],
)  # fmt: skip
def test_a_device_that_is_none_is_named(make, path, says):
    with pytest.raises(LinkError, match=says):
        make(f"serial:{path}:921600").start()


@pytest.mark.parametrize(
    ("number", "says"), [(errno.EACCES, "dialout"), (errno.EBUSY, "another program")]
)
def test_a_device_without_permission_or_in_use_is_named(make, monkeypatch, number, says):
    _, path = pty()
    real = os.open

    def refuse(name, *rest):
        if name == path:
            raise OSError(number, os.strerror(number))
        return real(name, *rest)

    monkeypatch.setattr(transport.os, "open", refuse)
    with pytest.raises(LinkError, match=says):
        make(f"serial:{path}:921600").start()


def test_a_baud_rate_that_does_not_exist_is_named(make):
    _, path = pty()
    with pytest.raises(LinkError, match=r"921601.*115200.*921600"):
        make(f"serial:{path}:921601").start()


@pytest.mark.parametrize(
    ("baud", "config", "fits"),
    [
        (57600, {}, False), (115200, {}, False), (230400, {}, True), (921600, {}, True),
        (115200, {"imu": {"message": "none"}}, True),
        (230400, {"imu": {"rate_hz": 400}}, False), (230400, {"signing": {"key_file": "k"}}, False),
    ],
)  # fmt: skip
def test_a_baud_rate_that_cannot_carry_the_imu_is_named(baud, config, fits):
    address = Address("serial", "/dev/ttyAMA0", baud)
    made = MavlinkConfig.model_validate(config)
    check_baud(Address("udpin", "0.0.0.0", 14550), made)
    if fits:
        check_baud(address, made)
        return
    with pytest.raises(LinkError) as caught:
        check_baud(address, made)
    assert str(baud) in str(caught.value)
    assert "HIGHRES_IMU" in str(caught.value)
    assert "921600" in str(caught.value)


def test_a_host_that_does_not_exist_is_named(monkeypatch):
    def nowhere(*_):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(transport.socket, "getaddrinfo", nowhere)
    with pytest.raises(LinkError, match="no such host"):
        open_transport(Address("udpout", "nowhere.invalid", 14550))


def test_a_silent_link_and_an_unknown_autopilot_are_named(make):
    port = free_port()
    bridge = make(f"udpin:127.0.0.1:{port}")
    bridge.start()
    with pytest.raises(LinkError, match=r"no heartbeat of an autopilot in 0.1 s"):
        bridge.wait_for_vehicle(0.1)
    live = Live(udp_to(port))
    live.fc.kind = m.MAV_AUTOPILOT_OPENPILOT
    with live, pytest.raises(LinkError, match="neither ArduPilot"):
        bridge.wait_for_vehicle(3.0)
    assert VISION not in live.fc.heard


# frames over a stream that is full


def test_a_full_stream_drops_whole_frames_and_never_half_a_one():
    server = socket.create_server(("127.0.0.1", 0))
    client = TcpClient(server.getsockname())
    other, _ = server.accept()
    frames = [bytes([k % 256]) * 1000 for k in range(20_000)]
    begin = time.monotonic()
    sent = [f for f in frames if client.write(f)]
    assert time.monotonic() - begin < 2.0, "it never waits"
    assert 0 < len(sent) < len(frames)
    got, other_end = b"", threading.Event()

    def drain():
        nonlocal got
        while len(got) < 1000 * len(sent) and not other_end.is_set():
            got += other.recv(1 << 20)

    reader = threading.Thread(target=drain)
    reader.start()
    extra = b"\xff" * 1000
    until(lambda: client.write(extra), what="room")
    sent.append(extra)
    reader.join(5.0)
    other.setblocking(True)
    while len(got) < 1000 * len(sent):
        got += other.recv(1 << 20)
    assert got == b"".join(sent)
    for one in (client, other, server):
        one.close()
