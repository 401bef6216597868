"""The flights that a scenario can name, from take-off to landing, with the paper's phases."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat, model_validator

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.tags.tag_map import TagMap
from vio.errors import SimulationError
from vio.sim.model import Model
from vio.sim.world import course as crs
from vio.sim.world.airframe import Vehicle
from vio.sim.world.course import Course, Window
from vio.sim.world.trajectory import Command, t1_command, t2_command, t3_command

Name = Literal["T1", "T2", "T3", "static", "shuttle", "waypoints"]
Waypoint = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Span: TypeAlias = tuple[str, float, float]  # name, start and end [s]
_T2_HOLD_S, _T2_STEP_S = 3.4, 4.0
_SETTLE_S = 1.0  # hover between climb and manoeuvre, and before landing
_CLIMB_S_PER_M, _LEAST_CLIMB_S = 3.5, 2.0
_LEGS = ("F", "R", "B", "L")
_STEPS = ("A1", "A2", "A3", "D1", "D2", "D3")
PLACES = {"XL": 2, "Ld": 14, "Ls1": 11, "Ls2": 18, "Lc": 16}  # tags of configs/maps/arena.yaml


class FlightConfig(Model):
    """Which flight; keys that a flight does not name have no say in it."""

    name: Name = Field(
        description="which: T1, T2 and T3 are the paper's; the others take the keys below"
    )
    speed_m_s: PositiveFloat | None = Field(
        default=None,
        description="peak speed; null: as the flight is, else flown faster or slower [m/s]",
    )
    place: str = Field(default="Lc", description="T2, static: which of the places it hovers over")
    places: dict[str, int] = Field(
        default_factory=lambda: dict(PLACES), description="T2, static: the tag of each place, by id"
    )
    heights_m: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] = Field(
        default=(0.8, 1.4, 2.0),
        description="static: heights of the camera, one after the other [m]",
    )
    hover_s: PositiveFloat = Field(default=10.0, description="static: how long at each height [s]")
    yaw_deg: FiniteFloat = Field(default=30.0, description="T2, static: heading [deg]")
    middle: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(
        default=(1.5, 2.5, 0.9), description="shuttle: x, y, z of its middle [m]"
    )
    reach_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = Field(
        default=(0.0, 1.5, 0.0), description="shuttle: x, y, z from there to either end [m]"
    )
    swings: PositiveFloat = Field(
        default=6.0, description="shuttle: how often it goes to and fro at full reach"
    )
    waypoints: tuple[Waypoint, ...] = Field(
        default=(),
        description="waypoints: rows of t [s], x, y, z [m], yaw [deg]; corners are rounded",
    )
    takeoff: bool = Field(
        default=True,
        description="from and to the ground; false: in the air from the first moment on",
    )
    still_s: NonNegativeFloat = Field(default=2.0, description="on the ground before and after [s]")
    margin_m: NonNegativeFloat = Field(
        default=0.0, description="how far beyond the outermost tags the camera may get [m]"
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> "FlightConfig":
        if self.name == "static" and self.speed_m_s is not None:
            raise ValueError("a static flight hovers: it takes no speed_m_s")
        if self.name == "shuttle" and not any(self.reach_m):
            raise ValueError("a shuttle needs a reach_m [x, y, z] other than zero")
        if self.name == "waypoints":
            times = [w[0] for w in self.waypoints]
            if len(times) < 2 or any(b <= a for a, b in pairwise(times)):
                raise ValueError("waypoints: two or more are needed, their times ascending")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A flight to be flown: its course from 0 to duration_s, what its parts are called, and
    `aloft`, 0 on the ground and 1 in flight, with its derivatives."""

    course: Course
    duration_s: float
    spans: tuple[Span, ...]
    aloft: Window


def plan(config: FlightConfig, vehicle: Vehicle, tag_map: TagMap) -> Plan:
    """The whole flight of this vehicle; SimulationError where the map lacks a place of it."""
    manoeuvre = _manoeuvre(config, vehicle, tag_map)
    if config.speed_m_s is not None and config.name != "shuttle":
        manoeuvre = _at_speed(manoeuvre, config.speed_m_s)
    if not config.takeoff:
        return manoeuvre
    start_z, end_z = manoeuvre.course(np.array([0.0, manoeuvre.duration_s]))[0, :, 2]
    climb, sink = (
        max(_CLIMB_S_PER_M * float(z - vehicle.clearance_m), _LEAST_CLIMB_S)
        for z in (start_z, end_z)
    )
    up = config.still_s
    begin = up + climb + _SETTLE_S
    down = begin + manoeuvre.duration_s + _SETTLE_S

    def aloft(t_s: Array) -> Array:
        return crs.step(t_s, up, up + climb) - crs.step(t_s, down, down + sink)

    spans = [(name, a + begin, b + begin) for name, a, b in manoeuvre.spans]
    spans = [(name, up if name == "S0" else a, b) for name, a, b in spans]  # S0 is the take-off
    ends = [("still", 0.0, up), ("takeoff", up, up + climb), ("land", down, down + sink)]
    course = crs.from_the_ground(crs.later(manoeuvre.course, begin), vehicle.clearance_m, aloft)
    return Plan(course, down + sink + config.still_s, (*ends[:2], *spans, ends[2]), aloft)


