"""Gathers the facts: reads parameters, listens, asks; without a thread, a socket or a clock."""

from collections import Counter, deque
from typing import Any

import numpy as np

from vio.config.mavlink import MavlinkConfig
from vio.doctor.checks import names
from vio.doctor.params import ParamReader
from vio.doctor.records import Facts, VisionSeen
from vio.mavlink.belief import BeliefCheck, sent_pose
from vio.mavlink.clock import to_ours
from vio.mavlink.messages import (
    ARDUPILOT,
    AUTOPILOT_COMPONENT,
    GPS_GLOBAL_ORIGIN_ID,
    ONBOARD_CONTROLLER,
    REQUEST_MESSAGE,
    Outgoing,
    command,
)
from vio.mavlink.protocol import Companion

_SECOND = 1_000_000_000
_HOME_ID, _EKF_STATUS_ID, _ESTIMATOR_STATUS_ID, _ODOMETRY = 242, 193, 230, "ODOMETRY"
_VERSION_1 = 0xFE  # first byte of a MAVLink 1 frame
_OTHER_CLOCK_NS = 5 * _SECOND
_PATIENCE_NS = 90 * _SECOND  # for the parameters of a slow link
_POSES = ("VISION_POSITION_ESTIMATE", _ODOMETRY)


class Listener:
    """What is heard of other senders' poses: stamps, ages, frames."""

    def __init__(self) -> None:
        self._of: dict[str, deque[tuple[int, int]]] = {}
        self._frames: set[tuple[int, int]] = set()
        self._last: dict[str, int] = {}
        self._repeats: Counter[str] = Counter()

    def heard(self, message: Any, now_ns: int) -> None:
        """Take a pose of another sender."""
        name = message.get_type()
        stamp = (message.time_usec if name == _ODOMETRY else message.usec) * 1000
        if name == _ODOMETRY:
            self._frames.add((message.frame_id, message.child_frame_id))
        self._repeats[name] += self._last.get(name) == stamp
        self._last[name] = stamp
        self._of.setdefault(name, deque(maxlen=1000)).append((now_ns, now_ns - stamp))

    def seen(self) -> VisionSeen | None:
        """What has been heard; None: too little to say."""
        name = max(self._of, key=lambda n: len(self._of[n]), default="")
        rows = list(self._of.get(name, ()))
        if len(rows) < 3:
            return None
        span_s = (rows[-1][0] - rows[0][0]) * 1e-9
        ages = tuple(age * 1e-6 for _, age in rows if abs(age) < _OTHER_CLOCK_NS)
        frames = frozenset(self._frames) if name == _ODOMETRY else frozenset()
        rate = (len(rows) - 1) / max(span_s, 1e-3)
        return VisionSeen(name, rate, ages, self._repeats[name], frames)


