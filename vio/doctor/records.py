"""What the doctor knows of a flight controller, and what it finds: frozen records."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from vio.config.mavlink import MavlinkConfig


class Severity(StrEnum):
    """error: vision is not used, or the vehicle will not arm or not fly safely; warning: it works
    worse than it could; info: good to know."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


@dataclass(frozen=True, slots=True)
class Change:
    """A parameter as it is and as it should be."""

    name: str
    old: float
    new: float


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing: a short code, what is so, why it matters, what to do, what --fix would write."""

    severity: Severity
    code: str
    what: str
    why: str
    do: str = ""
    change: Change | None = None


@dataclass(frozen=True, slots=True)
class VisionSeen:
    """Poses of another sender that are heard on the same link.

    name: of the message; rate_hz; ages_ms: arrival minus stamp, empty where the stamps are in
    another clock than this computer's monotonic one; repeats: stamps that came twice; frames: pairs
    (frame_id, child_frame_id) of ODOMETRY.
    """

    name: str
    rate_hz: float
    ages_ms: tuple[float, ...] = ()
    repeats: int = 0
    frames: frozenset[tuple[int, int]] = frozenset()


@dataclass(frozen=True, slots=True)
class Facts:
    """All that was read and measured of one flight controller in `seconds`.

    params: by name; complete: a name that is not in it does not exist; version_1: its last message
    was MAVLink 1; timesync_asked: how often it asked; responders: others that answer it; others:
    further companion computers; signed: what it sends is, and we have no key; belief: what differs
    between it and the poses heard; imu_hz: None: not asked for; ekf_flags,
    origin: None: never heard.
    """

    autopilot: int
    config: MavlinkConfig
    seconds: float
    params: Mapping[str, float] = field(default_factory=dict)
    complete: bool = True
    armed: bool = False
    alive: bool = True
    version_1: bool = False
    timesync_asked: int = 0
    rtts_ms: tuple[float, ...] = ()
    drift: float = 0.0
    clock_steps: int = 0
    responders: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    imu_hz: float | None = None
    ekf_flags: int | None = None
    origin: bool = False
    home: bool = False
    range_finder: bool = False
    vision: VisionSeen | None = None
    texts: tuple[str, ...] = ()
    signed: bool = False
    belief: str | None = None

    @property
    def message(self) -> str:
        """Which pose message is sent: the one heard, else the configured one."""
        return self.config.message if self.vision is None else self.vision.name

    @property
    def velocity(self) -> bool:
        """Whether velocity is sent besides the pose."""
        return self.message == "ODOMETRY" or self.config.speed
