"""Reads and writes parameters over a link that loses packets: asks again until all is certain.

ArduPilot sends whole numbers as floats, PX4 their bits in the place of a float. Neither answers a
question for a name that it does not have: that is certain only once its whole list was seen.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from vio.doctor.records import Change
from vio.mavlink.messages import AUTOPILOT_COMPONENT, PX4, Outgoing

REAL32 = 9  # MAV_PARAM_TYPE
_INTEGERS = {1: "<Bxxx", 2: "<bxxx", 3: "<Hxx", 4: "<hxx", 5: "<I", 6: "<i"}
_STEP_NS, _BURST = 20_000_000, 4  # 200 questions a second
_WAIT_NS = 400_000_000  # for answers, after a round of questions
_QUIET_NS = 1_000_000_000  # the list has come to its end, or what is missing is lost
_ROUNDS, _LIST_ROUNDS, _TRIES = 4, 12, 12
_NEVER = -(1 << 62)


def decoded(value: float, kind: int, autopilot: int) -> float:
    """The number that a PARAM_VALUE holds."""
    if autopilot != PX4 or kind not in _INTEGERS:
        return value
    return float(struct.unpack(_INTEGERS[kind], struct.pack("<f", value))[0])


def encoded(value: float, kind: int, autopilot: int) -> float:
    """What to put into PARAM_SET's float for a number."""
    if autopilot != PX4 or kind not in _INTEGERS:
        return value
    return float(struct.unpack("<f", struct.pack(_INTEGERS[kind], round(value)))[0])


def request_read(system: int, name: str = "", index: int = -1) -> Outgoing:
    """PARAM_REQUEST_READ by name, or by index where one is given."""
    target = {"target_system": system, "target_component": AUTOPILOT_COMPONENT}
    return Outgoing(
        "PARAM_REQUEST_READ", {**target, "param_id": name.encode(), "param_index": index}
    )


def _float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


class ParamReader:
    """Asks for names, again for those that stay away; where packets get lost, for the whole list.

    `values` and `kinds` by name; `complete`: a name that is not in `values` does not exist.
    """

    def __init__(
        self, system: int, autopilot: int, needed: Sequence[str], others: Sequence[str]
    ) -> None:
        self._system, self._autopilot = system, autopilot
        self._needed, self._names = tuple(needed), (*needed, *others)
        self.values: dict[str, float] = {}
        self.kinds: dict[str, int] = {}
        self.done = self.complete = False
        self._seen: set[int] = set()
        self._count: int | None = None
        self._queue: list[str | int] = list(self._names)
        self._round, self._listing, self._lossy = 1, False, False
        self._news_ns = self._asked_ns = _NEVER

    def heard(self, message: Any, now_ns: int) -> None:
        """Take a PARAM_VALUE of the vehicle."""
        name = message.param_id.rstrip("\0")
        self._lossy |= self._round > 1 and name in self._names and name not in self.values
        self.values[name] = decoded(message.param_value, message.param_type, self._autopilot)
        self.kinds[name] = message.param_type
        if message.param_index < 0xFFFF:
            self._seen.add(message.param_index)
            self._count = message.param_count
        self._news_ns = now_ns

    def due(self, now_ns: int) -> list[Outgoing]:
        """What to ask now."""
        if self.done or now_ns - self._asked_ns < _STEP_NS:
            return []
        if self._queue:
            self._asked_ns = now_ns
            batch, self._queue = self._queue[:_BURST], self._queue[_BURST:]
            return [self._question(one) for one in batch if not self._known(one)]
        if not self._missing():
            self.done = self.complete = True
            return []
        patience = _QUIET_NS if self._listing else _WAIT_NS
        if now_ns - max(self._asked_ns, self._news_ns) < patience:
            return []
        return self._next_of_list(now_ns) if self._listing else self._next_round(now_ns)

    def _known(self, one: str | int) -> bool:
        return one in (self._seen if isinstance(one, int) else self.values)

    def _question(self, one: str | int) -> Outgoing:
        if isinstance(one, int):
            return request_read(self._system, index=one)
        return request_read(self._system, one)

    def _missing(self) -> list[str]:
        return [name for name in self._names if name not in self.values]

    def _next_round(self, now_ns: int) -> list[Outgoing]:
        """Ask again for names; then believe that the rest does not exist, or ask for the list.

        It is believed where the first round alone brought answers: then nothing gets lost.
        """
        if self._round < _ROUNDS and self.values:
            self._round += 1
            self._queue = list(self._missing())
            return []
        if self.values and not self._lossy and all(n in self.values for n in self._needed):
            self.done = self.complete = True
            return []
        self._listing, self._round = True, 0
        return self._next_of_list(now_ns)

    def _next_of_list(self, now_ns: int) -> list[Outgoing]:
        self._asked_ns, self._round = now_ns, self._round + 1
        if self._count is not None and len(self._seen) >= self._count:
            self.done = self.complete = True
            return []
        if self._round > _LIST_ROUNDS:
            self.done = True
            return []
        if self._count is None or self._round == 1:
            target = {"target_system": self._system, "target_component": AUTOPILOT_COMPONENT}
            return [Outgoing("PARAM_REQUEST_LIST", target)]
        self._queue = [i for i in range(self._count) if i not in self._seen]
        return []


class ParamWriter:
    """Writes changes one after another and reads each back; `results`: the value read, or None."""

    def __init__(
        self, system: int, autopilot: int, changes: Sequence[Change], kinds: Mapping[str, int]
    ) -> None:
        self._system, self._autopilot, self._kinds = system, autopilot, kinds
        self._left = list(changes)
        self._reading = False
        self._tries, self._asked_ns = 0, _NEVER
        self.results: dict[str, float | None] = {}

    @property
    def done(self) -> bool:
        """Whether every change was written, or given up."""
        return not self._left

    def heard(self, message: Any, now_ns: int) -> None:
        """Take any message of the link."""
        if message.get_type() != "PARAM_VALUE" or message.get_srcSystem() != self._system:
            return
        if not self._left or message.param_id.rstrip("\0") != self._left[0].name:
            return
        change = self._left[0]
        value = decoded(message.param_value, message.param_type, self._autopilot)
        if self._reading:
            self._finish(value)
        elif _float32(value) == _float32(change.new):
            self._reading, self._tries, self._asked_ns = True, 0, _NEVER

    def _finish(self, value: float | None) -> None:
        self.results[self._left.pop(0).name] = value
        self._reading, self._tries, self._asked_ns = False, 0, _NEVER

    def due(self, now_ns: int) -> list[Outgoing]:
        """What to send now."""
        if not self._left or now_ns - self._asked_ns < _WAIT_NS:
            return []
        change = self._left[0]
        if self._tries == _TRIES:
            if not self._reading:  # no echo: what does it hold?
                self._reading, self._tries = True, 0
            else:
                self._finish(None)
                return []
        self._tries, self._asked_ns = self._tries + 1, now_ns
        if self._reading:
            return [request_read(self._system, change.name)]
        kind = self._kinds.get(change.name, REAL32)
        fields: dict[str, Any] = {"target_system": self._system, "param_type": kind}
        fields |= {"target_component": AUTOPILOT_COMPONENT, "param_id": change.name.encode()}
        fields |= {"param_value": encoded(change.new, kind, self._autopilot)}
        return [Outgoing("PARAM_SET", fields)]


def took(change: Change, read: float | None) -> bool:
    """Whether a change that was read back holds."""
    return read is not None and _float32(read) == _float32(change.new)
