"""Any IMU of a log by name, with arrivals that a companion computer noted in a clock of its own."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter1d

from tagvo.geometry import IntArray
from vio.errors import LogError
from vio.records import ImuTrack
from vio.sources.flight_log.files import read_imu
from vio.sources.flight_log.tally import Tally

_WINDOW_S = 0.25  # the quickest sample within it tells the offset of the two clocks


def read_imu_of(log: Path, name: str, tally: Tally) -> ImuTrack:
    """The IMU mav0/NAME of a log; LogError names those that it has.

    A column `arrival [ns]` of another clock becomes arrival in the stamps' clock (`same_clock`).
    """
    path = log / "mav0" / name / "data.csv"
    if not path.exists():
        there = sorted(p.parent.name for p in log.glob("mav0/*imu*/data.csv"))
        has = f"it has {', '.join(there)}" if there else "it has no IMU"
        raise LogError(f"{log}: no IMU {name!r} (mav0/{name}/data.csv); {has}")
    track = read_imu(path, tally)
    noted = _noted_arrivals(path)
    if not noted:
        return track
    known = np.array([noted.get(t, -1) for t in track.t_ns.tolist()], dtype=np.int64)
    if (known < 0).any():
        tally.note(f"{path}: arrivals are not noted for every sample, so none is taken")
        return track
    return replace(track, arrival_ns=same_clock(track.t_ns, known))


def same_clock(t_ns: IntArray, noted_ns: IntArray) -> IntArray:
    """Arrivals noted in another clock, in the clock of the stamps; (n,), (n,) -> (n,).

    The clocks' offset and drift are what the quickest sample of each quarter second shows: it
    counts as known at its stamp, all others as much later as they were slower. Where one clock
    jumps, samples seem late by the jump for an eighth of a second.
    """
    offset = noted_ns - t_ns
    seconds = (t_ns - t_ns[0]) * 1e-9
    rest = (offset - offset[0]).astype(float)
    trend = np.polynomial.Polynomial.fit(seconds, rest, 1)(seconds) if len(t_ns) > 2 else 0.0
    rest = rest - trend
    step = max(float(np.median(np.diff(seconds))), 1e-6) if len(t_ns) > 1 else 1.0
    lowest = minimum_filter1d(rest, 2 * round(0.5 * _WINDOW_S / step) + 1, mode="nearest")
    return np.asarray(t_ns + np.rint(rest - lowest).astype(np.int64))


def _noted_arrivals(path: Path) -> dict[int, int]:
    """Stamp to `arrival [ns]` of a file; empty where it has no such column or it is arrival_ns."""
    out: dict[int, int] = {}
    with path.open(encoding="utf-8-sig", newline="") as file:
        rows = csv.reader(file)
        names = [cell.split("[")[0].strip(" #").lower() for cell in next(rows, [])]
        if "arrival" not in names:
            return out
        column = names.index("arrival")
        for row in rows:
            try:
                out[int(row[0])] = int(row[column])
            except (ValueError, IndexError):
                continue  # the reader of the track counts such rows
    return out
