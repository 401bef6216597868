"""Asks for a message at a rate and checks what comes: autopilots say yes and send otherwise."""

import logging
from collections import deque

from vio.mavlink.messages import PX4, SET_MESSAGE_INTERVAL, Outgoing, command
from vio.mavlink.vehicle import Vehicle

LOG = logging.getLogger("vio.mavlink")
ACCEPTED = 0
RESULTS = {1: "not now", 2: "denied", 3: "not supported", 4: "failed"}  # MAV_RESULT
_PX4_HZ = 400.0  # 200 asked of PX4 gives 123: it sends each sample or each second one
_PATIENCE_NS = 3_000_000_000
_SPAN_NS = 2_000_000_000
_SHORT = 0.9  # of the rate that is needed
_FAIR = 0.5  # likewise, where a few messages more or less are all the same


class StreamRequest:
    """One message of one vehicle: `due` asks, `arrived` counts, `rate_hz` is what comes."""

    def __init__(self, name: str, message_id: int, rate_hz: float, listens: bool = False) -> None:
        """listens: asks only where too little comes by itself; others may need it faster."""
        self.name, self.needed_hz = name, rate_hz
        self._listens = listens
        self._id = message_id
        self._asked_ns: int | None = None
        self._asked_hz = 0.0
        self._refused = False
        self._tries = 0
        self._arrivals: deque[int] = deque()
        self._said: set[str] = set()

    def rate_hz(self, now_ns: int) -> float:
        """Messages a second over the last two seconds."""
        while self._arrivals and now_ns - self._arrivals[0] > _SPAN_NS:
            self._arrivals.popleft()
        return len(self._arrivals) / (_SPAN_NS * 1e-9)

    def arrived(self, now_ns: int) -> None:
        """Count one."""
        self._arrivals.append(now_ns)
        self.rate_hz(now_ns)

    def due(self, vehicle: Vehicle, now_ns: int) -> list[Outgoing]:
        """The question, where it is time for it."""
        if vehicle.system is None or not vehicle.alive(now_ns):
            return []
        if self._listens and self._asked_ns is None:
            self._asked_ns = now_ns
            return []
        if self._asked_ns is not None:
            if now_ns - self._asked_ns < _PATIENCE_NS * min(4, 1 + self._tries // 3):
                return []
            rate = self.rate_hz(now_ns)
            if rate >= (_FAIR if self._listens else _SHORT) * self.needed_hz:
                self._tries = 0
                return []
            if self._asked_hz:
                self._say(self._shortfall(rate, vehicle))
        self._tries += 1
        self._asked_ns = now_ns
        fast = vehicle.autopilot == PX4 and not self._refused and self.needed_hz > 50.0
        self._asked_hz = max(self.needed_hz, _PX4_HZ) if fast else self.needed_hz
        interval_us = round(1e6 / self._asked_hz)
        return [command(vehicle.system, SET_MESSAGE_INTERVAL, self._id, interval_us)]

    def acknowledged(self, result: int) -> None:
        """Take the answer to the question."""
        if result == ACCEPTED:
            return
        why = RESULTS.get(result, f"result {result}")
        self._say(f"{self.name} at {self._asked_hz:g} Hz: {why} by the autopilot")
        self._refused = True

    def restarted(self) -> None:
        """The autopilot has started again: it has to be asked again."""
        self._asked_ns, self._refused, self._tries = None, False, 0
        self._arrivals.clear()

    def _shortfall(self, rate: float, vehicle: Vehicle) -> str:
        if rate == 0.0:
            return f"{self.name} does not come; {vehicle.name} was asked for {self._asked_hz:g} Hz"
        if self._listens:
            return f"{self.name} comes at {rate:.1f} Hz; {self.needed_hz:g} Hz were asked for"
        return (
            f"{self.name} comes at {rate:.0f} Hz, {self.needed_hz:g} Hz are needed and"
            f" {self._asked_hz:g} were asked for: raise the link's rate (MAV_x_RATE, baud) or"
            " lower mavlink.imu.rate_hz"
        )

    def _say(self, text: str) -> None:
        kind = "".join(c for c in text if not c.isdigit())
        if kind not in self._said:
            LOG.warning("%s", text)
        self._said.add(kind)
