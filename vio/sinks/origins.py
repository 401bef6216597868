"""Lets only pages of known origin at the live view: a small proxy before the Foxglove server.

A web page that a person visits may open ws://127.0.0.1 behind their back; the browser's `Origin`
says which page asks. The SDK's server does not look at it, so it listens at a loopback address that
nobody can guess, and this proxy looks before it connects the two.
"""

import contextlib
import logging
import secrets
import selectors
import socket
import threading
from collections import Counter
from collections.abc import Sequence
from urllib.parse import urlsplit

from vio.errors import VioError

LOG = logging.getLogger("vio.sinks.live")
DESKTOP = "desktop"  # the app that is no page of a site: it sends no origin, or that of a file
LOCAL = "localhost"
_LOCAL_HOSTS = {"localhost", "127.0.0.1", "::1"}
_MOST_HEAD = 8192  # bytes of a request; a browser's has 500
_PATIENCE_S = 5.0
_MOST_VIEWERS = 16
_REFUSAL = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


def hidden_host() -> str:
    """An address of this machine alone, one of 16 million (Linux owns all of 127/8)."""
    a, b, c = (secrets.randbelow(254) + 1 for _ in range(3))
    return f"127.{a}.{b}.{c}"


def origin_of(head: bytes) -> str | None:
    """The Origin of a request's head; None: it has none."""
    for line in head.split(b"\r\n")[1:]:
        name, _, value = line.partition(b":")
        if name.strip().lower() == b"origin":
            return value.strip().decode("latin-1")
    return None


def allowed(origin: str | None, origins: Sequence[str]) -> bool:
    """Whether a page of this origin may look; `*` allows all."""
    if "*" in origins or origin in origins:
        return True
    if origin is None or origin.startswith(("file:", "app:", "foxglove:")):
        return DESKTOP in origins
    try:
        host = urlsplit(origin).hostname
    except ValueError:
        return False
    return LOCAL in origins and host in _LOCAL_HOSTS


class OriginProxy:
    """Listens at host and port and connects whom it lets in with the server at `inner`.

    counters: live_viewers let in, live_refused. `close` ends it.
    """

    def __init__(
        self, host: str, port: int, inner: tuple[str, int], origins: Sequence[str]
    ) -> None:
        """VioError where the port cannot be had."""
        self._inner, self._origins = inner, tuple(origins)
        self.counters: Counter[str] = Counter()
        try:
            self._socket = socket.create_server((host, port))
        except (OSError, OverflowError) as err:
            raise VioError(f"live view {host}:{port}: {err}") from None
        self._slots = threading.BoundedSemaphore(_MOST_VIEWERS)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._accept, name="live view door", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Where it listens."""
        return int(self._socket.getsockname()[1])

    def close(self) -> None:
        """Take nobody in any more; who is in stays until the server ends."""
        self._ending.set()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _accept(self) -> None:
        while not self._ending.is_set():
            try:
                viewer, _ = self._socket.accept()
            except OSError:
                return
            if not self._slots.acquire(blocking=False):
                viewer.close()
                self.counters["live_refused"] += 1
                continue
            threading.Thread(target=self._serve, args=(viewer,), name="live view viewer",
                             daemon=True).start()  # fmt: skip

    def _serve(self, viewer: socket.socket) -> None:
        try:
            with viewer:
                self._admit(viewer)
        except OSError:  # a viewer that leaves
            pass
        finally:
            self._slots.release()

    def _admit(self, viewer: socket.socket) -> None:
        viewer.settimeout(_PATIENCE_S)
        head = b""
        while b"\r\n\r\n" not in head:
            more = viewer.recv(_MOST_HEAD - len(head))
            if not more:
                return
            head += more
            if len(head) >= _MOST_HEAD:
                return
        origin = origin_of(head)
        if not allowed(origin, self._origins):
            self.counters["live_refused"] += 1
            LOG.warning("live view: a page of %.100r was refused; daemon.live.origins allows %s",
                        origin, ", ".join(self._origins))  # fmt: skip
            viewer.sendall(_REFUSAL)
            return
        with socket.create_connection(self._inner, _PATIENCE_S) as server:
            self.counters["live_viewers"] += 1
            server.sendall(head)
            _relay(viewer, server)


def _relay(one: socket.socket, other: socket.socket) -> None:
    """Hand on what comes from either until one of them ends."""
    for end in (one, other):
        end.settimeout(_PATIENCE_S)  # of a write: who does not read is let go
    with selectors.DefaultSelector() as ready:
        ready.register(one, selectors.EVENT_READ, other)
        ready.register(other, selectors.EVENT_READ, one)
        while True:
            for key, _ in ready.select():
                source = key.fileobj
                assert isinstance(source, socket.socket)
                data = source.recv(1 << 16)
                if not data:
                    return
                key.data.sendall(data)
