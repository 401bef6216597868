"""The paper's flights: where they lead, what their phases are called, and what is refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from simulated import arena

from tagvo import geometry as geo
from vio.config.shipped import config_path
from vio.errors import SimulationError
from vio.sim.scenario import load_scenario
from vio.sim.validity import check_flight, extent
from vio.sim.world.airframe import Vehicle, mount
from vio.sim.world.dynamics import DOWN_W, body_flight
from vio.sim.world.flights import FlightConfig, plan
from vio.sim.world.trajectory import t3_waypoints

MAP = arena()
QR = Vehicle(name="QR", camera_p_I=(0.10, 0.0, -0.05))
HR = Vehicle(name="HR", camera_p_I=(0.25, 0.0, -0.05), clearance_m=0.25)


def flown(name, vehicle=QR, **keys):
    return plan(FlightConfig(name=name, **keys), vehicle, MAP)


def spans(of):
    return {name: (a, b) for name, a, b in of.spans}


def camera_at(of, vehicle, t):
    motion = body_flight(of.course)(np.atleast_1d(t))
    R_IC, p_IC = geo.invert(*mount(vehicle))
    return geo.compose(motion.R_WI, motion.p_WI, R_IC, p_IC)


def test_t1_is_a_square_of_the_named_legs():
    of = flown("T1")
    ways = {"F": (0, -1), "R": (-1, 0), "B": (0, 1), "L": (1, 0)}
    assert list(spans(of)) == ["still", "takeoff", "F", "R", "B", "L", "land"]
    for name, way in ways.items():
        a, b = spans(of)[name]
        points = of.course(np.array([a - 1.0, b + 1.0, 0.5 * (a + b)]))
        assert_allclose(points[0, 1, :2] - points[0, 0, :2], 1.8 * np.array(way), atol=2e-3)
        assert_allclose(points[1, 2, :2], 0.5 * np.array(way), atol=1e-6)
        assert_allclose(points[0, :, 2], 0.8, atol=1e-9)
    assert_allclose(of.course(np.array([5.0]))[0, 0, 3], np.radians(30.0))


@pytest.mark.parametrize("vehicle", [QR, HR])
def test_t2_steps_above_the_tag_lc(vehicle):
    of, tag = flown("T2", vehicle), MAP.p_WT[MAP.rows(np.array([16]))[0]]
    names = ["S0", "A1", "A2", "A3", "D1", "D2", "D3"]
    heights = [0.7, 1.0, 1.3, 1.6, 1.3, 1.0, 0.7]
    assert list(spans(of)) == ["still", "takeoff", *names, "land"]
    for name, height in zip(names, heights, strict=True):
        _, end = spans(of)[name]
        R_WC, p_WC = camera_at(of, vehicle, end - 0.8)
        assert_allclose(p_WC[0, :2], tag[:2], atol=1e-4)
        assert_allclose(p_WC[0, 2], height - 0.05, atol=2e-3)
        assert_allclose(R_WC[0, :, 2], [0.0, 0.0, -1.0], atol=1e-3)
    assert spans(of)["S0"][0] == spans(of)["takeoff"][0] == 2.0


def test_places_are_over_the_sizes_of_their_names():
    """XL over the largest tag, four over an L; no two see the same surroundings."""
    config, around = FlightConfig(name="static"), set()
    for place, tag_id in config.places.items():
        row = MAP.rows(np.array([tag_id]))[0]
        assert MAP.size[row] == pytest.approx(0.46 if place == "XL" else 0.23)
        of = flown("static", HR, place=place)
        _, p_WC = camera_at(of, HR, np.array([a + 5.0 for n, a, _ in of.spans if n == place]))
        assert_allclose(p_WC[:, :2], MAP.p_WT[[row] * 3, :2], atol=1e-9)
        assert_allclose(p_WC[:, 2] + 0.05, [0.8, 1.4, 2.0], atol=1e-9)
        seen = MAP.p_WT[:, :2] - MAP.p_WT[row, :2]
        near = (np.abs(seen) < 0.45).all(axis=1)
        relative = np.round(np.column_stack([seen, MAP.size])[near], 3)
        around.add(json.dumps(sorted(relative.tolist())))
    assert len(around) == len(config.places) == 5


def test_static_phases_pool_the_heights_and_tell_them_apart():
    of = flown("static", HR, place="XL", heights_m=(0.8, 1.4), hover_s=7.0)
    names = [name for name, _, _ in of.spans]
    assert names == ["still", "takeoff", "XL", "XL/0.8", "XL", "XL/1.4", "land"]
    for name, a, b in of.spans:
        if name.startswith("XL"):
            assert b - a == pytest.approx(7.0)
            speed = np.abs(of.course(np.linspace(a, b, 50))[1]).max()
            assert speed < 0.02, name


def test_t3_and_the_map_under_it():
    of = flown("T3")
    assert 35.0 < np.diff(spans(of)["T3"])[0] < 45.0
    low, high = extent(MAP)
    for vehicle in (QR, HR):
        _, p_WC = camera_at(of, vehicle, np.linspace(0.0, of.duration_s, 400))
        assert (p_WC[:, :2] > low).all()
        assert (p_WC[:, :2] < high).all()


def test_it_takes_off_from_the_ground_and_lands_there():
    for name in ("T1", "T2", "T3", "static", "shuttle"):
        of = flown(name, HR)
        ends = of.course(np.array([0.0, 1.9, of.duration_s - 1.9, of.duration_s]))
        assert_allclose(ends[0, :, 2], HR.clearance_m, atol=1e-9)
        assert_allclose(ends[1:], 0.0, atol=1e-6)
        up = of.aloft(np.linspace(0.0, of.duration_s, 500))[0]
        assert (up.min(), up.max()) == (0.0, 1.0)
        z = of.course(np.linspace(0.0, of.duration_s, 2000))[0, :, 2]
        assert z.min() > HR.clearance_m - 1e-9


def test_without_take_off_it_hovers_from_the_first_moment():
    of = flown("T1", takeoff=False)
    assert of.duration_s == pytest.approx(24.4)
    assert list(spans(of)) == ["F", "R", "B", "L"]
    assert_allclose(of.course(np.zeros(1))[0, 0, :3], [2.4, 3.4, 0.8], atol=1e-9)
    assert_allclose(of.aloft(np.array([0.0, 10.0]))[0], 1.0)


@pytest.mark.parametrize("name", ["T1", "T3", "shuttle"])
def test_a_flight_at_another_speed_takes_another_time(name):
    slow, fast = flown(name, speed_m_s=0.5), flown(name, speed_m_s=1.0)
    phase = {"shuttle": "shuttle", "T1": "F", "T3": "T3"}[name]
    assert np.diff(spans(slow)[phase]) == pytest.approx(2.0 * np.diff(spans(fast)[phase]), rel=1e-3)
    a, b = spans(fast)[phase]
    v = fast.course(np.linspace(a, b, 4000))[1, :, :3]
    assert np.linalg.norm(v, axis=1).max() == pytest.approx(1.0, rel=0.03)


def test_waypoints_are_flown_at_their_times():
    points = [(3.0, 1.0, 1.0, 1.0, 0.0), (7.0, 2.0, 3.0, 1.5, 90.0), (9.0, 2.0, 3.0, 1.5, 90.0)]
    of = flown("waypoints", waypoints=points)
    a, b = spans(of)["flight"]
    assert b - a == pytest.approx(6.0)
    course = of.course(np.array([a - 0.9, b + 0.9]))[0]
    assert_allclose(course, [[1, 1, 1, 0], [2, 3, 1.5, np.pi / 2]], atol=1e-3)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"name": "T4"}, "Input should be 'T1'"),
        ({"name": "static", "speed_m_s": 1.0}, "takes no speed_m_s"),
        ({"name": "waypoints"}, "two or more"),
        ({"name": "waypoints", "waypoints": [[1, 0, 0, 1, 0], [1, 1, 1, 1, 0]]}, "ascending"),
        ({"name": "shuttle", "reach_m": [0, 0, 0]}, "other than zero"),
        ({"name": "static", "heights_m": []}, "at least 1 item"),
        ({"name": "T1", "height": 2.0}, "Extra inputs"),
    ],
)
def test_impossible_flights_are_refused(keys, says):
    with pytest.raises(ValueError, match=says):
        FlightConfig(**keys)


def test_places_must_be_there():
    with pytest.raises(SimulationError, match="unknown 'XXL'; choose one of XL, Ld"):
        flown("static", place="XXL")
    with pytest.raises(SimulationError, match=r"tag 999 is not on .*arena\.yaml"):
        flown("static", places={"Lc": 999})
    still = [(0.0, 1.0, 1.0, 1.0, 0.0), (5.0, 1.0, 1.0, 1.0, 0.0)]
    with pytest.raises(SimulationError, match="goes nowhere"):
        flown("waypoints", waypoints=still, speed_m_s=1.0)


def waypoints(*xyz, vehicle="qr", **keys):
    """A scenario through these points, six seconds apart."""
    points = [[6.0 * i, *p, 0.0] for i, p in enumerate(xyz)]
    sets = [f"{k}={json.dumps(v)}" for k, v in keys.items()]
    name = ["flight.name=waypoints", f"flight.waypoints={json.dumps(points)}"]
    return load_scenario("t1_qr", [f"vehicle={vehicle}", *name, *sets])


def checked(scenario):
    of = plan(scenario.flight, scenario.vehicle, MAP)
    return check_flight(body_flight(of.course), of, scenario, MAP, DOWN_W)


@pytest.mark.parametrize(
    ("points", "says"),
    [
        ([(1.5, 2.5, 1.0), (4.0, 2.5, 1.0)], r"leaves the map at \d+\.\d s \(the camera at x"),
        ([(1.5, 2.5, 1.0), (1.5, 2.5, 0.02)], "goes under the floor at"),
        ([(1.5, 2.5, 1.0), (1.5, 2.5, -2.0)], "goes under the floor at"),
        ([(0.3, 0.3, 1.0), (0.3, -0.3, 1.0)], "beyond its tags, which lie in x 0.05..2.95"),
    ],
)
def test_what_leaves_the_map_or_the_room_above_it_is_refused(points, says):
    with pytest.raises(SimulationError, match=says):
        checked(waypoints(*points))


def test_a_margin_lets_a_flight_stray():
    points = [(1.5, 2.5, 1.0), (3.1, 2.5, 1.0)]
    with pytest.raises(SimulationError, match=r"gets 0\.25 m beyond"):
        checked(waypoints(*points))
    words = checked(waypoints(*points, **{"flight.margin_m": 0.3}))
    assert "up to" in words[0]


def test_what_no_rotor_can_do_is_refused():
    fast = load_scenario("t3_qr", ["flight.speed_m_s=4"])
    with pytest.raises(SimulationError, match=r"QR would lean over by \d+ deg at .*60: fly slower"):
        checked(fast)


def test_walls_are_refused():
    turned = replace(MAP, R_WT=geo.exp(np.array([np.pi / 2, 0.0, 0.0])) @ MAP.R_WT)
    scenario = waypoints((1.5, 2.5, 1.0), (1.5, 2.6, 1.0))
    of = plan(scenario.flight, scenario.vehicle, MAP)
    with pytest.raises(SimulationError, match="do not face along the map's z"):
        check_flight(body_flight(of.course), of, scenario, turned, DOWN_W)


def test_the_shuttle_swings_about_its_middle():
    of = flown("shuttle", speed_m_s=2.0, reach_m=(0.0, 1.0, 0.0), middle=(1.0, 2.0, 0.7))
    a, b = spans(of)["shuttle"]
    x = of.course(np.linspace(a, b, 4000))
    assert_allclose([x[0, :, 1].min(), x[0, :, 1].max()], [1.0, 3.0], atol=1e-3)
    assert_allclose(x[0, :, [0, 2]], [[1.0] * 4000, [0.7] * 4000], atol=1e-12)


def test_the_published_waypoints_of_t3_are_those_that_are_flown():
    """The scenario's comment holds them; the spline passes near each, its corners rounded."""
    text = config_path("scenarios/t3_qr.yaml").read_text()
    lines = [line[1:] for line in text.splitlines() if line.startswith("#") and "|" in line]
    published = np.array([part.split() for line in lines for part in line.split("|")], dtype=float)
    drawn = t3_waypoints()
    assert_allclose(published[:, :3], drawn[:, :3], atol=0.0051)
    assert_allclose(published[:, 3], np.degrees(drawn[:, 3]), atol=0.51)
    of = flown("T3")
    a, b = spans(of)["T3"]
    course = of.course(np.linspace(a, b, 8000))[0]
    away = np.linalg.norm(course[:, None, :3] - drawn[None, :, :3], axis=-1).min(axis=0)
    assert away.max() < 0.15
