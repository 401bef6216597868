"""A recorded flight with a camera that it never had: rendered along its truth, with its own IMU."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.render.shutter import PoseAt
from vio.errors import LogError, SimulationError
from vio.records import Truth
from vio.sim.recording import Recording, map_of, rig_of, said_of, scene_of, stream_of
from vio.sim.scenario import Scenario
from vio.sim.sensors.camera_stream import Exposures, exposures
from vio.sim.sensors.clocks import Clock
from vio.sim.validity import extent
from vio.sim.world.truth_spline import TruthSpline, left_out, spline_of, velocity_misfit
from vio.sources.flight_log.arrivals import read_imu_of
from vio.sources.flight_log.files import read_imu_noise, read_phases, read_truth
from vio.sources.flight_log.tally import Tally

_TRUTH = "mav0/state_groundtruth_estimate0/data.csv"
_LEAST_HEIGHT_M = 0.03  # of the camera over the floor, after the flight is lifted if need be
_GAP_NS = 100_000_000  # no frames between truth rows further apart
_UPRIGHT = 0.7  # median z of I's z axis in W
_HALF = 0.5  # of the flight must be over the map
_LEFT_OUT_M, _MISFIT_M_S = 0.02, 0.3
_TOUCHING_M = 1e-6
_YAWS = np.radians(np.arange(0.0, 360.0, 15.0))


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """How a flight is brought over a map: turned by R (3, 3) about z, then shifted by p (3,)."""

    R: Array
    p: Array
    yaw_deg: float


def followed(scenario: Scenario, log: Path, imu_name: str) -> Recording:
    """The recording of a log's IMU and truth with the scenario's camera, map and frames.

    LogError where the log lacks a part, SimulationError where its truth cannot be followed.
    """
    tally = Tally()
    imu = read_imu_of(log, imu_name, tally)
    truth = _truth(log, tally)
    tag_map, camera = map_of(scenario), rig_of(scenario)
    move, words = placed(truth, camera, *extent(tag_map))
    truth = moved(truth, move)
    spline = spline_of(truth)
    frames, gaps = _frames(scenario, truth)
    noise = log / "imu.yaml"
    phases = log / "phases.csv"
    notes = [*tally.warnings, _check(truth, spline), words, gaps]
    return Recording(
        tag_map,
        said_of(scenario, camera),
        camera,
        scene_of(scenario, tag_map),
        read_imu_noise(noise, imu_name) if noise.exists() else None,
        imu,
        truth,
        read_phases(phases, tally) if phases.exists() else (),
        frames,
        _camera_at(spline, camera),
        tuple(note for note in notes if note),
    )


def _truth(log: Path, tally: Tally) -> Truth:
    path = log / _TRUTH
    if not path.exists():
        raise LogError(f"{log}: no truth to fly along; {_TRUTH} is needed")
    truth = read_truth(path, tally)
    if len(truth) < 8:
        raise LogError(f"{path}: {len(truth)} rows; a flight needs more")
    upright = float(np.median(geo.matrix_from_quat(truth.q_WI)[:, 2, 2]))
    if upright < _UPRIGHT:
        raise SimulationError(
            f"{path}: the IMU's z is not up (its median share of W's z is {upright:.2f}); the"
            " vehicles' cameras look down along -z of an IMU with x forward, y left, z up"
        )
    return truth


def placed(truth: Truth, camera: Camera, low: Array, high: Array) -> tuple[Move, str]:
    """The least move that brings the camera over the map's extent low..high (2,), and in words."""
    R_WI = geo.matrix_from_quat(truth.q_WI)
    p_WC = geo.transform(R_WI, truth.p_WI, geo.invert(camera.R_CI, camera.p_CI)[1])
    best, over = None, -1.0
    for yaw in _YAWS:
        turn = geo.exp(np.array([0.0, 0.0, yaw]))
        at = p_WC @ turn.T
        shift = _least_shift(at[:, :2], low, high)
        there = at[:, :2] + shift
        inside = ((there >= low - _TOUCHING_M) & (there <= high + _TOUCHING_M)).all(axis=1)
        if inside.mean() > over + 1e-9:
            lift = max(0.0, _LEAST_HEIGHT_M - float(at[:, 2].min()))
            best, over = Move(turn, np.array([*shift, lift]), float(np.degrees(yaw))), inside.mean()
    assert best is not None
    if over < _HALF:
        size = np.ptp(p_WC[:, :2], axis=0)
        raise SimulationError(
            f"the flight is {size[0]:.1f} x {size[1]:.1f} m wide, the map"
            f" {high[0] - low[0]:.1f} x {high[1] - low[1]:.1f} m: at best {100 * over:.0f} % of it"
            " would be over the map"
        )
    return best, _told(best, over)


