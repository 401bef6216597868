"""Gives the autopilot a place on earth before the first pose, until it says that it has one."""

import logging
from typing import Any

from vio.mavlink.fields import (
    ARDUPILOT,
    GPS_GLOBAL_ORIGIN_ID,
    REQUEST_MESSAGE,
    Outgoing,
    command,
    set_gps_global_origin,
)
from vio.mavlink.vehicle import Vehicle
from vio.mavlink_settings import OriginConfig

LOG = logging.getLogger("vio.mavlink")
_AGAIN_NS = 1_000_000_000
_WAIT_NS = 5_000_000_000  # then poses go without it: better than none


class OriginKeeper:
    """`ready` holds poses back until the origin is echoed, for five seconds at most."""

    def __init__(self, config: OriginConfig | None) -> None:
        self._config = config
        self.confirmed = False
        self._first_ns: int | None = None
        self._last_ns: int | None = None
        self._given_up = self._said = False

    def due(self, vehicle: Vehicle, now_ns: int) -> list[Outgoing]:
        """What to send now: nothing, or the origin and a question for it.

        Only the question to an armed vehicle: PX4 would move its origin in flight.
        """
        if vehicle.system is None or self.confirmed:
            return []
        if self._config is None:
            self._say_none(vehicle)
            return []
        if self._last_ns is not None and now_ns - self._last_ns < _AGAIN_NS:
            return []
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        self._last_ns = now_ns
        c = self._config
        question = command(vehicle.system, REQUEST_MESSAGE, GPS_GLOBAL_ORIGIN_ID)
        if vehicle.armed:
            return [question]
        return [set_gps_global_origin(vehicle.system, c.lat_deg, c.lon_deg, c.alt_m), question]

    def _say_none(self, vehicle: Vehicle) -> None:
        if not self._said and vehicle.autopilot == ARDUPILOT:
            LOG.warning("mavlink.origin is null: ArduPilot refuses to arm until it has an origin")
        self._said = True

    def heard(self, message: Any) -> None:
        """Take a GPS_GLOBAL_ORIGIN."""
        if message.latitude == 0 and message.longitude == 0:
            return
        if not self.confirmed:
            LOG.info(
                "origin %.7f, %.7f confirmed", message.latitude * 1e-7, message.longitude * 1e-7
            )
        self.confirmed = True

    def ready(self, now_ns: int) -> bool:
        """Whether poses may go out."""
        if self._config is None or self.confirmed or self._given_up:
            return True
        if self._first_ns is not None and now_ns - self._first_ns > _WAIT_NS:
            self._given_up = True
            LOG.warning("the origin is not confirmed after %.0f s: poses go out, the origin is sent"
                        " on; without one ArduPilot refuses to arm", _WAIT_NS * 1e-9)  # fmt: skip
        return self._given_up

    def restarted(self) -> None:
        """The autopilot has started again and knows no origin."""
        self.confirmed = self._given_up = False
        self._first_ns = self._last_ns = None
