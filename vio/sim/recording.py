"""All that one simulated flight puts into its log, before any image is drawn."""

import zlib
from dataclasses import dataclass, replace

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.calibration import load_camera
from tagvo.camera.model import Camera
from tagvo.geometry import Array, IntArray
from tagvo.render.scene import Scene, SceneConfig, make_scene
from tagvo.render.shutter import PoseAt
from tagvo.tags.tag_map import TagMap, load_map
from vio.records import ImuNoise, ImuTrack, Phase, Truth
from vio.sim.scenario import Scenario, asset
from vio.sim.sensors.camera_stream import Exposures, exposures, said_camera
from vio.sim.sensors.clocks import Clock
from vio.sim.sensors.imu_model import Shaking, sampled, stated
from vio.sim.validity import check_flight
from vio.sim.world.airframe import Vibration, hum, mount, vibration
from vio.sim.world.course import Window, band_limited, shaken
from vio.sim.world.dynamics import DOWN_W, BodyFlight, body_flight
from vio.sim.world.flights import Plan, plan

START_NS = 1_700_000_000_000_000_000  # what the IMU's clock shows when a simulated flight begins


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """What the sensors of a flight say, and what was true.

    tag_map, camera: as the log has them; true_camera: the rig as it is; scene: the world as it is;
    noise: None where nothing is known of the IMU; truth in the IMU's clock; pose_at: the true
    camera at true times; notes: what a person should know.
    """

    tag_map: TagMap
    camera: Camera
    true_camera: Camera
    scene: Scene
    noise: ImuNoise | None
    imu: ImuTrack
    truth: Truth
    phases: tuple[Phase, ...]
    frames: Exposures
    pose_at: PoseAt
    notes: tuple[str, ...] = ()


def stream_of(scenario: Scenario, *names: str | int) -> np.random.Generator:
    """Random numbers of one part of a scenario, which no other part's settings can disturb."""
    keys = [n if isinstance(n, int) else zlib.crc32(n.encode()) for n in names]
    return np.random.default_rng([scenario.seed, *keys])


@dataclass(frozen=True, slots=True, eq=False)
class Flown:
    """A vehicle's flight that can be flown: its motion, its plan, gravity in W (3,), in words."""

    motion: BodyFlight
    plan: Plan
    down_W: Array
    notes: tuple[str, ...]


def flown_of(scenario: Scenario, tag_map: TagMap) -> Flown:
    """The flight of a scenario; SimulationError where it cannot be flown over its map."""
    planned, down_W = plan(scenario.flight, scenario.vehicle, tag_map), _gravity(scenario)
    motion = _motion(scenario, planned, down_W)
    return Flown(motion, planned, down_W, check_flight(motion, planned, scenario, tag_map, down_W))


def simulated(scenario: Scenario) -> Recording:
    """What all sensors say of the flight of a scenario; SimulationError where it cannot be."""
    tag_map, true_camera = map_of(scenario), rig_of(scenario)
    flown = flown_of(scenario, tag_map)
    duration, aloft = flown.plan.duration_s, flown.plan.aloft
    waves = vibration(scenario.vehicle.rotors, stream_of(scenario, "vibration"))
    clock = Clock(START_NS, scenario.imu.drift_ppm * 1e-6)
    imu, biases = sampled(
        flown.motion, duration, scenario.imu, clock, stream_of(scenario, "imu"),
        down_W=flown.down_W, shaking=_shaking(waves, aloft),
    )  # fmt: skip
    t_s = np.arange(int(duration * scenario.truth_hz) + 1) / scenario.truth_hz
    motion = flown.motion(t_s)
    truth_ns = clock.shows(t_s)
    truth = Truth(
        truth_ns, motion.p_WI, geo.quat_from_matrix(motion.R_WI), motion.v_WI,
        _at(truth_ns, imu, biases.gyro), _at(truth_ns, imu, biases.accel),
    )  # fmt: skip
    spans = [(name, *clock.shows(np.array([a, b])).tolist()) for name, a, b in flown.plan.spans]
    return Recording(
        tag_map,
        said_of(scenario, true_camera),
        true_camera,
        scene_of(scenario, tag_map),
        stated(scenario.imu),
        imu,
        truth,
        tuple(Phase(*span) for span in spans),
        exposures(scenario.stream, (0.0, duration), clock, stream_of(scenario, "stream")),
        _camera_at(flown.motion, true_camera, waves, aloft),
        flown.notes,
    )


