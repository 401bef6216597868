"""ArduPilot's DataFlash log (.bin) by pymavlink: raw IMUs, and a simulator's truth."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tagvo.geometry import Array, IntArray
from vio.errors import LogError
from vio.frames import FLIP, enu_of_ned, flu_in_enu
from vio.records import ImuTrack, Truth
from vio.sources.foreign.attitude import between
from vio.sources.foreign.records import Foreign
from vio.sources.tally import Tally

_FIELDS = {
    "GYR": ("SampleUS", "I", "GyrX", "GyrY", "GyrZ"),
    "ACC": ("SampleUS", "I", "AccX", "AccY", "AccZ"),
    "IMU": ("TimeUS", "I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "SIM2": ("TimeUS", "PN", "PE", "PD", "VN", "VE", "VD"),
    "SIM": ("TimeUS", "Q1", "Q2", "Q3", "Q4"),
}
_BINARY, _TEXT = b"\xa3\x95", b"FMT"
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
    raw = {name: rows[name] for name in ("GYR", "ACC") if name in rows}
    notes = []
    if len(raw) == 2:
        imus = _raw_imus(raw["GYR"], raw["ACC"], path, tally)
    else:
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
    for message in _messages(path, tally):
        name = message.get_type()
        try:
            out[name].append(tuple(getattr(message, key) for key in _FIELDS[name]))
        except AttributeError:
            tally.count("dataflash_fields", f"{path}: a {name} without {', '.join(_FIELDS[name])}")
    return {name: np.array(rows, dtype=float) for name, rows in out.items() if rows}


def _messages(path: Path, tally: Tally) -> Iterator[Any]:
    from pymavlink.DFReader import DFReader_binary, DFReader_text

    with path.open("rb") as file:
        first = file.read(3)
    if first[:2] != _BINARY and first != _TEXT:
        raise LogError(f"{path}: not a DataFlash log; one starts with the bytes A3 95, or with FMT")
    try:
        text = first == _TEXT
        reader = (DFReader_text if text else DFReader_binary)(str(path), zero_time_base=True)
    except (OSError, ValueError, struct.error, IndexError, KeyError, AttributeError) as err:
        raise LogError(f"{path}: not a DataFlash log that can be read ({err})") from None
    with reader:
        while True:
            try:
                message = reader.recv_match(type=set(_FIELDS), strict=True)
            except (ValueError, struct.error, IndexError, KeyError, UnicodeError) as err:
                tally.count("dataflash_broken", f"{path}: reading ends where it is broken ({err})")
                return
            if message is None:
                return
            yield message


def _raw_imus(gyr: Array, acc: Array, path: Path, tally: Tally) -> dict[str, ImuTrack]:
    """Gyro and accelerometer of each instance, paired by their sample time."""
    out = {}
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
    if moved is None or turned is None or len(turned) < 2:
        return None
    t_ns, anchor_ns = _ns(moved[:, 0]), _ns(turned[:, 0])
    order = np.argsort(imu.t_ns, kind="stable")
    q_WB = between(t_ns, anchor_ns, flu_in_enu(turned[:, 1:5]), imu.t_ns[order], imu.gyro_I[order])
    return Truth(t_ns, enu_of_ned(moved[:, 1:4]), q_WB, enu_of_ned(moved[:, 4:7]))


def _ns(us: Array) -> IntArray:
    return np.rint(us).astype(np.int64) * 1000
