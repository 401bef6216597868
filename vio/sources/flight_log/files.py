"""Reads the files of a flight log one by one: IMU, truth, phases, frames, detections, noise."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tagvo.errors import shown
from tagvo.geometry import Array, IntArray
from tagvo.records import Detections
from tagvo.textfile import finite_number, read_yaml
from vio.errors import LogError
from vio.records import Ground, ImuNoise, ImuTrack, Phase, Truth
from vio.sources.flight_log.columns import Layout
from vio.sources.flight_log.csv_rows import BLANK
from vio.sources.flight_log.csv_table import Table, read_table
from vio.sources.flight_log.tally import Tally

_SLOWEST_IMU_NS = 50_000_000  # 20 Hz: a hand moves at 5 Hz, a vehicle's attitude faster
_CLOCK_STEP_NS = 1_000_000_000  # no buffer holds back so much; a gap of less is one
_GYRO = ("gyro_x", "gyro_y", "gyro_z")
_ACCEL = ("accel_x", "accel_y", "accel_z")
_P, _Q = ("p_x", "p_y", "p_z"), ("q_w", "q_x", "q_y", "q_z")
_V, _BG, _BA = ("v_x", "v_y", "v_z"), ("bg_x", "bg_y", "bg_z"), ("ba_x", "ba_y", "ba_z")
_CORNERS = tuple(f"{axis}_{corner}" for corner in ("tl", "tr", "br", "bl") for axis in "uv")
_SIGMAS = tuple(f"sigma_{corner}" for corner in ("tl", "tr", "br", "bl"))

IMU = Layout(
    "imu",
    "timestamp [ns], gyro x y z [rad/s], specific force x y z [m/s^2] [, arrival_ns]",
    ("t_ns", *_GYRO, *_ACCEL),
    ("t_ns",),
    _GYRO + _ACCEL,
    more_ints=("arrival_ns", "mean"),
)
TRUTH = Layout(
    "truth",
    "timestamp [ns], p x y z [m], q w x y z [, v, b_g, b_a]",
    ("t_ns", *_P, *_Q),
    ("t_ns",),
    _P + _Q,
    more_floats=(_V, _BG, _BA),
)
FRAMES = Layout(
    "frames",
    "timestamp [ns], filename [, arrival_ns]",
    ("t_ns", "filename"),
    ("t_ns",),
    texts=("filename",),
    more_ints=("arrival_ns", "received_ns"),
)
DETECTIONS = Layout(
    "detections",
    "timestamp [ns], tag_id, 8 corner coordinates [, hamming, decision_margin, arrival_ns]",
    ("t_ns", "tag_id", *_CORNERS),
    ("t_ns", "tag_id"),
    _CORNERS,
    more_ints=("hamming", "arrival_ns"),
    more_floats=(("decision_margin",), _SIGMAS),
)
GROUND = Layout("ground", "timestamp [ns], on_ground (0 or 1)", ("t_ns", "on_ground"),
                ("t_ns", "on_ground"))  # fmt: skip
PHASES = Layout(
    "phases",
    "name, t_start_ns, t_end_ns",
    ("name", "t_start_ns", "t_end_ns"),
    ("t_start_ns", "t_end_ns"),
    texts=("name",),
)
_NOISE_FIELDS = {  # Kalibr's key -> ours; the densities must be positive
    "accelerometer_noise_density": "accel_density",
    "accelerometer_random_walk": "accel_walk",
    "gyroscope_noise_density": "gyro_density",
    "gyroscope_random_walk": "gyro_walk",
}


@dataclass(frozen=True, slots=True, eq=False)
class FrameList:
    """The rows of a cam0/data.csv: t_ns (n,), arrival_ns (n,), name of the image file (n).

    received_ns (n,): when the image came from the camera, None where the file does not say.
    """

    t_ns: IntArray
    arrival_ns: IntArray
    filename: list[str]
    received_ns: IntArray | None = None

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True, eq=False)
class DetectionTable:
    """The rows of a detections.csv: t_ns (n,), arrival_ns (n,) and the tags, in one record."""

    t_ns: IntArray
    arrival_ns: IntArray | None
    tags: Detections

    def __len__(self) -> int:
        return len(self.t_ns)


def read_imu(path: Path, tally: Tally) -> ImuTrack:
    """IMU track of a CSV file; repeated stamps are dropped and counted, backward ones counted."""
    table = read_table(path, IMU, tally)
    rows = _first_of_each(table, path, "imu", tally)
    t_ns = _taken(table.ints["t_ns"], rows)
    steps = np.diff(t_ns)
    _doubt_clock(path, steps, tally)
    del steps  # 10^7 rows are read within 1 GB
    mean = _taken(table.ints["mean"], rows) == 1 if "mean" in table.ints else None
    arrival = _taken(_arrival(table), rows) if "arrival_ns" in table.ints else t_ns
    gyro, accel = (_taken(table.stack(names), rows) for names in (_GYRO, _ACCEL))
    return ImuTrack(t_ns, gyro, accel, arrival, mean)


def _taken(column: np.ndarray, rows: IntArray) -> np.ndarray:
    """These of the column's rows, ascending; the column itself where they are all."""
    return column if len(rows) == len(column) else column[rows]