def _at(t_ns: IntArray, imu: ImuTrack, values: Array) -> Array:
    """Values (n, 3) of the samples, interpolated at stamps (m,); (m, 3)."""
    order = np.argsort(imu.t_ns, kind="stable")
    stamps = imu.t_ns[order] - imu.t_ns[0]
    return np.stack([np.interp(t_ns - imu.t_ns[0], stamps, x) for x in values[order].T], axis=-1)


def map_of(scenario: Scenario) -> TagMap:
    """The map that lies on the floor and in the log."""
    tag_map = load_map(asset(scenario.map.file, "map.file"))
    if scenario.map.every == 1:
        return tag_map
    return tag_map.only(np.sort(tag_map.tag_id)[:: scenario.map.every])


def rig_of(scenario: Scenario) -> Camera:
    """The camera as it really is, where the vehicle carries it."""
    camera = load_camera(asset(scenario.camera, "camera"))
    R_CI, p_CI = mount(scenario.vehicle)
    return replace(camera, R_CI=R_CI, p_CI=p_CI, timeshift_s=scenario.stream.timeshift_s)


def said_of(scenario: Scenario, true: Camera) -> Camera:
    """The camera as the log's camchain has it."""
    rng = stream_of(scenario, "calibration")
    return said_camera(true, scenario.stream, scenario.calibration, rng)


def scene_of(scenario: Scenario, tag_map: TagMap) -> Scene:
    """The world as it is; a shadow that nothing is said of is the vehicle's own."""
    return make_scene(tag_map, _own_shadow(scenario), stream_of(scenario, "scene"))


def _own_shadow(scenario: Scenario) -> SceneConfig:
    vehicle, shadow = scenario.vehicle, scenario.scene.shadow
    own = {
        "vehicle_m": vehicle.size_m,
        "rotors": min(vehicle.rotors.count, 12),
        "centre_C_m": tuple(mount(vehicle)[1].tolist()),
    }
    unsaid = {key: value for key, value in own.items() if key not in shadow.model_fields_set}
    return scenario.scene.model_copy(update={"shadow": shadow.model_copy(update=unsaid)})


def _gravity(scenario: Scenario) -> Array:
    """Unit vector of gravity in W, off the map's -z by the angle asked for."""
    side = stream_of(scenario, "gravity").uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(side), np.sin(side), 0.0])
    return np.asarray(geo.exp(np.radians(scenario.gravity_off_deg) * axis) @ DOWN_W)


def _motion(scenario: Scenario, planned: Plan, down_W: Array) -> BodyFlight:
    """The vehicle along its course, straying and swaying as it does."""
    vehicle, rng = scenario.vehicle, stream_of(scenario, "shake")
    shake = vehicle.shake
    stray = band_limited(shake.position_m, shake.position_hz, 3, rng)
    sway = band_limited(np.radians(shake.attitude_deg), shake.attitude_hz, 3, rng)
    return body_flight(
        shaken(planned.course, stray, planned.aloft), down_W=down_W, drag_per_s=vehicle.drag_per_s,
        sway=sway, window=planned.aloft,
    )  # fmt: skip


def _shaking(waves: Vibration, aloft: Window) -> Shaking:
    """Vibration of gyro and accelerometer; the rotors stand while the vehicle does."""

    def at(t_s: Array) -> tuple[Array, Array]:
        gyro, accel, _ = hum(waves, t_s)
        on = aloft(t_s)[0][:, None]
        return on * gyro, on * accel

    return at


def _camera_at(flight: BodyFlight, camera: Camera, waves: Vibration, aloft: Window) -> PoseAt:
    """The true camera, shaken by the rotors like all that is bolted to the vehicle."""
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)

    def at(t_s: Array) -> tuple[Array, Array]:
        motion = flight(t_s)
        _, _, turn = hum(waves, t_s)
        R_WI = motion.R_WI @ geo.exp(aloft(t_s)[0][:, None] * turn)
        return geo.compose(R_WI, motion.p_WI, R_IC, p_IC)

    return at
