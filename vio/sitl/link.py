"""The MAVLink link of a simulated autopilot in simulated time: our companion, and its estimate."""

from typing import Any

import numpy as np

from tagvo.geometry import Array
from vio.config.mavlink import ImuLinkConfig, MavlinkConfig
from vio.errors import LinkError
from vio.filter.health import Health
from vio.frames import ned_from_level
from vio.mavlink.codec import MESSAGE_IDS, Codec
from vio.mavlink.endpoint import parse_url
from vio.mavlink.messages import SET_MESSAGE_INTERVAL, Outgoing, command
from vio.mavlink.protocol import Companion
from vio.mavlink.transport import Transport, open_transport
from vio.records import Moment
from vio.sitl.estimate import Said, Sent

_STREAMS = {"LOCAL_POSITION_NED": 20_000, "ATTITUDE": 20_000}  # [us]
_ASK_NS = 2_000_000_000
_COUNTER = 1  # the autopilot's own is 0


class SimLink:
    """A companion without threads: `turn` at every step of simulated time; its clock is the log's.

    The autopilot's IMU is not asked for, and our poses are those of I: give the companion no lever
    arm, for the simulator has put the autopilot there.
    """

    def __init__(self, config: MavlinkConfig, R_BI: Array) -> None:
        quiet = config.model_copy(update={"imu": ImuLinkConfig(message="none")})
        self.companion = Companion(quiet, R_BI, np.zeros(3), _COUNTER, MESSAGE_IDS)
        self.positions: list[Said] = []
        self.attitudes: list[Said] = []
        self.sent: list[Sent] = []
        self._codec = Codec(config.system_id or 1, config.component_id)
        self._url = config.url
        self._transport: Transport | None = None
        self._asked_ns: int | None = None

    def open(self) -> bool:
        """Open the link; false where nobody listens yet (TCP): the autopilot may still start."""
        if self._transport is None:
            try:
                self._transport = open_transport(parse_url(self._url))
            except OSError:
                return False
        return True

    def turn(self, now_ns: int) -> None:
        """Take all that has come, do all that is due."""
        if not self.open() or self._transport is None:
            return
        try:
            while True:
                data, peer = self._transport.read()
                if not data:
                    break
                self._transport.adopt(peer)
                for message in self._codec.decode(data):
                    self._heard(message, now_ns)
        except ConnectionError as err:
            raise LinkError(f"{self._url}: the autopilot closed the link ({err})") from None
        if self.companion.vehicle.fault is not None:
            raise self.companion.vehicle.fault
        self.companion.resets.saved(self.companion.resets.value)  # nothing outlives a simulation
        if now_ns >= self.companion.due_ns:
            self._send(self.companion.due(now_ns))
        self._ask(now_ns)

    def offer(self, moment: Moment | None, health: Health, captured: bool, now_ns: int) -> None:
        """Send a state of the filter, if it is time for it; None: there is none yet."""
        if moment is None:
            self.companion.note(health, now_ns)
            return
        out = self.companion.offer(moment, health, captured, now_ns)
        levelling, heading = self.companion.resets.levelling, self.companion.heading.rad
        if levelling is not None and heading is not None:
            R_NW = ned_from_level(heading) @ levelling.R_LW
            begins = bool(out) and not self.sent
            if begins or (self.sent and not np.array_equal(self.sent[-1].R_NW, R_NW)):
                self.sent.append(Sent(now_ns, R_NW))
        self._send(out)

    def close(self) -> None:
        """Give the link back."""
        if self._transport is not None:
            self._transport.close()

    def _heard(self, message: Any, now_ns: int) -> None:
        self._send(self.companion.heard(message, now_ns))
        if not self.companion.vehicle.is_mine(message):
            return
        name = message.get_type()
        if name == "LOCAL_POSITION_NED":
            m = message
            numbers = (m.x, m.y, m.z, m.vx, m.vy, m.vz)
            self.positions.append(Said(m.time_boot_ms * 1_000_000, now_ns, numbers))
        elif name == "ATTITUDE":
            m = message
            angles = (m.roll, m.pitch, m.yaw)
            self.attitudes.append(Said(m.time_boot_ms * 1_000_000, now_ns, angles))

    def _ask(self, now_ns: int) -> None:
        """Ask for the estimate until it comes at the rate that was asked for."""
        system = self.companion.vehicle.system
        if system is None or (self._asked_ns and now_ns - self._asked_ns < _ASK_NS):
            return
        self._asked_ns = now_ns
        since = now_ns - _ASK_NS
        for name, rows in (("LOCAL_POSITION_NED", self.positions), ("ATTITUDE", self.attitudes)):
            late = sum(row.arrival_ns > since for row in rows[-200:])
            if late < 0.5 * _ASK_NS / (1000 * _STREAMS[name]):
                number = MESSAGE_IDS[name]
                self._send([command(system, SET_MESSAGE_INTERVAL, number, _STREAMS[name])])

    def _send(self, messages: list[Outgoing]) -> None:
        if self._transport is None:
            return
        system = self.companion.vehicle.system
        if system is not None:
            self._codec.speak_as(system)
        for message in messages:
            try:
                sent = self._transport.write(self._codec.encode(message))
            except OSError:
                sent = False
            self.companion.counters["sim_sent" if sent else "sim_not_sent"] += 1