def _manoeuvre(config: FlightConfig, vehicle: Vehicle, tag_map: TagMap) -> Plan:
    """The flight between climb and landing, at rest at both ends."""
    if config.name == "shuttle":
        return _shuttle(config)
    match config.name:
        case "T1":
            command, spans = _t1()
        case "T2":
            command, spans = _t2(config, vehicle, tag_map)
        case "T3":
            command, spans = _t3()
        case "static":
            command, spans = _static(config, vehicle, tag_map)
        case "waypoints":
            command, spans = _waypoints(config)
    return Plan(crs.followed(command), float(command[0][-1]), spans, _always)


def _always(t_s: Array) -> Array:
    return np.vstack([np.ones_like(t_s), np.zeros((crs.ORDERS - 1, len(t_s)))])


def _t1() -> tuple[Command, tuple[Span, ...]]:
    command = t1_command()
    t = command[0].tolist()
    return command, tuple((n, t[2 * i + 1], t[2 * i + 2]) for i, n in enumerate(_LEGS))


def _t2(
    config: FlightConfig, vehicle: Vehicle, tag_map: TagMap
) -> tuple[Command, tuple[Span, ...]]:
    t_s, p_W, _ = t2_command(place_xy(config, vehicle, tag_map))
    starts = _T2_HOLD_S + _T2_STEP_S * np.arange(len(_STEPS))
    steps = [(n, s, s + _T2_STEP_S) for n, s in zip(_STEPS, starts.tolist(), strict=True)]
    yaw = np.full(len(t_s), np.radians(config.yaw_deg))
    return (t_s, p_W, yaw), (("S0", 0.0, _T2_HOLD_S), *steps)


def _t3() -> tuple[Command, tuple[Span, ...]]:
    command = t3_command()
    return command, (("T3", 0.0, float(command[0][-1])),)


def _static(
    config: FlightConfig, vehicle: Vehicle, tag_map: TagMap
) -> tuple[Command, tuple[Span, ...]]:
    """Hover over one place at each height; a phase named after the place at each, and one of its
    own height within, so that tables can pool the heights or tell them apart."""
    x, y = place_xy(config, vehicle, tag_map)
    now, last = 0.0, config.heights_m[0]
    t, heights, spans = [now], [last], []
    for height in config.heights_m:
        if height != last:  # at rest for a while before and after: corners are rounded
            moves = now + _SETTLE_S
            now = moves + max(3.0 * abs(height - last), 1.5)
            t += [moves, now]
            heights += [last, height]
            now += _SETTLE_S
        start, now, last = now, now + config.hover_s, height
        t.append(now)
        heights.append(height)
        spans += [(config.place, start, now), (f"{config.place}/{height:g}", start, now)]
    points = np.column_stack([np.full((len(t), 2), [x, y]), heights])
    return (np.array(t), points, np.full(len(t), np.radians(config.yaw_deg))), tuple(spans)


def _shuttle(config: FlightConfig) -> Plan:
    reach = np.array(config.reach_m)
    rate = (config.speed_m_s or 1.0) / (2.0 * np.pi * float(np.linalg.norm(reach)))
    duration = (config.swings + 3.0) / rate  # it swings up and down for a period and a half each
    x, y, z = config.middle
    course = crs.shuttle((x, y, z, np.radians(config.yaw_deg)), reach, rate, duration)
    return Plan(course, duration, (("shuttle", 1.5 / rate, duration - 1.5 / rate),), _always)


def _waypoints(config: FlightConfig) -> tuple[Command, tuple[Span, ...]]:
    """The user's own points, a second of hover before and after them."""
    rows = np.array(config.waypoints)
    t = rows[:, 0] - rows[0, 0] + _SETTLE_S
    t = np.concatenate([[0.0], t, [t[-1] + _SETTLE_S]])
    points = np.vstack([rows[:1], rows, rows[-1:]])
    span = ("flight", _SETTLE_S, float(t[-1]) - _SETTLE_S)
    return (t, points[:, 1:4], np.radians(points[:, 4])), (span,)


def _at_speed(flown: Plan, speed_m_s: float) -> Plan:
    """The same flight, its peak speed as asked for."""
    velocity = flown.course(np.arange(0.0, flown.duration_s, 1e-3))[1, :, :3]
    peak = float(np.linalg.norm(velocity, axis=-1).max())
    if peak < 1e-6:
        raise SimulationError("flight.speed_m_s: this flight goes nowhere, so it has no speed")
    factor = speed_m_s / peak
    spans = tuple((name, a / factor, b / factor) for name, a, b in flown.spans)
    course = crs.faster(flown.course, factor)
    return replace(flown, course=course, duration_s=flown.duration_s / factor, spans=spans)


def place_xy(config: FlightConfig, vehicle: Vehicle, tag_map: TagMap) -> tuple[float, float]:
    """Where I must hover for the camera to stand over the tag of the place; x, y [m] in W."""
    if config.place not in config.places:
        raise SimulationError(
            f"flight.place: unknown {config.place!r}; choose one of {', '.join(config.places)}"
        )
    row = int(tag_map.rows(np.array([config.places[config.place]]))[0])
    if row < 0:
        raise SimulationError(
            f"flight.places.{config.place}: tag {config.places[config.place]} is not on"
            f" {tag_map.source}; the id of one of its tags is needed"
        )
    turn = geo.exp(np.array([0.0, 0.0, np.radians(config.yaw_deg)]))
    x, y, _ = tag_map.p_WT[row] - turn @ np.array(vehicle.camera_p_I)
    return float(x), float(y)