def _doubt_clock(path: Path, steps: IntArray, tally: Tally) -> None:
    """Count gaps; note an IMU that is too slow to integrate, and a clock that steps."""
    forward = steps[steps > 0]
    if not len(forward):
        return
    usual_ns = float(np.median(forward, overwrite_input=True))
    gaps = int(np.sum(forward > 5 * usual_ns))
    del forward
    tally.count("imu_gap", f"{path}: a step of more than five times the usual", gaps)
    if usual_ns > _SLOWEST_IMU_NS:
        tally.note(f"{path}: the IMU comes at {1e9 / usual_ns:.3g} Hz; 100 Hz and more are needed"
                   f" (below {1e9 / _SLOWEST_IMU_NS:g} Hz nothing can be integrated)")  # fmt: skip
    stepped = np.abs(steps[np.abs(steps) > _CLOCK_STEP_NS])
    if len(stepped):
        tally.note(f"{path}: the IMU's clock steps {len(stepped)} times, by up to"
                   f" {1e-9 * stepped.max():.3g} s; what lies between is not known")  # fmt: skip


def read_truth(path: Path, tally: Tally) -> Truth:
    """Truth of a CSV file, sorted by stamp; rows whose quaternion is not unit are skipped."""
    table = read_table(path, TRUTH, tally)
    q = table.stack(_Q)
    norm = np.linalg.norm(q, axis=-1)
    unit = np.abs(norm - 1.0) <= 1e-3
    if not unit.all():
        bad = int(np.argmin(unit))
        text = f"{path} line {table.line[bad]}: quaternion of norm {norm[bad]:.4g}, 1 is needed"
        if not unit.any():
            raise LogError(f"{text}; no row of the file has one")
        tally.count("truth_not_unit", text, int(np.sum(~unit)))
    rows = _first_of_each(table, path, "truth", tally, unit)
    rows = rows[np.argsort(table.ints["t_ns"][rows], kind="stable")]

    def group(names: tuple[str, ...]) -> Array | None:
        return table.stack(names)[rows] if names[0] in table.floats else None

    return Truth(
        table.ints["t_ns"][rows],
        table.stack(_P)[rows],
        q[rows] / norm[rows, None],
        group(_V),
        group(_BG),
        group(_BA),
    )


def read_frame_list(path: Path, tally: Tally) -> FrameList:
    """Frames of a cam0/data.csv; repeated stamps are dropped and counted."""
    table = read_table(path, FRAMES, tally)
    rows = _first_of_each(table, path, "frames", tally)
    names = [table.texts["filename"][i] for i in rows.tolist()]
    arrival, received = _arrival(table), None
    if "received_ns" in table.ints:
        said = table.ints["received_ns"]
        received = np.where(said == BLANK, arrival, said)[rows]
    return FrameList(table.ints["t_ns"][rows], arrival[rows], names, received)


