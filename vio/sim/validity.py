"""Whether a vehicle can fly a flight over its map: clear words before an hour of rendering."""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.tags.tag_map import TagMap, tag_corners
from vio.errors import SimulationError
from vio.sim.scenario import Scenario
from vio.sim.world.dynamics import BodyFlight, BodyMotion, tilt
from vio.sim.world.flights import Plan

_EVERY_S = 0.01
_SUNK_M = 1e-3  # the course may dip this far below standing height
_FACING = 0.7  # z of most tags' faces where a map is a floor


def check_flight(
    flight: BodyFlight, flown: Plan, scenario: Scenario, tag_map: TagMap, down_W: Array
) -> tuple[str, ...]:
    """Refuse what cannot be flown; what a person should know of the rest, in words."""
    t_s = np.arange(0.0, flown.duration_s, _EVERY_S)
    motion, vehicle = flight(t_s), scenario.vehicle
    _check_floor(motion, vehicle.clearance_m, tag_map)
    _check_map(motion, np.array(vehicle.camera_p_I), tag_map, scenario.flight.margin_m)
    lean = np.degrees(tilt(motion, down_W))
    worst = int(np.argmax(lean))
    if lean[worst] > vehicle.max_tilt_deg:
        raise SimulationError(
            f"flight: {vehicle.name} would lean over by {lean[worst]:.0f} deg at"
            f" {t_s[worst]:.1f} s; vehicle.max_tilt_deg is {vehicle.max_tilt_deg:g}: fly slower"
        )
    speed = np.linalg.norm(motion.v_WI, axis=-1)
    rate = np.degrees(np.linalg.norm(motion.w_WI_I, axis=-1))
    return (
        f"{flown.duration_s:.1f} s, up to {speed.max():.2f} m/s, leaning by up to"
        f" {lean[worst]:.0f} deg and turning at up to {rate.max():.0f} deg/s",
    )


def _check_floor(motion: BodyMotion, clearance_m: float, tag_map: TagMap) -> None:
    if np.median(tag_map.R_WT[:, 2, 2]) < _FACING:
        raise SimulationError(
            f"{tag_map.source}: most of its tags do not face along the map's z; simulated flights"
            " are over a floor"
        )
    low = int(np.argmin(motion.p_WI[:, 2]))
    z = float(motion.p_WI[low, 2])
    if z < clearance_m - _SUNK_M:
        raise SimulationError(
            f"flight: it goes under the floor at {motion.t_s[low]:.1f} s (its IMU at z {z:.2f} m);"
            f" standing on the ground it is at vehicle.clearance_m, {clearance_m:g} m"
        )


def extent(tag_map: TagMap) -> tuple[Array, Array]:
    """Least and greatest x, y [m] that the tags' prints reach; (2,) each."""
    outline = geo.transform(
        tag_map.R_WT[:, None], tag_map.p_WT[:, None], tag_corners(tag_map.total_size)
    )[..., :2]
    return outline.min(axis=(0, 1)), outline.max(axis=(0, 1))


def _check_map(motion: BodyMotion, p_IC: Array, tag_map: TagMap, margin_m: float) -> None:
    low, high = extent(tag_map)
    xy = geo.transform(motion.R_WI, motion.p_WI, p_IC)[:, :2]
    out = np.maximum(low - xy, xy - high).max(axis=-1)
    beyond = np.flatnonzero(out > margin_m)
    if len(beyond):
        first = beyond[0]
        raise SimulationError(
            f"flight: it leaves the map at {motion.t_s[first]:.1f} s (the camera at x"
            f" {xy[first, 0]:.2f}, y {xy[first, 1]:.2f} m) and gets {out.max():.2f} m beyond its"
            f" tags, which lie in x {low[0]:.2f}..{high[0]:.2f}, y {low[1]:.2f}..{high[1]:.2f} m;"
            f" flight.margin_m, {margin_m:g}, may be raised"
        )
