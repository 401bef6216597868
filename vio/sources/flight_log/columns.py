"""Knows which column is which in other people's CSV files, by name where names can be read."""

import re
from dataclasses import dataclass
from pathlib import Path

from vio.errors import LogError

_STEMS = {  # first part of a column's name -> what it holds
    "gyro": ("w", "g", "gyro", "gyr", "omega", "angular_velocity", "angvel"),
    "accel": ("a", "acc", "accel", "alpha", "linear_acceleration", "specific_force", "f"),
    "p": ("p", "t", "pos", "position", ""),
    "q": ("q", "quat", "orientation", ""),
    "v": ("v", "vel", "velocity"),
    "bg": ("bg", "b_g", "bw", "b_w", "gyro_bias"),
    "ba": ("ba", "b_a", "accel_bias"),
}
_AXES = {kind: "wxyz" if kind == "q" else "xyz" for kind in _STEMS}
_FRAMES = r"(?:_[a-z]{2})?(?:_[a-z])?_?"  # as in w_RS_S_x, p_MB_x
_BY_PATTERN = tuple(
    (kind, re.compile(f"(?:{'|'.join(stems)}){_FRAMES}([{_AXES[kind]}])"))
    for kind, stems in _STEMS.items()
)
_CORNER = re.compile(r"([uvxy])_?(tl|tr|br|bl)")
_SIGMA = re.compile(r"sigma_(tl|tr|br|bl)")
_BY_NAME = {
    "t_ns": ("timestamp", "time", "t", "stamp", "timestamp_ns", "time_ns", "t_ns"),
    "arrival_ns": ("arrival_ns",),  # `arrival` alone may be of any clock: not taken
    "mean": ("mean",),
    "on_ground": ("on_ground",),
    "received_ns": ("received_ns",),
    "tag_id": ("tag_id", "id", "tag"),
    "hamming": ("hamming",),
    "decision_margin": ("decision_margin", "margin"),
    "filename": ("filename", "file", "image"),
    "name": ("name", "phase"),
    "t_start_ns": ("t_start_ns", "start_ns"),
    "t_end_ns": ("t_end_ns", "end_ns"),
}
_NAMED = {alias: name for name, aliases in _BY_NAME.items() for alias in aliases}
_WRONG_UNITS = {  # units that would be read as something else, silently
    "t_ns": re.compile(r"s|sec|ms|us"),
    "gyro": re.compile(r"deg.*|°.*|dps|mrad.*"),
    "accel": re.compile(r"m?g"),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """What one kind of CSV file holds.

    what: prefix of its counters; meaning: its columns in words; ints, floats, texts: columns it
    must have; more_ints, more_floats: those it may have (taken by name alone, all of a group or
    none; they may be blank or NaN); order: all needed columns where DESIGN fixes positions.
    """

    what: str
    meaning: str
    order: tuple[str, ...]
    ints: tuple[str, ...]
    floats: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    more_ints: tuple[str, ...] = ()
    more_floats: tuple[tuple[str, ...], ...] = ()


def canonical(cell: str) -> str | None:
    """Our name of a column, such as gyro_x or q_w, of a header's cell; None: not recognised."""
    name = re.sub(r"\[[^\]]*\]|[\[\]\"']", "", cell).strip().lower()
    name = re.sub(r"[\s./-]+", "_", name)
    if name in _NAMED:
        return _NAMED[name]
    if corner := _CORNER.fullmatch(name):
        return ("u" if corner[1] in "ux" else "v") + f"_{corner[2]}"
    if _SIGMA.fullmatch(name):
        return name
    for kind, pattern in _BY_PATTERN:
        if match := pattern.fullmatch(name):
            return f"{kind}_{match[1]}"
    return None


def resolve(header: list[str], layout: Layout, path: Path) -> dict[str, int]:
    """Position of each column in the rows, by name, else by the order of the layout.

    A needed column that no name gives is taken by position only where the name there says
    nothing; LogError where the header is clearly of something else.
    """
    names = [canonical(cell) for cell in header]
    _refuse_units(header, names, path)
    found: dict[str, int] = {}
    for i, name in enumerate(names):
        if name is not None and found.setdefault(name, i) != i:
            raise LogError(f"{path}: the header names {name} twice; {layout.meaning} is needed")
    columns = {name: found[name] for name in layout.order if name in found}
    for i, name in enumerate(layout.order):
        if name in columns:
            continue
        if i >= len(names) or names[i] is not None:
            came = ",".join(cell.strip() for cell in header)
            raise LogError(
                f"{path}: the header has no column {name}; it is {came[:120]!r};"
                f" {layout.meaning} is needed"
            )
        columns[name] = i
    if len(set(columns.values())) < len(columns):
        raise LogError(f"{path}: the header mixes named and other columns; {layout.meaning}")
    groups = (*layout.more_floats, *((name,) for name in layout.more_ints))
    for group in groups:
        if all(name in found for name in group):
            columns.update({name: found[name] for name in group})
    return columns


def _refuse_units(header: list[str], names: list[str | None], path: Path) -> None:
    for cell, name in zip(header, names, strict=True):
        wrong = _WRONG_UNITS.get(name or "") or _WRONG_UNITS.get((name or "").rsplit("_", 1)[0])
        unit = re.search(r"\[([^\]]*)\]", cell)
        if wrong and unit and wrong.fullmatch(unit[1].strip().lower()):
            raise LogError(
                f"{path}: column {cell.strip()!r} is in {unit[1]}; ns, rad/s and m/s^2 are needed"
            )
