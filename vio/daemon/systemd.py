"""Tells systemd how the service is (sd_notify): a few lines over the socket that it names."""

import os
import socket
from contextlib import suppress


class Systemd:
    """The notify socket of this service, if there is one; `watchdog_s`: how often it wants a word.

    From the environment: NOTIFY_SOCKET, WATCHDOG_USEC, WATCHDOG_PID; see sd_notify(3).
    """

    def __init__(self, environment: "dict[str, str] | os._Environ[str]" = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        if address[:1] in ("/", "@"):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
            self._address = "\0" + address[1:] if address[0] == "@" else address
        usec = environment.get("WATCHDOG_USEC", "")
        mine = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(usec) * 1e-6 if usec.isdigit() and mine else None

    def tell(self, *words: str) -> None:
        """Send words such as READY=1, STATUS=...; nobody listening is no fault."""
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto("\n".join(words).encode(), self._address)

    def close(self) -> None:
        """Give the socket back."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
