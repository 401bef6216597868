"""Who is at the other end: which autopilot, whether it is there, armed, and whose frames count."""

import logging
from collections import Counter
from enum import StrEnum
from typing import Any

from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError
from vio.mavlink.messages import ARDUPILOT, AUTOPILOT_COMPONENT, NO_AUTOPILOT, PX4

LOG = logging.getLogger("vio.mavlink")
NAMES = {ARDUPILOT: "ArduPilot", PX4: "PX4"}
_NUMBERS = {"ardupilot": ARDUPILOT, "px4": PX4}
# MAV_TYPEs that never fly: antenna tracker, ground station, onboard controller, gimbal, ADSB,
# camera and the rest of the peripherals; some router says theirs with an autopilot's component
NEVER_VEHICLES = frozenset({5, 6, 18, 26, 27, *range(30, 35), *range(36, 43)})
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED
_SILENT_NS = 3_500_000_000  # three heartbeats are missing
_TALKS_NS = 500_000_000  # after so long a silence the same ids from elsewhere are the same vehicle
_SAY_NS = 1_000_000_000  # a flood of refused frames is one line a second


def is_vehicle(message: Any) -> bool:
    """Whether a HEARTBEAT is that of an autopilot: its type tells what it is, not its ids."""
    return message.type not in NEVER_VEHICLES and message.autopilot != NO_AUTOPILOT


class Vehicle:
    """The one autopilot of this link; system and autopilot are None until it is heard."""

    def __init__(self, config: MavlinkConfig) -> None:
        self.system: int | None = None
        self.autopilot: int | None = None
        self.armed = False
        self.fault: LinkError | None = None
        self._wanted, self._named = config.system_id, _NUMBERS.get(config.autopilot)
        self._heard_ns: int | None = None
        self._lost = False

    def is_mine(self, message: Any) -> bool:
        """Whether a message is from this vehicle's autopilot (or might be, while none is known)."""
        if message.get_srcComponent() != AUTOPILOT_COMPONENT:
            return False
        known = self._wanted if self.system is None else self.system
        return known is None or message.get_srcSystem() == known

    def heartbeat(self, message: Any, now_ns: int) -> bool:
        """Take a HEARTBEAT; whether the vehicle has just been found or is back."""
        if not self.is_mine(message) or not is_vehicle(message):
            return False
        if self._named is None and message.autopilot not in NAMES:
            self._unknown(message)
            return False
        news = self.system is None or self._lost
        self.system = message.get_srcSystem()
        self.autopilot = message.autopilot if self._named is None else self._named
        self.armed = bool(message.base_mode & _ARMED)
        self._heard_ns, self._lost, self.fault = now_ns, False, None
        if news:
            LOG.info("%s, system %d, is there", self.name, self.system)
        return news

    def _unknown(self, message: Any) -> None:
        """An autopilot of another make: told once; one that is known is waited for."""
        if self.system is not None or self.fault is not None:
            return
        self.fault = LinkError(
            f"the flight controller (system {message.get_srcSystem()}) is of type"
            f" {message.autopilot}, neither ArduPilot (3) nor PX4 (12); where several talk on this"
            " link name yours: mavlink.system_id=N; if this one behaves as one of them say so:"
            " mavlink.autopilot=ardupilot or px4"
        )
        LOG.warning("%s", self.fault)

    @property
    def name(self) -> str:
        """What it is called."""
        return NAMES.get(self.autopilot or 0, "the flight controller")

    def alive(self, now_ns: int) -> bool:
        """Whether it was heard lately; the loss is logged once."""
        if self._heard_ns is None:
            return False
        if not self._lost and now_ns - self._heard_ns > _SILENT_NS:
            self._lost = True
            LOG.warning("%s is silent for %.1f s", self.name, (now_ns - self._heard_ns) * 1e-9)
        return not self._lost


Address = tuple[str, int] | None


class Claim(StrEnum):
    """What becomes of a frame: REFUSED ones are not heard, ADOPTED ones move the link."""

    HEARD = "heard"
    ADOPTED = "adopted"
    REFUSED = "refused"


class Binding:
    """One vehicle's address on a link where anybody may send; where there are none, ids decide.

    `counters` says how many frames were refused and how often the address moved.
    """

    def __init__(self) -> None:
        self.address: Address = None
        self.counters: Counter[str] = Counter()
        self._heard_ns: int | None = None
        self._said: dict[Address, int] = {}

    def bind(self, address: Address, now_ns: int) -> None:
        """The vehicle speaks from here."""
        self.address, self._heard_ns = address, now_ns

    def judge(self, address: Address, ids: bool, now_ns: int) -> Claim:
        """About a frame that counts: whole, and signed where frames must be; ids: the vehicle's."""
        if address is None:
            return Claim.HEARD
        if address == self.address:
            self._heard_ns = now_ns
            return Claim.HEARD
        if not ids or self.address is None:
            return Claim.HEARD
        if self._heard_ns is not None and now_ns - self._heard_ns <= _TALKS_NS:
            self._refuse(address, now_ns)
            return Claim.REFUSED
        LOG.warning("the vehicle now speaks from %s:%d, before from %s:%d: poses go there",
                    *address, *self.address)  # fmt: skip
        self.counters["address_moved"] += 1
        self.bind(address, now_ns)
        return Claim.ADOPTED

    def _refuse(self, address: Address, now_ns: int) -> None:
        self.counters["refused"] += 1
        if address in self._said or len(self._said) > 100:
            return
        last = max(self._said.values(), default=now_ns - _SAY_NS)
        if address is not None and self.address is not None and now_ns - last >= _SAY_NS:
            self._said[address] = now_ns
            LOG.warning(
                "%s:%d claims to be the vehicle, which speaks from %s:%d: refused",
                *address, *self.address,
            )  # fmt: skip