def _least_shift(xy: Array, low: Array, high: Array) -> Array:
    """Shift (2,) [m] that brings points into a box, as small as can be; centred where too wide."""
    first, last = xy.min(axis=0), xy.max(axis=0)
    fits = last - first <= high - low
    need = np.maximum(low - first, 0.0) + np.minimum(high - last, 0.0)
    return np.asarray(np.where(fits, need, 0.5 * (low + high - first - last)))


def _told(move: Move, over: float) -> str:
    parts = []
    if move.yaw_deg or (np.abs(move.p) > _TOUCHING_M).any():
        x, y, z = move.p
        parts.append(
            f"the flight (and its truth) is turned by {move.yaw_deg:g} deg about z and shifted by"
            f" {x:.3f}, {y:.3f}, {z:.3f} m to be over the map"
        )
    if over < 1.0:
        parts.append(f"the camera is beside the map for {100 * (1 - over):.1f} % of it")
    return "; ".join(parts)


def moved(truth: Truth, move: Move) -> Truth:
    """The truth after a move; biases, being in I, stay."""
    R_WI, p_WI = geo.compose(
        move.R, move.p, geo.matrix_from_quat(truth.q_WI), truth.p_WI
    )  # fmt: skip
    v_WI = None if truth.v_WI is None else truth.v_WI @ move.R.T
    return replace(truth, p_WI=p_WI, q_WI=geo.quat_from_matrix(R_WI), v_WI=v_WI)


def _check(truth: Truth, spline: TruthSpline) -> str:
    """Refuse a truth that a spline cannot follow; how well it does, in words."""
    p_m, angle = left_out(truth)
    words = (
        f"truth: {len(truth)} rows; a spline through every other one meets the rest to"
        f" {1e3 * np.median(p_m):.2f} mm and {np.degrees(np.median(angle)):.3f} deg (median),"
        f" {1e3 * p_m.max():.1f} mm and {np.degrees(angle.max()):.2f} deg at worst"
    )
    if float(np.percentile(p_m, 95)) > _LEFT_OUT_M:
        raise SimulationError(f"{words}: too sparse or too noisy to render along")
    misfit = velocity_misfit(truth, spline)
    if misfit is None:
        return words
    if misfit > _MISFIT_M_S:
        raise SimulationError(
            f"truth: its velocities and positions disagree by {misfit:.2f} m/s (median)"
        )
    return f"{words}; its slope meets the truth's velocity to {1e3 * misfit:.1f} mm/s (median)"


def _frames(scenario: Scenario, truth: Truth) -> tuple[Exposures, str]:
    """Exposures in the part that is asked for, without those in gaps of the truth."""
    t0, span = int(truth.t_ns[0]), float(truth.t_ns[-1] - truth.t_ns[0]) * 1e-9
    start = scenario.along.start_s
    end = span if scenario.along.end_s is None else min(scenario.along.end_s, span)
    if start >= end:
        raise SimulationError(
            f"along.start_s {start:g} and end_s {end:g}: the truth lasts {span:.1f} s"
        )
    rng = stream_of(scenario, "stream")
    half = 0.5 * (scenario.lens.exposure_s + scenario.lens.readout_s) + 1e-3
    frames = exposures(scenario.stream, (start, end - half), Clock(t0), rng)
    known = _known(truth.t_ns - t0, np.rint(frames.t_s * 1e9).astype(np.int64))
    lost = int(np.sum(~known))
    words = f"{lost} frames left out in gaps of the truth" if lost else ""
    return Exposures(frames.t_s[known], frames.t_ns[known], frames.arrival_ns[known]), words


def _known(rows_ns: IntArray, t_ns: IntArray) -> BoolArray:
    """Which times (m,) lie between rows (n,) that are near enough to each other; (m,)."""
    right = np.clip(np.searchsorted(rows_ns, t_ns, side="right"), 1, len(rows_ns) - 1)
    return np.asarray(rows_ns[right] - rows_ns[right - 1] <= _GAP_NS)


def _camera_at(spline: TruthSpline, camera: Camera) -> PoseAt:
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)

    def at(t_s: Array) -> tuple[Array, Array]:
        return geo.compose(*spline.pose(t_s), R_IC, p_IC)

    return at
