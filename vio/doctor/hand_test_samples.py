"""Collects what the autopilot and others say of position and yaw while a hand moves the vehicle."""

from collections import deque
from typing import Any

import numpy as np

from vio.doctor.hand_test import Rest, Step, judge, rest
from vio.doctor.records import Finding
from vio.mavlink.messages import AUTOPILOT_COMPONENT, SET_MESSAGE_INTERVAL, Outgoing, command
from vio.mavlink.vehicle import Vehicle

_ATTITUDE_ID, _LOCAL_POSITION_ID, _INTERVAL_US = 30, 32, 50_000
FC, SENT = "the autopilot's estimate", "the poses sent"
_KEEP = 2000


class HandTestSamples:
    """Rests of every source at every step so far; `judge` says what is wrong."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._p: dict[str, deque[tuple[int, list[float]]]] = {}
        self._yaw: dict[str, deque[tuple[int, float]]] = {}
        self.rests: dict[str, dict[Step, Rest | None]] = {FC: {}}
        self._steps = list(Step)

    def questions(self, system: int) -> list[Outgoing]:
        """What must be asked of the autopilot before."""
        ids = (_ATTITUDE_ID, _LOCAL_POSITION_ID)
        return [command(system, SET_MESSAGE_INTERVAL, number, _INTERVAL_US) for number in ids]

    def heard(self, message: Any, now_ns: int) -> None:
        """Take any message of the link."""
        name = message.get_type()
        if self._vehicle.is_mine(message):
            if name == "LOCAL_POSITION_NED":
                self._add_p(FC, now_ns, message)
            elif name == "ATTITUDE":
                self._add_yaw(FC, now_ns, message.yaw)
        elif message.get_srcComponent() == AUTOPILOT_COMPONENT:
            return
        elif name == "VISION_POSITION_ESTIMATE":
            self._add_p(SENT, now_ns, message)
            self._add_yaw(SENT, now_ns, message.yaw)
        elif name == "ODOMETRY":
            w, x, y, z = message.q
            self._add_p(SENT, now_ns, message)
            yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
            self._add_yaw(SENT, now_ns, float(yaw))

    def _add_p(self, who: str, now_ns: int, m: Any) -> None:
        self._p.setdefault(who, deque(maxlen=_KEEP)).append((now_ns, [m.x, m.y, m.z]))

    def _add_yaw(self, who: str, now_ns: int, yaw: float) -> None:
        self._yaw.setdefault(who, deque(maxlen=_KEEP)).append((now_ns, yaw))

    def due(self, now_ns: int) -> list[Outgoing]:
        """Nothing more is asked."""
        return []

    def still(self, since_ns: int) -> bool:
        """Whether every source was heard and held still since then."""
        return all(self._rest(who, since_ns) is not None for who in {FC, *self._p})

    def rested(self, since_ns: int) -> Step:
        """Take what was heard since then as the rest of the next step; which one that was."""
        step = self._steps[len(self.rests[FC])]
        for who in {FC, *self._p}:
            self.rests.setdefault(who, {})[step] = self._rest(who, since_ns)
        return step

    def _rest(self, who: str, since_ns: int) -> Rest | None:
        p = np.array([row for t, row in self._p.get(who, ()) if t >= since_ns])
        yaw = np.array([y for t, y in self._yaw.get(who, ()) if t >= since_ns])
        return rest(p.reshape(-1, 3), yaw)

    def judge(self) -> list[Finding]:
        """What is wrong with the axes, source by source."""
        return [finding for who, rests in self.rests.items() for finding in judge(who, rests)]
