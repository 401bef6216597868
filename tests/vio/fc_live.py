"""An in-test autopilot at the end of a real socket or line, in real time, in a thread."""

import contextlib
import os
import select
import socket
import threading
import time

import numpy as np
from fc_px4 import Px4
from fc_vehicle import Vehicle


class Ends:
    """A way for bytes: read and write without waiting; what select waits for."""

    def __init__(self, read, write, fileno, close):
        self.read, self.write, self.fileno, self.close = read, write, fileno, close


def udp_to(port, own_port=0):
    """Calls 127.0.0.1:port, as a simulator does."""
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    s.bind(("127.0.0.1", own_port))
    s.setblocking(False)

    def write(data):
        with contextlib.suppress(OSError):
            s.sendto(data, ("127.0.0.1", port))

    def read():
        with contextlib.suppress(OSError):
            return s.recv(65536)
        return b""

    return Ends(read, write, s.fileno, s.close)


def free_port(kind=socket.SOCK_DGRAM):
    with socket.socket(socket.AF_INET, kind) as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def stream(fd_read, fd_write, fileno, close):
    def write(data):
        with contextlib.suppress(OSError):
            fd_write(data)

    def read():
        with contextlib.suppress(OSError):
            return fd_read(65536)
        return b""

    return Ends(read, write, fileno, close)


def tcp_server(port, timeout_s=5.0):
    """Waits for one client."""
    listener = socket.create_server(("127.0.0.1", port))
    listener.settimeout(timeout_s)
    s, _ = listener.accept()
    listener.close()
    s.setblocking(False)
    return stream(s.recv, s.send, s.fileno, s.close)


def pty():
    """The autopilot's end of a serial line, and the path of ours."""
    import tty

    ours, theirs = os.openpty()
    tty.setraw(ours)
    os.set_blocking(ours, False)
    path = os.ttyname(theirs)
    os.close(theirs)

    def read(n):
        return os.read(ours, n)

    def write(data):
        return os.write(ours, data)

    return stream(read, write, lambda: ours, lambda: os.close(ours)), path


class Live:
    """Runs a Px4 (or another kind) at one end; within `with` it lives."""

    def __init__(self, ends, kind=Px4, seed=0, **keys):
        self.ends = ends
        self.start_ns = time.monotonic_ns()
        self.fc = kind(Vehicle(), np.random.default_rng(seed), **keys)
        self.stopped = threading.Event()
        self.thread = threading.Thread(target=self.live, daemon=True)

    def now(self):
        return time.monotonic_ns() - self.start_ns

    def live(self):
        while not self.stopped.is_set():
            readable, _, _ = select.select([self.ends.fileno()], [], [], 0.004)
            if readable:
                data = self.ends.read()
                if data:
                    self.fc.receive(data, self.now())
                else:
                    self.stopped.wait(0.004)
            out = self.fc.poll(self.now())
            if out:
                self.ends.write(b"".join(out))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stopped.set()
        self.thread.join()
        self.ends.close()


def until(true, timeout_s=30.0, what="it"):
    """Wait for something to come true, without hurry."""
    end = time.monotonic() + timeout_s
    while not true():
        assert time.monotonic() < end, f"{what} did not come in {timeout_s} s"
        time.sleep(0.01)
