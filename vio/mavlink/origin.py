"""Gives the autopilot a place on earth before the first pose, until it says that it has one."""

import logging
from typing import Any

from vio.config.mavlink import OriginConfig
from vio.mavlink.messages import (
    ARDUPILOT,
    GPS_GLOBAL_ORIGIN_ID,
    PX4,
    REQUEST_MESSAGE,
    Outgoing,
    command,
    set_gps_global_origin,
)
from vio.mavlink.vehicle import Vehicle

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
        self._was_ready = config is None

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
        question = command(vehicle.system, REQUEST_MESSAGE, GPS_GLOBAL_ORIGIN_ID)
        if vehicle.armed:
            return [question]
        return [self._origin(vehicle.system, vehicle.autopilot, self._config), question]

    def _origin(self, system: int, autopilot: int | None, place: OriginConfig) -> Outgoing:
        """The origin as this autopilot needs it.

        PX4 takes vision's height for an altitude and has local z = -(altitude - the origin's): any
        other altitude than 0 would move its local height by that much.
        """
        alt_m = 0.0 if autopilot == PX4 else place.alt_m
        if alt_m != place.alt_m and not self._said:
            LOG.info(
                "mavlink.origin.alt_m %g is not sent to PX4, whose local height it would move",
                place.alt_m,
            )
            self._said = True
        return set_gps_global_origin(system, place.lat_deg, place.lon_deg, alt_m)

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
        if self._was_ready:  # once poses flow nothing withholds them: not a clock that steps back
            return True
        if self.confirmed or self._given_up:
            self._was_ready = True
            return True
        if self._first_ns is not None and now_ns - self._first_ns > _WAIT_NS:
            self._given_up = True
            LOG.warning("the origin is not confirmed after %.0f s: poses go out, the origin is sent"
                        " on; without one ArduPilot refuses to arm", _WAIT_NS * 1e-9)  # fmt: skip
        return self._given_up

    def restarted(self, was_silent: bool) -> None:
        """The autopilot has started again and knows no origin.

        was_silent: it has; else only a clock of it stepped back, for which no pose is withheld.
        """
        self._was_ready = self._config is None or not was_silent
        self.confirmed = self._given_up = False
        self._first_ns = self._last_ns = None
