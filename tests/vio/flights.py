"""Simulated flights for the filter's tests: events in order of arrival, edits, and the errors."""

from dataclasses import dataclass, replace

import numpy as np
from study_flights import FLIGHTS, PoseNoise, simulate_poses

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.records import PoseMeasurement
from vio.config.filter import VioConfig
from vio.filter.eskf import ErrorStateFilter
from vio.records import ImuSample
from vio.sim.sensors.simple_imu import PIXHAWK, simulate_imu

_R_CI = geo.exp(np.array([np.pi, 0.0, 0.0])) @ geo.exp(np.array([0.0, 0.0, 0.3]))
CAMERA = Camera(
    "none", np.array([530.0, 530.0, 320.0, 240.0]), np.zeros(4), (640, 480),
    _R_CI, -_R_CI @ np.array([0.1, 0.0, -0.05]), 0.0,
)  # fmt: skip
CLEAN = PoseNoise(
    white=(0.01, 0.3), slow=(0.0, 0.0), outliers=0.0, dropouts=0, delay_s=(0.05, 0.05), stamp_s=0.0
)


@dataclass(slots=True)
class Flown:
    """A simulated flight: what the sensors say, in order of arrival, and what was true."""

    imu: list[ImuSample]
    poses: list[tuple[int, PoseMeasurement]]
    flight: object
    duration_s: float


def fly(
    name="T3", seed=0, noise=CLEAN, camera=CAMERA, seconds=None, R_WG=None, turn_on=(0.01, 0.1)
):
    """The flight of this name, or a pair (flight, duration), with its sensors."""
    rng = np.random.default_rng(seed)
    flight, duration = FLIGHTS[name](R_WG) if isinstance(name, str) else name
    duration = seconds or duration
    down = None if R_WG is None else -R_WG[:, 2]
    imu, _ = simulate_imu(flight, duration, PIXHAWK, rng, down_W=down, turn_on=turn_on)
    stream = simulate_poses(flight, duration, camera, noise, rng)
    arrivals = [int(t) for t in stream.arrival_ns]
    samples = [imu.sample(i) for i in range(len(imu))]
    return Flown(samples, list(zip(arrivals, stream.poses, strict=True)), flight, duration)


def events(flown):
    """IMU samples and poses in order of arrival, IMU first at equal times."""
    both = [(s.arrival_ns, 0, i, s) for i, s in enumerate(flown.imu)]
    both += [(t, 1, i, p) for i, (t, p) in enumerate(flown.poses)]
    return [e[3] for e in sorted(both, key=lambda e: e[:3])]


def feed(estimator, what):
    return estimator.imu(what) if isinstance(what, ImuSample) else estimator.pose(what)


@dataclass(slots=True)
class Track:
    """Outputs beside truth: t_s (n,), position and rotation errors (n, 3), velocity, NEES/6."""

    t_s: np.ndarray
    p: np.ndarray
    rotation: np.ndarray
    v: np.ndarray
    nees: np.ndarray
    states: list[tuple[float, str]]
    reasons: list[tuple[float, str]]
    estimator: ErrorStateFilter


def replay(flown, config=None, camera=CAMERA, every=4, tag_map=None):
    """The flight through a new filter; errors at every fourth output."""
    estimator = ErrorStateFilter(config or VioConfig(), camera, PIXHAWK, tag_map)
    out, states, reasons, count = [], [], [], 0
    for what in events(flown):
        nav = feed(estimator, what)
        if isinstance(what, ImuSample) and (count := count + 1) % every == 0:
            health = estimator.health()
            states.append((what.t_ns * 1e-9, str(health.state)))
            reasons += [(what.t_ns * 1e-9, reason) for reason in health.reasons]
            if nav is not None:
                out.append(nav)
    t = np.array([n.t_ns for n in out]) * 1e-9
    truth = flown.flight(t)
    p = np.array([n.p_WI for n in out]) - truth.p_WI
    R = np.array([n.R_WI for n in out])
    rotation = geo.log(np.swapaxes(truth.R_WI, -1, -2) @ R)
    v = np.array([n.v_WI for n in out]) - truth.v_WI
    e = np.concatenate([p, rotation], axis=-1)
    cov = np.array([n.cov[:6, :6] for n in out])
    nees = np.einsum("ni,ni->n", e, np.linalg.solve(cov, e[..., None])[..., 0]) / 6.0
    return Track(t, p, rotation, v, nees, states, reasons, estimator)


def rms(x):
    return float(np.sqrt(np.mean(np.sum(np.square(x), axis=-1))))


def states_between(track, t0, t1):
    return {s for t, s in track.states if t0 <= t < t1}


def reasons_between(track, t0, t1):
    return {s for t, s in track.reasons if t0 <= t < t1}


def without(flown, t0, t1):
    """No poses captured in [t0, t1)."""
    return replace(flown, poses=[(a, p) for a, p in flown.poses if not t0 <= p.t_ns * 1e-9 < t1])


def edit_imu(flown, change):
    """Each sample through `change`: a list of samples instead of it."""
    return replace(flown, imu=[s for old in flown.imu for s in change(old)])


def edit_poses(flown, change):
    return replace(flown, poses=[(a, change(p)) for a, p in flown.poses])
