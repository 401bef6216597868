"""A WebSocket client of the live view, written from the Foxglove protocol's public description."""

import base64
import hashlib
import json
import os
import socket
import struct
import time

TOPICS = {"/camera/image", "/camera/tags", "/camera/calibration", "/scene", "/tf", "/log",
          "/filter/state", "/filter/figures", "/filter/health"}  # fmt: skip


class Client:
    """A WebSocket client of the Foxglove protocol, written from its public description."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        self.socket.sendall(
            (f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\n"
             f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
             "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n").encode())  # fmt: skip
        self.rest = b""
        while b"\r\n\r\n" not in self.rest:
            self.rest += self.socket.recv(4096)
        head, self.rest = self.rest.split(b"\r\n\r\n", 1)
        assert b"101" in head.split(b"\r\n")[0]
        accept = hashlib.sha1(f"{key}258EAFA5-E914-47DA-95CA-C5AB0DC85B11".encode()).digest()
        assert base64.b64encode(accept) in head

    def _exactly(self, n):
        while len(self.rest) < n:
            data = self.socket.recv(65536)
            if not data:
                raise EOFError
            self.rest += data
        out, self.rest = self.rest[:n], self.rest[n:]
        return out

    def frame(self):
        """Opcode and payload of the next message."""
        first, second = self._exactly(2)
        n = second & 127
        if n == 126:
            (n,) = struct.unpack(">H", self._exactly(2))
        elif n == 127:
            (n,) = struct.unpack(">Q", self._exactly(8))
        return first & 15, self._exactly(n)

    def send(self, message):
        data = json.dumps(message).encode()
        mask = os.urandom(4)
        head = bytes([0x81]) + (bytes([0x80 | len(data)]) if len(data) < 126 else
                                bytes([0xFE]) + struct.pack(">H", len(data)))  # fmt: skip
        self.socket.sendall(head + mask + bytes(b ^ mask[i % 4] for i, b in enumerate(data)))

    def subscribe(self, seconds=10.0):
        """Ask for every channel as it is announced; topic by subscription id."""
        topics, until = {}, time.monotonic() + seconds
        while set(topics.values()) < TOPICS and time.monotonic() < until:
            opcode, payload = self.frame()
            if opcode != 1:
                continue
            message = json.loads(payload)
            if message.get("op") != "advertise":
                continue
            new = {c["id"]: c["topic"] for c in message["channels"]}
            self.send({"op": "subscribe", "subscriptions": [
                {"id": i, "channelId": i} for i in new]})  # fmt: skip
            topics |= new
        return topics
