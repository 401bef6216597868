"""Reads the parameter sets that are shipped, so that the rules repeat no number of theirs."""

from functools import cache

from vio.config.shipped import config_path
from vio.errors import VioError
from vio.mavlink.messages import ARDUPILOT

_FILES = {True: "autopilot/ardupilot.parm", False: "autopilot/px4.params"}


@cache
def shipped(autopilot: int) -> dict[str, float]:
    """Names and values of the set for an autopilot (MAV_AUTOPILOT)."""
    path = config_path(_FILES[autopilot == ARDUPILOT])
    column = 0 if autopilot == ARDUPILOT else 2  # vehicle and component stand before PX4's names
    values = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        cells = line.split()
        if not cells or line.startswith("#"):
            continue
        try:
            values[cells[column]] = float(cells[column + 1])
        except (IndexError, ValueError):
            raise VioError(f"{path}: {line!r}; a name and a number are needed") from None
    return values