class Examiner:
    """Give it all that is heard and send what it answers, until `done`; then take `facts`."""

    def __init__(
        self, companion: Companion, config: MavlinkConfig, seconds: float, now_ns: int
    ) -> None:
        """companion: whose vehicle is known already; config: as it will fly (the companion's own
        may differ, so that nothing is changed by looking); seconds: how long to listen at least.
        """
        self._companion, self._config = companion, config
        self._seconds, self._start_ns = seconds, now_ns
        vehicle = companion.vehicle
        assert vehicle.system is not None
        assert vehicle.autopilot is not None
        self._system, self._autopilot = vehicle.system, vehicle.autopilot
        self.reader = ParamReader(self._system, self._autopilot, *names(self._autopilot))
        self._poses = Listener()
        self._asked_ns = now_ns - _SECOND
        self._version_1 = False
        self._asked = 0
        self._rtts: list[float] = []
        self._responders: set[str] = set()
        self._others: set[str] = set()
        self._flags: int | None = None
        self._heard: set[str] = set()
        self._origin = False
        self._texts: list[str] = []
        self._signed = False
        belief = config.belief
        self._belief = None if belief is None else BeliefCheck(belief, settled=True)

    def heard(self, message: Any, now_ns: int) -> None:
        """Take any message of the link."""
        name = message.get_type()
        if not self._companion.vehicle.is_mine(message):
            self._of_another(message, name, now_ns)
            return
        self._version_1 = message.get_msgbuf()[0] == _VERSION_1
        self._heard.add(name)
        self._signed |= self._companion.signs(message)
        if name == "PARAM_VALUE":
            self.reader.heard(message, now_ns)
        elif name == "TIMESYNC":
            self._asked += message.tc1 == 0
            if message.tc1 and 0 <= now_ns - message.ts1 < _SECOND:
                self._rtts.append((now_ns - message.ts1) * 1e-6)
        elif name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
            self._flags = message.flags
        elif name in ("LOCAL_POSITION_NED", "ATTITUDE") and self._belief is not None:
            self._believes(self._belief, message, now_ns)
        elif name == "GPS_GLOBAL_ORIGIN":
            self._origin |= bool(message.latitude or message.longitude)
        elif name == "STATUSTEXT":
            self._texts.append(message.text.rstrip("\0"))

    def _believes(self, belief: BeliefCheck, message: Any, now_ns: int) -> None:
        """What the autopilot takes for its position and yaw."""
        track, t_ns = self._companion.clock, now_ns
        if track is not None:
            t_ns = to_ours(track, message.time_boot_ms * 1_000_000)
        if message.get_type() == "ATTITUDE":
            belief.yaw(t_ns, message.yaw)
        else:
            belief.position(t_ns, np.array([message.x, message.y, message.z]))

    def _of_another(self, message: Any, name: str, now_ns: int) -> None:
        ours = (self._system, self._config.component_id)  # the daemon that flies, beside us
        who = f"{message.get_srcSystem()}/{message.get_srcComponent()}"
        if name == "HEARTBEAT" and message.type == ONBOARD_CONTROLLER:
            if message.get_srcComponent() != AUTOPILOT_COMPONENT:
                self._others.add(who)
        elif name == "TIMESYNC" and message.tc1 != 0:
            if (message.get_srcSystem(), message.get_srcComponent()) == ours:
                return
            self._responders.add(who)
        elif name in _POSES and message.get_srcComponent() != AUTOPILOT_COMPONENT:
            self._poses.heard(message, now_ns)
            if self._belief is not None:
                pose = sent_pose(name, message.to_dict())
                if (
                    pose is not None and abs(now_ns - pose.t_ns) < _SECOND
                ):  # else its stamps are of another clock
                    self._belief.sent(pose, message.reset_counter)

    def due(self, now_ns: int) -> list[Outgoing]:
        """What to ask now."""
        out = self.reader.due(now_ns)
        if now_ns - self._asked_ns < _SECOND:
            return out
        self._asked_ns = now_ns
        status = _EKF_STATUS_ID if self._autopilot == ARDUPILOT else _ESTIMATOR_STATUS_ID
        wanted = [status]
        wanted += [] if self._origin else [GPS_GLOBAL_ORIGIN_ID]
        wanted += [] if "HOME_POSITION" in self._heard else [_HOME_ID]
        return out + [command(self._system, REQUEST_MESSAGE, number) for number in wanted]

    def done(self, now_ns: int) -> bool:
        """Whether enough is known, or the vehicle has gone."""
        if not self._companion.vehicle.alive(now_ns):
            return True
        if self.reader.done:
            return now_ns - self._start_ns >= self._seconds * 1e9
        return now_ns - self._start_ns >= self._seconds * 1e9 + _PATIENCE_NS

    def facts(self, now_ns: int) -> Facts:
        """All that is known by now."""
        companion = self._companion
        track, imu = companion.clock, companion.imu
        return Facts(
            autopilot=self._autopilot,
            config=self._config,
            seconds=(now_ns - self._start_ns) * 1e-9,
            params=dict(self.reader.values),
            complete=self.reader.complete,
            armed=companion.vehicle.armed,
            alive=companion.vehicle.alive(now_ns),
            version_1=self._version_1,
            timesync_asked=self._asked,
            rtts_ms=tuple(self._rtts),
            drift=0.0 if track is None or not _certain(track.variance) else -track.rate,
            clock_steps=companion.counters["clock_steps"],
            responders=tuple(sorted(self._responders)),
            others=tuple(sorted(self._others)),
            imu_hz=None if imu is None else imu.rate_hz(now_ns),
            ekf_flags=self._flags,
            origin=self._origin,
            home="HOME_POSITION" in self._heard,
            range_finder="DISTANCE_SENSOR" in self._heard,
            vision=self._poses.seen(),
            texts=tuple(self._texts),
            signed=self._signed,
            belief=None if self._belief is None else self._belief.words(),
        )


def _certain(variance: tuple[float, float, float]) -> bool:
    """Whether the clock's rate is known well enough to speak of."""
    return bool(variance[2] < 3e-4**2)
