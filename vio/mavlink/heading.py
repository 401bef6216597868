"""The compass heading of the map: from the configuration, or from the autopilot's own attitude."""

import logging
from collections import deque
from math import atan2, cos, degrees, hypot, log, radians, sin, sqrt

from tagvo.geometry import Array
from vio.config.mavlink import MavlinkConfig
from vio.frames import Levelling, heading_of_map
from vio.records import NavState

LOG = logging.getLogger("vio.mavlink")
_ENOUGH, _SPAN_NS = 20, 1_000_000_000
_NEAR_NS = 100_000_000
_SPREAD = radians(3.0)


class Heading:
    """`rad` is the heading of the levelled map's x, None until the autopilot's yaw has told it.

    The autopilot's yaw is compared with ours over a second of agreement, once.
    """

    def __init__(self, config: MavlinkConfig, R_BI: Array) -> None:
        given = config.map_heading_deg
        self.rad: float | None = None if given == "fc" else radians(given)
        self._R_BI = R_BI
        self._yaws: deque[tuple[int, float]] = deque(maxlen=40)
        self._found: deque[tuple[int, float]] = deque(maxlen=40)

    @property
    def sought(self) -> bool:
        """Whether the autopilot's attitude is still needed."""
        return self.rad is None

    def attitude(self, t_ns: int, yaw_rad: float) -> None:
        """Take the autopilot's yaw at a stamp of our clock."""
        self._yaws.append((t_ns, yaw_rad))

    def state(self, t_ns: int, nav: NavState, levelling: Levelling) -> None:
        """Take our state at a stamp of our clock: beside the nearest yaw it tells the heading."""
        if self.rad is not None or not self._yaws:
            return
        stamp, yaw = min(self._yaws, key=lambda one: abs(one[0] - t_ns))
        if abs(stamp - t_ns) > _NEAR_NS:
            return
        self._found.append((t_ns, heading_of_map(yaw, levelling, nav.R_WI, self._R_BI)))
        if len(self._found) < _ENOUGH or t_ns - self._found[0][0] < _SPAN_NS:
            return
        x = sum(cos(h) for _, h in self._found) / len(self._found)
        y = sum(sin(h) for _, h in self._found) / len(self._found)
        length = min(1.0, hypot(x, y))
        if length > 0.0 and sqrt(-2.0 * log(length)) < _SPREAD:
            self.rad = atan2(y, x)
            LOG.info("the map's heading by the autopilot's yaw: %.1f deg", degrees(self.rad))

    def relevelled(self) -> None:
        """What was found so far belongs to another levelling."""
        self._found.clear()
