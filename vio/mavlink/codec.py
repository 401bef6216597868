"""The one place that imports pymavlink: messages to bytes and back, MAVLink 2 and nothing else."""

import hashlib
import os
from pathlib import Path
from typing import Any

os.environ["MAVLINK20"] = "1"  # before the import: without it pymavlink speaks MAVLink 1

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tagvo.textfile import read_text
from vio.errors import LinkError
from vio.mavlink.messages import Outgoing

MESSAGE_IDS: dict[str, int] = {m.msgname: i for i, m in mavlink.mavlink_map.items()}


class Codec:
    """One link's encoder and decoder: they share a sequence number and the signing state.

    Not for two threads at once: encode under the lock of the writer, decode in the reader.
    """

    def __init__(self, system: int, component: int) -> None:
        self._out = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._in = mavlink.MAVLink(None)
        self._in.robust_parsing = True
        self.bad = self.unknown = 0

    def speak_as(self, system: int) -> None:
        """Use this system id from now on: the vehicle's."""
        self._out.srcSystem = system

    def encode(self, message: Outgoing) -> bytes:
        """The frame of a message, MAVLink 2, signed where signing is set up."""
        kind = mavlink.mavlink_map[MESSAGE_IDS[message.name]]
        packed = kind(**message.fields).pack(self._out)
        self._out.seq = (self._out.seq + 1) % 256
        return bytes(packed)

    def decode(self, data: bytes) -> list[Any]:
        """All messages that these bytes complete; what is broken or wrongly signed is counted."""
        messages = []
        for message in self._in.parse_buffer(data) or ():
            if message.get_type() == "BAD_DATA":
                self.bad += 1
            elif message.get_type().startswith("UNKNOWN_"):
                self.unknown += 1  # no checksum is checked without a definition: noise looks so
            else:
                messages.append(message)
        return messages

    @property
    def refused(self) -> int:
        """Frames that were whole but unsigned, or signed with another key."""
        signing = self._in.signing
        return int(signing.badsig_count + signing.reject_count)

    def sign(self, key: bytes, link_id: int, timestamp: int, accept_unsigned: bool) -> None:
        """Sign what leaves and check what comes; timestamp in 10 us since 2015."""
        for side in (self._out, self._in):
            side.signing.secret_key = key
            side.signing.link_id = link_id
            side.signing.timestamp = timestamp
            side.signing.allow_unsigned_callback = lambda _, number: (
                accept_unsigned or number in (109, 166)  # RADIO_STATUS and RADIO never are signed
            )
        self._out.signing.sign_outgoing = True

    @property
    def timestamp(self) -> int:
        """The signing timestamp that the next message bears."""
        return int(self._out.signing.timestamp)

    def advance(self, timestamp: int) -> None:
        """Move the signing timestamp on to the wall clock and to what was heard, never back."""
        heard = self._in.signing.timestamp
        self._out.signing.timestamp = max(self._out.signing.timestamp, heard, timestamp)


def read_key(path: Path) -> bytes:
    """The 32-byte key of a file: 64 hex digits, or the SHA-256 of a passphrase, as MAVProxy has it.

    Raises LinkError where there is none.
    """
    try:
        text = read_text(path.expanduser(), LinkError).strip()
    except LinkError as err:
        raise LinkError(f"mavlink.signing.key_file {err}") from None
    if not text:
        raise LinkError(f"mavlink.signing.key_file {path}: is empty; 64 hex digits or a passphrase")
    if len(text) == 64 and all(c in "0123456789abcdefABCDEF" for c in text):
        return bytes.fromhex(text)
    return hashlib.sha256(text.encode()).digest()