def read_detections(path: Path, tally: Tally) -> DetectionTable:
    """All rows of a detections.csv, in the order of the file."""
    table = read_table(path, DETECTIONS, tally)
    hamming = table.ints.get("hamming")
    tags = Detections.of(
        table.ints["tag_id"],
        table.stack(_CORNERS).reshape(-1, 4, 2),
        None if hamming is None else np.where(hamming == BLANK, 0, hamming),
        table.floats.get("decision_margin"),
        table.stack(_SIGMAS) if _SIGMAS[0] in table.floats else None,
    )
    arrival = _arrival(table) if "arrival_ns" in table.ints else None
    return DetectionTable(table.ints["t_ns"], arrival, tags)


def read_ground(path: Path, tally: Tally) -> tuple[Ground, ...]:
    """When the vehicle was known to stand on the ground, or no longer, in the order of the file."""
    table = read_table(path, GROUND, tally)
    rows = zip(table.ints["t_ns"].tolist(), table.ints["on_ground"].tolist(), strict=True)
    return tuple(Ground(t_ns, on == 1) for t_ns, on in rows)


def read_phases(path: Path, tally: Tally) -> tuple[Phase, ...]:
    """Phases of a phases.csv, in its order; one that ends before it starts is skipped."""
    table = read_table(path, PHASES, tally)
    starts, ends = table.ints["t_start_ns"].tolist(), table.ints["t_end_ns"].tolist()
    phases = []
    for name, start, end in zip(table.texts["name"], starts, ends, strict=True):
        if end < start:
            tally.count("phases_reversed", f"{path}: phase {name!r} ends before it starts")
            continue
        phases.append(Phase(name, start, end))
    return tuple(phases)


def read_imu_noise(path: Path, name: str = "imu0") -> ImuNoise:
    """Noise densities of a Kalibr imu.yaml, flat or below the name of an IMU."""
    data = read_yaml(path, LogError)
    for key in (name, "imu0"):
        if isinstance(data.get(key), dict):
            data = data[key]
            break
    values: dict[str, float] = {}
    for key, ours in _NOISE_FIELDS.items():
        if data.get(key) is None:
            needed = ", ".join(_NOISE_FIELDS)
            raise LogError(f"{path}: `{key}` is missing; {needed} are needed")
        values[ours] = finite_number(data[key], f"{path} {key}", LogError)
        lowest = "a positive number" if key.endswith("density") else "a number of at least 0"
        if values[ours] < 0.0 or (values[ours] == 0.0 and key.endswith("density")):
            raise LogError(f"{path} {key}: {shown(data[key])}; {lowest} is needed")
    rate = data.get("update_rate")
    if rate is not None:
        rate = finite_number(rate, f"{path} update_rate", LogError)
        if rate <= 0.0:
            raise LogError(f"{path} update_rate: {shown(rate)}; a positive number of Hz is needed")
    return ImuNoise(**values, rate_hz=rate)


def _arrival(table: Table) -> IntArray:
    """When each row was known [ns]: its arrival_ns, where it has none its stamp; (n,)."""
    t_ns = table.ints["t_ns"]
    arrival = table.ints.get("arrival_ns", t_ns)
    return np.where(arrival == BLANK, t_ns, arrival)


def _first_of_each(
    table: Table, path: Path, what: str, tally: Tally, good: np.ndarray | None = None
) -> IntArray:
    """Rows without those whose stamp stood before, in the order of the file; backward counted."""
    t_ns, line = table.ints["t_ns"], table.line
    if good is None and (t_ns[1:] > t_ns[:-1]).all():  # the usual file, without sorting
        return np.arange(len(table))
    rows = np.arange(len(table)) if good is None else np.flatnonzero(good)
    _, first = np.unique(t_ns[rows], return_index=True)
    kept: IntArray = rows[np.sort(first)]
    dropped = np.setdiff1d(rows, kept)
    if len(dropped):
        text = f"{path} line {line[dropped[0]]}: stamp {t_ns[dropped[0]]} stood before, dropped"
        tally.count(f"{what}_repeated_stamp", text, len(dropped))
    backward = kept[1:][np.diff(t_ns[kept]) < 0]
    if len(backward):
        text = f"{path} line {line[backward[0]]}: stamp runs backward, kept"
        tally.count(f"{what}_backward_stamp", text, len(backward))
    return kept
