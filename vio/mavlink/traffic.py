"""What comes over a link where no autopilot is heard: silence, noise, others, unsigned frames."""

import logging
from typing import Any

from vio.mavlink.messages import ONBOARD_CONTROLLER

LOG = logging.getLogger("vio.mavlink")
_MOST = 5  # senders that are named
_SAY_NS = 1_000_000_000  # noise is one line a second at most
_KINDS = {ONBOARD_CONTROLLER: "onboard computer", 6: "ground station", 26: "gimbal", 30: "camera"}


class Traffic:
    """Counts bytes and senders; `words` says what they mean."""

    def __init__(self) -> None:
        self.bytes = self._messages = 0
        self._senders: dict[tuple[int, int], str] = {}
        self._bad, self._said_ns = 0, -(1 << 62)

    def heard(self, message: Any) -> None:
        """A message that was decoded."""
        self._messages += 1
        who = message.get_srcSystem(), message.get_srcComponent()
        if who not in self._senders and len(self._senders) < _MOST:
            self._senders[who] = ""
        if who in self._senders and message.get_type() == "HEARTBEAT":
            self._senders[who] = _KINDS.get(message.type, f"type {message.type}")

    def complain(self, bad: int, now_ns: int) -> None:
        """Log frames that were broken or wrongly signed: bad of them so far."""
        if bad == self._bad or now_ns - self._said_ns < _SAY_NS:
            return
        LOG.warning("%d broken or wrongly signed frames on the link", bad - self._bad)
        self._bad, self._said_ns = bad, now_ns

    def words(self, refused: int) -> str:
        """What came, and what to look at; refused: frames whole but not signed with our key."""
        if self.bytes == 0:
            return "nothing came at all: is the cable, the port or the address right?"
        if refused and not self._messages:
            return (
                f"{refused} frames came that are not signed with our key:"
                " is mavlink.signing.key_file the autopilot's?"
            )
        if not self._messages:
            return (
                f"{self.bytes} bytes came and no MAVLink in them:"
                " is the baud rate right? is it another protocol?"
            )
        named = [f"system {s} component {c}" + (f" ({kind})" if kind else "")
                 for (s, c), kind in self._senders.items()]  # fmt: skip
        return (
            f"MAVLink came from {', '.join(named)} alone: does the router forward the autopilot's?"
            " is it the right port? several autopilots: mavlink.system_id"
        )
