"""Whether the autopilot believes what is sent: its position and yaw against the poses' own.

Pure: no link, no clock. What differs is only told; no pose is changed or withheld for it.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from math import degrees, pi
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.config.mavlink import BeliefConfig
from vio.frames import euler_321

_NEAR_NS = 300_000_000  # from a pose sent: further from one nothing is known
_GRACE_NS = 5_000_000_000  # after the first pose and each reset: the autopilot's filter settles
_GAP_NS = 1_000_000_000  # between two comparisons: longer, and a streak of them begins anew
_KEEP = 128  # poses: 3 s at 40 Hz, more than any message is late


class Belief(StrEnum):
    """Unknown until it has agreed or differed for `after_s`."""

    UNKNOWN = "unknown"
    AGREES = "agrees"
    DIFFERS = "differs"


@dataclass(frozen=True, slots=True, eq=False)
class SentPose:
    """A pose that was sent: when it holds [ns, ours], p_NB (3,) [m], yaw [rad]."""

    t_ns: int
    p_NB: Array
    yaw: float


def sent_pose(name: str, fields: Mapping[str, Any]) -> SentPose | None:
    """The pose in the fields of a VISION_POSITION_ESTIMATE or ODOMETRY; None: another message."""
    if name == "VISION_POSITION_ESTIMATE":
        usec, yaw = fields["usec"], fields["yaw"]
    elif name == "ODOMETRY":
        usec = fields["time_usec"]
        yaw = float(euler_321(geo.matrix_from_quat(np.array(fields["q"])))[2])
    else:
        return None
    return SentPose(usec * 1000, np.array([fields["x"], fields["y"], fields["z"]]), yaw)


class Streak:
    """Turns single comparisons of one quantity into a lasting word: after so long of the same."""

    def __init__(self, limit: float, after_s: float) -> None:
        self.limit, self._after_ns = limit, round(after_s * 1e9)
        self.state, self.misfit = Belief.UNKNOWN, 0.0
        self._since_ns = self._last_ns = 0
        self._bad: bool | None = None

    def take(self, misfit: float, t_ns: int) -> None:
        """One comparison at t_ns."""
        bad = not misfit <= self.limit
        if bad is not self._bad or not 0 <= t_ns - self._last_ns <= _GAP_NS:
            self._since_ns = t_ns
        self._bad, self._last_ns, self.misfit = bad, t_ns, misfit
        if t_ns - self._since_ns >= self._after_ns:
            self.state = Belief.DIFFERS if bad else Belief.AGREES


class BeliefCheck:
    """Takes what is sent and what the autopilot says; `state`, the misfits, `count` of alarms."""

    def __init__(self, config: BeliefConfig, settled: bool = False) -> None:
        """settled: the first pose that is told of is not the first that was sent."""
        self._position = Streak(config.position_m, config.after_s)
        self._yaw = Streak(config.yaw_deg, config.after_s)
        self._sent: deque[SentPose] = deque(maxlen=_KEEP)
        self._told: deque[tuple[int, Array | None, float | None]] = deque(maxlen=_KEEP)
        self._counter: int | None = None
        self._settled, self._judged_from_ns = settled, 0
        self.count = 0

    @property
    def state(self) -> Belief:
        """The worse of position and yaw."""
        both = (self._position.state, self._yaw.state)
        if Belief.DIFFERS in both:
            return Belief.DIFFERS
        return Belief.AGREES if Belief.AGREES in both else Belief.UNKNOWN

    @property
    def position_m(self) -> float:
        """The last misfit of position [m]."""
        return self._position.misfit

    @property
    def yaw_deg(self) -> float:
        """The last misfit of yaw [deg]."""
        return self._yaw.misfit

    def sent(self, pose: SentPose, counter: int) -> None:
        """A pose has left with this reset counter; what was said up to its time is compared."""
        if counter != self._counter:
            waits = not self._settled or self._counter is not None
            self._counter, self._judged_from_ns = counter, pose.t_ns + _GRACE_NS * waits
            self._sent.clear()
        self._sent.append(pose)
        ready = [one for one in self._told if one[0] <= pose.t_ns]
        self._told = deque((one for one in self._told if one[0] > pose.t_ns), maxlen=_KEEP)
        for one in ready:
            self._compare(*one)

    def position(self, t_ns: int, p_NB: Array) -> None:
        """The autopilot's local position (3,) [m, NED] at a time of our clock."""
        self._told.append((t_ns, p_NB, None))

    def yaw(self, t_ns: int, yaw_rad: float) -> None:
        """The autopilot's yaw at a time of our clock."""
        self._told.append((t_ns, None, yaw_rad))

    def _compare(self, t_ns: int, p_NB: Array | None, yaw: float | None) -> None:
        pose = self._at(t_ns) if t_ns >= self._judged_from_ns else None
        if pose is None:
            return
        before = self.state
        if p_NB is not None:
            self._position.take(float(np.linalg.norm(p_NB - pose.p_NB)), t_ns)
        if yaw is not None:
            self._yaw.take(degrees(abs(_wrap(yaw - pose.yaw))), t_ns)
        self.count += self.state is Belief.DIFFERS and before is not Belief.DIFFERS

    def _at(self, t_ns: int) -> SentPose | None:
        """The pose sent, interpolated at t_ns; None where none was sent near it."""
        times = [one.t_ns for one in self._sent]
        i = int(np.searchsorted(times, t_ns))
        if i >= len(times) or (i == 0 and times[0] != t_ns):
            return None
        b, a = self._sent[i], self._sent[max(i - 1, 0)]
        if min(t_ns - a.t_ns, b.t_ns - t_ns) > _NEAR_NS:
            return None
        share = (t_ns - a.t_ns) / (b.t_ns - a.t_ns) if b.t_ns > a.t_ns else 0.0
        yaw = a.yaw + share * _wrap(b.yaw - a.yaw)
        return SentPose(t_ns, a.p_NB + share * (b.p_NB - a.p_NB), yaw)

    def words(self) -> str | None:
        """What differs, for the ground station; None where nothing does."""
        if self.state is not Belief.DIFFERS:
            return None
        parts = []
        if self._position.state is Belief.DIFFERS:
            parts.append(f"position by {self.position_m:.2f} m")
        if self._yaw.state is Belief.DIFFERS:
            parts.append(f"yaw by {self.yaw_deg:.0f} deg")
        return f"autopilot differs: {', '.join(parts)}"


def _wrap(angle: float) -> float:
    return (angle + pi) % (2.0 * pi) - pi
