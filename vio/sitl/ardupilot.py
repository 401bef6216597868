"""The simulator's end of ArduPilot's JSON interface: servo packets in, states as JSON lines out.

Written from libraries/SITL/examples/JSON/readme.md: we listen on UDP port 9002 and answer to where
packets come from. Each packet counts up and is answered by one line; a packet that comes again has
had no answer; a count that begins anew is an autopilot that has started again.
"""

import json
import socket
import struct
from collections import Counter

from vio.errors import LinkError
from vio.sitl.records import SimState

PORT = 9002
_FORMATS = {18458: "<HHI16H", 29569: "<HHI32H"}  # by magic: rate, count, servos
_SIZES = {struct.calcsize(f): magic for magic, f in _FORMATS.items()}
_USUAL_HZ = 400
_PATIENCE_S = 25.0  # it asks again after 10 s


class ArduPilotEnd:
    """`sim_vehicle.py --model JSON:127.0.0.1` calls; `servos` is what it wants of its motors."""

    def __init__(
        self, host: str = "127.0.0.1", port: int = PORT, patience_s: float = _PATIENCE_S
    ) -> None:
        """Raises LinkError where the port is in use."""
        self.counters: Counter[str] = Counter()
        self.servos: tuple[int, ...] = ()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as err:
            self._socket.close()
            raise LinkError(
                f"SITL port {host}:{port}: {err.strerror}; another simulator may run"
            ) from None
        self._socket.settimeout(patience_s)
        self._where = f"udp:{host}:{port}"
        self._peer: tuple[str, int] | None = None
        self._count, self._rate = -1, _USUAL_HZ

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._socket.getsockname()[1])

    @property
    def period_ns(self) -> int:
        """As SIM_RATE_HZ wants it."""
        return round(1e9 / self._rate)

    def start(self) -> None:
        """Wait for its first packet."""
        self._count, self.servos = self._receive(
            "start it with --model JSON:127.0.0.1 (sim_vehicle.py -f quad --model JSON:127.0.0.1)"
        )

    def step(self, state: SimState) -> bool:
        """Answer the packet at hand, wait for the next one; False: it has started again."""
        line = state_line(state)
        self._send(line)
        while True:
            count, servos = self._receive("it was there before: look at its console")
            if count == self._count:  # our answer did not reach it
                self.counters["asked_again"] += 1
                self._send(line)
                continue
            again = count < self._count
            self.counters["restarts"] += again
            self.counters["packets_lost"] += 0 if again else count - self._count - 1
            self._count, self.servos = count, servos
            return not again

    def stop(self) -> None:
        """Give the port back."""
        self._socket.close()

    def _send(self, line: bytes) -> None:
        assert self._peer is not None
        try:
            self._socket.sendto(line, self._peer)
        except OSError:  # it has just ended: it will ask again, or be missed
            self.counters["not_sent"] += 1

    def _receive(self, advice: str) -> tuple[int, tuple[int, ...]]:
        """The count and servos of the next packet that is one."""
        while True:
            try:
                data, peer = self._socket.recvfrom(4096)
            except TimeoutError:
                raise LinkError(f"{self._where}: no ArduPilot SITL calls; {advice}") from None
            except ConnectionRefusedError:
                continue
            magic = _SIZES.get(len(data))
            if magic is None or int.from_bytes(data[:2], "little") != magic:
                self.counters["strange"] += 1
                continue
            _, rate, count, *servos = struct.unpack(_FORMATS[magic], data)
            self._peer, self._rate = peer, rate or _USUAL_HZ
            return count, tuple(servos)


def state_line(state: SimState) -> bytes:
    """A state as ArduPilot reads it: one JSON object between two line feeds."""
    content = {
        "timestamp": state.t_ns * 1e-9,
        "imu": {"gyro": state.gyro_F.tolist(), "accel_body": state.accel_F.tolist()},
        "position": state.p_N.tolist(),
        "quaternion": state.q_NF.tolist(),
        "velocity": state.v_N.tolist(),
    }
    return b"\n" + json.dumps(content, separators=(",", ":"), allow_nan=False).encode() + b"\n"
