"""ArduPilot's DataFlash log (.bin): raw IMUs, and a simulator's truth."""

from pathlib import Path

import numpy as np

from tagvo.geometry import Array, IntArray
from vio.convert.attitude import between
from vio.convert.dataflash_file import Row, messages
from vio.convert.records import Foreign
from vio.errors import LogError
from vio.frames import FLIP, enu_of_ned, flu_in_enu
from vio.records import ImuTrack, Truth
from vio.sources.flight_log.tally import Tally

_FIELDS = {
    "GYR": ("SampleUS", "I", "GyrX", "GyrY", "GyrZ"),
    "ACC": ("SampleUS", "I", "AccX", "AccY", "AccZ"),
    "IMU": ("TimeUS", "I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "SIM2": ("TimeUS", "PN", "PE", "PD", "VN", "VE", "VD"),
    "SIM": ("TimeUS", "Q1", "Q2", "Q3", "Q4"),
}
_NUMBERED = ("GYR", "ACC", "IMU")
_WANTED = {*_FIELDS, *(f"{name}{i}" for name in _NUMBERED for i in range(1, 4))}
_UNIT = 1e-2  # how far from 1 the norm of a logged quaternion may be
_LARGEST = 2.0**52  # [us] 140 years; below, a float holds every microsecond
_FILTERED = (
    "no GYR and ACC messages (INS_RAW_LOG_OPT or LOG_BITMASK's fast IMU), so IMU was taken:"
    " low-passed, and stamped when it was logged, some ms late"
)


def read_dataflash(path: Path, tally: Tally) -> Foreign:
    """IMUs in FLU at their sample times, truth of SIM and SIM2 where a simulator flew.

    Stamps are the autopilot's time since boot; W is east, north, up at the simulator's origin.
    LogError where the file is none or has no IMU.
    """
    rows = _columns(path, tally)
    notes = []
    imus = _raw_imus(rows.get("GYR"), rows.get("ACC"), path, tally)
    if not imus:
        imus = _logged_imus(rows.get("IMU"))
        notes = [f"{path}: {_FILTERED}"]
    if not imus:
        raise LogError(f"{path}: no IMU in it; GYR and ACC, or IMU messages are needed")
    truth = _truth(rows, imus["imu0"] if "imu0" in imus else next(iter(imus.values())))
    if truth is None:
        notes.append(f"{path}: no truth in it (SIM and SIM2 are a simulator's)")
    return Foreign(imus, truth=truth, notes=tuple(notes))


def _columns(path: Path, tally: Tally) -> dict[str, Array]:
    """Rows of each message type that we take, as written; (n, fields)."""
    out: dict[str, list[tuple[float, ...]]] = {name: [] for name in _FIELDS}
    for name, row in messages(path, _WANTED, tally):
        kind, numbered = _kind_of(name)
        try:
            out[kind].append(tuple(_value(row, key, numbered) for key in _FIELDS[kind]))
        except (KeyError, ValueError):
            tally.count("dataflash_fields", f"{path}: a {kind} without {', '.join(_FIELDS[kind])}")
    return {name: np.array(rows, dtype=float) for name, rows in out.items() if rows}


def _kind_of(name: str) -> tuple[str, int]:
    """GYR and 1 of GYR2: before ArduPilot 4.1 each instance had a message of its own."""
    stem = name.rstrip("0123456789")
    if stem not in _NUMBERED or stem == name:
        return name, 0
    return stem, max(0, int(name[len(stem) :]) - 1)


def _value(row: Row, key: str, numbered: int) -> float:
    """A field; I, the instance, is in the message's name where no field is."""
    number = row.get(key, float(numbered)) if key == "I" else row[key]
    if not abs(number) < _LARGEST:
        raise ValueError(f"{key} is {number}")
    return number


def _raw_imus(
    gyr: Array | None, acc: Array | None, path: Path, tally: Tally
) -> dict[str, ImuTrack]:
    """Gyro and accelerometer of each instance, paired by their sample time."""
    out: dict[str, ImuTrack] = {}
    if gyr is None or acc is None:
        return out
    for instance in np.unique(gyr[:, 1]).astype(int).tolist():
        gyro, accel = (rows[rows[:, 1] == instance] for rows in (gyr, acc))
        _, i, j = np.intersect1d(gyro[:, 0], accel[:, 0], return_indices=True)
        single = len(gyro) + len(accel) - 2 * len(i)
        tally.count("imu_unpaired", f"{path}: a GYR or an ACC alone at its sample time", single)
        if len(i):
            out[f"imu{instance}"] = _track(gyro[i, 0], gyro[i, 2:5], accel[j, 2:5])
    return out


def _logged_imus(rows: Array | None) -> dict[str, ImuTrack]:
    if rows is None:
        return {}
    of = {int(i): rows[rows[:, 1] == i] for i in np.unique(rows[:, 1])}
    return {f"imu{i}": _track(r[:, 0], r[:, 2:5], r[:, 5:8]) for i, r in of.items()}


def _track(us: Array, gyro_F: Array, accel_F: Array) -> ImuTrack:
    t_ns = _ns(us)
    return ImuTrack(t_ns, gyro_F * FLIP, accel_F * FLIP, t_ns)


def _truth(rows: dict[str, Array], imu: ImuTrack) -> Truth | None:
    """Positions of SIM2, attitudes of SIM carried between its few rows by the gyro."""
    moved, turned = rows.get("SIM2"), rows.get("SIM")
    if moved is None or turned is None:
        return None
    _, first = np.unique(turned[:, 0], return_index=True)
    turned = turned[first]
    norm = np.linalg.norm(turned[:, 1:5], axis=-1)
    turned = turned[np.abs(norm - 1.0) < _UNIT]
    if len(turned) < 2:
        return None
    t_ns, anchor_ns = _ns(moved[:, 0]), _ns(turned[:, 0])
    order = np.argsort(imu.t_ns, kind="stable")
    q_WB = between(t_ns, anchor_ns, flu_in_enu(turned[:, 1:5]), imu.t_ns[order], imu.gyro_I[order])
    return Truth(t_ns, enu_of_ned(moved[:, 1:4]), q_WB, enu_of_ned(moved[:, 4:7]))


def _ns(us: Array) -> IntArray:
    return np.rint(us).astype(np.int64) * 1000
