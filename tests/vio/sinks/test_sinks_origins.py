"""The live view's door: pages of unknown origin stay out, others are connected byte for byte."""

import socket
import threading

import pytest

from vio.config.daemon import ORIGINS
from vio.errors import VioError
from vio.sinks.origins import OriginProxy, allowed, hidden_host, origin_of

HEAD = "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\n{}\r\n"


@pytest.mark.parametrize(
    ("origin", "may"),
    [
        ("https://app.foxglove.dev", True),
        (None, True),
        ("file://", True),
        ("http://localhost:8080", True),
        ("http://127.0.0.1", True),
        ("https://evil.example", False),
        ("https://app.foxglove.dev.evil.example", False),
        ("http://localhost.evil.example", False),
        ("null", False),  # a sandboxed frame of any page
        ("http://[", False),
    ],
)
def test_who_may_look(origin, may):
    assert allowed(origin, ORIGINS) is may
    assert allowed(origin, ("*",))
    assert not allowed(origin, ("https://other.example",))


@pytest.fixture
def door():
    server = socket.create_server((hidden_host(), 0))

    def echo():
        while True:
            try:
                one, _ = server.accept()
            except OSError:
                return
            with one:
                one.sendall(b"server:" + one.recv(4096))

    threading.Thread(target=echo, daemon=True).start()
    proxy = OriginProxy("127.0.0.1", 0, server.getsockname(), ORIGINS)
    yield proxy
    proxy.close()
    server.shutdown(socket.SHUT_RDWR)
    server.close()


def asked(door, origin):
    head = HEAD.format("" if origin is None else f"Origin: {origin}\r\n").encode()
    with socket.create_connection(("127.0.0.1", door.port), 5.0) as page:
        page.sendall(head)
        answer = b""
        while more := page.recv(4096):
            answer += more
    return head, answer


def test_a_known_page_is_connected_and_a_strange_one_refused(door):
    head, answer = asked(door, "https://app.foxglove.dev")
    assert answer == b"server:" + head
    _, answer = asked(door, "https://evil.example")
    assert answer.startswith(b"HTTP/1.1 403")
    assert (door.counters["live_viewers"], door.counters["live_refused"]) == (1, 1)
    with pytest.raises(VioError, match="in use"):
        OriginProxy("127.0.0.1", door.port, ("127.0.0.1", 1), ORIGINS)


def test_the_origin_is_found_in_any_case():
    assert origin_of(b"GET / HTTP/1.1\r\nORIGIN:  http://a \r\n\r\n") == "http://a"
    assert origin_of(b"GET / HTTP/1.1\r\n\r\n") is None
