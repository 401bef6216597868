"""PX4's ULog (.ulg) by pyulog: the IMU that its filter uses, and a simulator's truth."""

import io
import os
import struct
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from tagvo.geometry import Array, IntArray
from vio.convert.records import Foreign, said
from vio.errors import LogError, VioError
from vio.frames import FLIP, enu_of_ned, flu_in_enu
from vio.records import ImuTrack, Truth
from vio.sources.flight_log.tally import Tally

_BROKEN = (TypeError, ValueError, LookupError, ArithmeticError, struct.error, AttributeError,
           MemoryError, OSError, AssertionError, RuntimeError)  # fmt: skip
_IMU = "sensor_combined"
_ATTITUDE, _POSITION = "vehicle_attitude_groundtruth", "vehicle_local_position_groundtruth"


def read_ulog(path: Path, tally: Tally) -> Foreign:
    """sensor_combined in FLU, means over their interval, and the ground truths of a simulator.

    Stamps are the autopilot's time since boot; W is east, north, up at the local origin. LogError
    where the file is none or has no IMU.
    """
    log = _open(path)
    if log.file_corruption:
        tally.count("ulog_broken", f"{path}: broken places were passed over")
    elif _cut_off(path.read_bytes()):
        tally.count("ulog_truncated", f"{path}: ends within a message: the file was cut off")
    if log.dropouts:
        tally.count("ulog_dropouts", f"{path}: the logger lost data", len(log.dropouts))
    topics = {d.name: d.data for d in log.data_list if d.multi_id == 0}
    imu = topics.get(_IMU)
    if imu is None:
        has = ", ".join(sorted({d.name for d in log.data_list})) or "nothing that we know"
        raise LogError(f"{path}: no {_IMU} in it; it has {has}")
    try:
        t_ns = _ns(imu)
        gyro, accel = _stack(imu, "gyro_rad"), _stack(imu, "accelerometer_m_s2")
        truth = _truth(topics)
    except _BROKEN as err:  # fields that have other names or types than PX4's
        raise LogError(f"{path}: {_IMU} or the truth has not PX4's fields ({said(err)})") from None
    if not len(t_ns):
        raise LogError(f"{path}: {_IMU} has no sample")
    track = ImuTrack(t_ns, gyro * FLIP, accel * FLIP, t_ns, np.ones(len(t_ns), dtype=bool))
    notes = () if truth is not None else (f"{path}: no truth in it ({_POSITION} is a simulator's)",)
    return Foreign({"imu0": track}, truth=truth, notes=notes)


def _cut_off(data: bytes) -> bool:
    """Whether a ULog ends within a message: 16 bytes, then messages of size, type, payload."""
    at = 16
    while at + 3 <= len(data):
        at += 3 + int.from_bytes(data[at : at + 2], "little")
    return at != len(data)


def _open(path: Path) -> Any:
    try:
        from pyulog import ULog
        from pyulog.exceptions import ULogException
    except ImportError:
        raise VioError("ULog files need pyulog: pip install 'tagvio[logs]'") from None
    try:
        with redirect_stdout(io.StringIO()), _Finite(io.FileIO(path)) as file:
            # what it prints of a broken file is counted here
            return ULog(file, [_IMU, _ATTITUDE, _POSITION], disable_str_exceptions=True)
    except (ULogException, *_BROKEN) as err:
        raise LogError(f"{path}: not a ULog that can be read ({said(err)})") from None


class _Finite(io.BufferedReader):
    """A file that ends: pyulog goes to and fro for ever in some that are damaged."""

    def __init__(self, raw: io.FileIO) -> None:
        super().__init__(raw)
        # a message has 3 bytes and takes 2 reads
        self._path, self._reads = raw.name, 2 * os.fstat(raw.fileno()).st_size + 1000

    def read(self, size: int | None = -1, /) -> bytes:
        self._reads -= 1
        if self._reads < 0:
            raise LogError(
                f"{self._path}: not a ULog that can be read (its parts lead in a circle)"
            )
        return super().read(size)


def _truth(topics: dict[str, Any]) -> Truth | None:
    """Both truths where they have the same stamp: they are published together."""
    turned, moved = topics.get(_ATTITUDE), topics.get(_POSITION)
    if turned is None or moved is None:
        return None
    t_ns, i, j = np.intersect1d(_ns(turned), _ns(moved), return_indices=True)
    if not len(t_ns):
        return None
    p_N, v_N = (np.stack([moved[k] for k in keys], axis=-1)[j].astype(float)
                for keys in (("x", "y", "z"), ("vx", "vy", "vz")))  # fmt: skip
    q_WB = flu_in_enu(_stack(turned, "q", 4)[i])
    return Truth(t_ns, enu_of_ned(p_N), q_WB, enu_of_ned(v_N))


def _stack(data: Any, name: str, n: int = 3) -> Array:
    return np.stack([data[f"{name}[{k}]"] for k in range(n)], axis=-1).astype(float)


def _ns(data: Any) -> IntArray:
    return np.asarray(data["timestamp"].astype(np.int64) * 1000)
