"""Writes and reads `.tum` trajectories, the text that evo and most tools of the field take."""

from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.textfile import read_text, write_atomic
from vio.errors import LogError

_MAX_NS = 2**62


def tum_line(t_ns: int, p_WI: Array, q_WI: Array) -> str:
    """`t tx ty tz qx qy qz qw`: seconds, exact to the nanosecond; p (3,) [m], q (4,) wxyz."""
    seconds, rest = divmod(abs(t_ns), 1_000_000_000)
    sign = "-" if t_ns < 0 else ""
    x, y, z = p_WI
    qw, qx, qy, qz = q_WI
    return f"{sign}{seconds}.{rest:09d} {x:.9f} {y:.9f} {z:.9f} {qx:.9f} {qy:.9f} {qz:.9f} {qw:.9f}"


def write_tum(path: Path, t_ns: IntArray, p_WI: Array, q_WI: Array) -> None:
    """Write n poses of I in W, whole or not at all; (n,), (n, 3) [m], (n, 4) wxyz."""
    rows = zip(t_ns.tolist(), p_WI.tolist(), q_WI.tolist(), strict=True)
    write_atomic(path, "".join(f"{tum_line(*row)}\n" for row in rows))


def read_tum(path: Path) -> tuple[IntArray, Array, Array]:
    """Stamps (n,) exact [ns], p (n, 3) [m], q (n, 4) wxyz; LogError names the first bad line."""
    stamps: list[int] = []
    poses: list[list[float]] = []
    for number, line in enumerate(read_text(path, LogError).split("\n"), start=1):
        cells = line.split()
        if not cells or cells[0].startswith("#"):
            continue
        try:
            stamp = _nanoseconds(cells[0])
            pose = [float(cell) for cell in cells[1:]]
        except (ValueError, InvalidOperation):
            pose = []
        if len(pose) != 7 or not np.isfinite(pose).all():
            raise LogError(f"{path} line {number}: {line[:80]!r}; t tx ty tz qx qy qz qw is needed")
        stamps.append(stamp)
        poses.append(pose)
    table = np.array(poses, dtype=float).reshape(-1, 7)
    return np.array(stamps, dtype=np.int64), table[:, :3], table[:, [6, 3, 4, 5]]


def _nanoseconds(text: str) -> int:
    """Whole nanoseconds of seconds in decimal text, never through a float."""
    value = Decimal(text)
    if not value.is_finite() or value.adjusted() > 18 or abs(value) * 10**9 >= _MAX_NS:
        raise ValueError(text)
    return int((value * 10**9).to_integral_value())
