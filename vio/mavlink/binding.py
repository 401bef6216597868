"""Which address the vehicle's frames come from: a claimant is refused while the bound one talks."""

import logging
from collections import Counter
from enum import StrEnum

LOG = logging.getLogger("vio.mavlink")
_TALKS_NS = 500_000_000  # after so long a silence the same ids from elsewhere are the same vehicle
_SAY_NS = 1_000_000_000  # a flood of refused frames is one line a second
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
