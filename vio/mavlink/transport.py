"""Bytes to and from a flight controller: UDP, TCP and serial lines behind one small interface."""

import errno
import fcntl
import os
import select
import socket
import stat
import termios
import tty
from typing import Protocol

from vio.errors import LinkError
from vio.mavlink.endpoint import Address

Peer = tuple[str, int] | None
_MOST = 65536
_CONNECT_S = 0.8


class Transport(Protocol):
    """A way to a flight controller. OSError from any call: it is broken, open another one."""

    def fileno(self) -> int:
        """What `select` waits for."""

    def read(self) -> tuple[bytes, Peer]:
        """What has come, b"" for nothing; with whom it is from, on UDP."""

    def write(self, data: bytes) -> bool:
        """Send one frame whole, or not at all and say False; never waits."""

    def adopt(self, peer: Peer) -> None:
        """Answer to this peer from now on."""

    def close(self) -> None:
        """Give it back."""


def open_transport(address: Address) -> Transport:
    """Open a link; LinkError for what only the user can mend, OSError for what may mend itself."""
    if address.kind == "serial":
        return SerialLine(address.place, address.number)
    where = f"mavlink.url {address.kind}:{address.place}:{address.number}"
    kind = socket.SOCK_STREAM if address.kind == "tcp" else socket.SOCK_DGRAM
    try:
        found = socket.getaddrinfo(address.place, address.number, socket.AF_INET, kind)
    except socket.gaierror as err:
        raise LinkError(f"{where}: no such host ({err.strerror})") from None
    peer = (str(found[0][4][0]), int(found[0][4][1]))
    if address.kind == "tcp":
        return TcpClient(peer)
    try:
        return UdpSocket(bind=peer) if address.kind == "udpin" else UdpSocket(peer=peer)
    except OSError as err:
        raise LinkError(f"{where}: {_why(err)}") from None


def _why(err: OSError) -> str:
    if err.errno == errno.EADDRINUSE:
        return "the port is in use; end the other program (a ground station?) or take another port"
    if err.errno == errno.EADDRNOTAVAIL:
        return "this computer does not have that address; 127.0.0.1 and 0.0.0.0 always work"
    if err.errno in (errno.EACCES, errno.EPERM):
        return "no permission; ports below 1024 need it"
    return err.strerror or str(err)


class UdpSocket:
    """UDP: listens and answers to whom it heard (bind), or calls (peer)."""

    def __init__(self, bind: Peer = None, peer: Peer = None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._peer, self._fixed = peer, peer is not None
        if bind is not None:
            try:
                self._socket.bind(bind)
            except OSError:
                self._socket.close()
                raise

    def fileno(self) -> int:
        """What `select` waits for."""
        return self._socket.fileno()

    def read(self) -> tuple[bytes, Peer]:
        """One datagram; that nobody listens at the other end is no fault."""
        try:
            return self._socket.recvfrom(_MOST)
        except (BlockingIOError, InterruptedError, ConnectionRefusedError):
            return b"", None

    def write(self, data: bytes) -> bool:
        """One datagram, once there is somebody to send it to."""
        if self._peer is None:
            return False
        try:
            self._socket.sendto(data, self._peer)
        except (BlockingIOError, ConnectionRefusedError):
            return False
        except OSError as err:
            if err.errno in (errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENOBUFS, errno.ENETDOWN):
                return False  # a cable is out: the socket stays good
            raise
        return True

    def adopt(self, peer: Peer) -> None:
        """Answer to this peer; one that is called by its address stays."""
        if not self._fixed and peer is not None:
            self._peer = peer

    @property
    def peer(self) -> Peer:
        """To whom it sends."""
        return self._peer

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()


class _Stream:
    """Frames over a stream of bytes: what did not fit goes first next time, or nothing does."""

    def __init__(self) -> None:
        self._rest = b""

    def _put(self, data: bytes) -> int:
        raise NotImplementedError

    def write(self, data: bytes) -> bool:
        """Send one frame whole, or not at all and say False; never waits."""
        try:
            if self._rest:
                self._rest = self._rest[self._put(self._rest) :]
            if self._rest:
                return False
            self._rest = data[self._put(data) :]
        except BlockingIOError:
            return False
        return True

    def adopt(self, peer: Peer) -> None:
        """A stream has one peer."""


class TcpClient(_Stream):
    """A TCP connection to a flight controller or its simulator."""

    def __init__(self, peer: tuple[str, int]) -> None:
        super().__init__()
        self._socket = socket.create_connection(peer, _CONNECT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """What `select` waits for."""
        return self._socket.fileno()

    def read(self) -> tuple[bytes, Peer]:
        """What has come; ConnectionResetError where the other end has closed."""
        try:
            data = self._socket.recv(_MOST)
        except (BlockingIOError, InterruptedError):
            return b"", None
        if not data:
            raise ConnectionResetError(errno.ECONNRESET, "closed by the other end")
        return data, None

    def _put(self, data: bytes) -> int:
        return self._socket.send(data)

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


class SerialLine(_Stream):
    """A serial device in raw mode, 8N1, without flow control."""

    def __init__(self, path: str, baud: int) -> None:
        super().__init__()
        speed = getattr(termios, f"B{baud}", None)
        where = f"mavlink.url serial:{path}:{baud}"
        if speed is None:
            known = sorted(int(n[1:]) for n in dir(termios) if n[0] == "B" and n[1:].isdigit())
            allowed = ", ".join(str(b) for b in known if b >= 9600)
            raise LinkError(f"{where}: baud rate {baud} is not to be had here; one of {allowed}")
        self._fd = _open_device(path, where)
        try:
            tty.setraw(self._fd)
            set_ = termios.tcgetattr(self._fd)
            set_[2] = (set_[2] | termios.CLOCAL | termios.CREAD) & ~termios.CRTSCTS
            set_[4] = set_[5] = speed
            termios.tcsetattr(self._fd, termios.TCSANOW, set_)
            termios.tcflush(self._fd, termios.TCIOFLUSH)
            fcntl.ioctl(self._fd, termios.TIOCEXCL)
        except termios.error as err:
            os.close(self._fd)
            raise LinkError(f"{where}: is no serial line ({err.args[-1]})") from None

    def fileno(self) -> int:
        """What `select` waits for."""
        return self._fd

    def read(self) -> tuple[bytes, Peer]:
        """What has come; OSError where the device is gone."""
        try:
            data = os.read(self._fd, _MOST)
        except (BlockingIOError, InterruptedError):
            return b"", None
        if not data and select.select([self._fd], [], [], 0)[0]:
            raise ConnectionResetError(errno.ENODEV, "the device is gone")
        return data, None

    def _put(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def close(self) -> None:
        """Give the device back."""
        os.close(self._fd)


def _open_device(path: str, where: str) -> int:
    try:
        if not stat.S_ISCHR(os.stat(path).st_mode):
            raise LinkError(f"{where}: is no device; see `ls /dev/tty*`")
        return os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except PermissionError:
        hint = "add the user to the group dialout: sudo usermod -aG dialout $USER, then log in anew"
        raise LinkError(f"{where}: no permission; {hint}") from None
    except FileNotFoundError:
        raise LinkError(f"{where}: no such device; see `ls /dev/tty*`") from None
    except OSError as err:
        why = "another program uses it" if err.errno == errno.EBUSY else err.strerror
        raise LinkError(f"{where}: cannot be opened ({why})") from None
