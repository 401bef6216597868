"""Other people's tag maps: one file a format, and the table by which all of them are used."""

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from tagvo.errors import MapError, choose_one_of
from tagvo.maps.formats import (
    apriltag_ros1,
    apriltag_ros2,
    clover,
    fiducials,
    kalibr,
    limelight,
    own,
    tagslam,
    wpilib,
)
from tagvo.maps.formats.common import Content, Format, Imported, ReadOptions, losses_of
from tagvo.tags.tag_map import TagMap
from tagvo.textfile import parse_json, parse_yaml, read_text, write_atomic

__all__ = ["FORMATS", "Format", "Imported", "guess_format", "read_map_file", "write_map_file"]

FORMATS: dict[str, Format] = {
    "wpilib": wpilib.FORMAT_2026,
    "wpilib2027": wpilib.FORMAT_2027,
    "limelight": limelight.FORMAT,
    "apriltag_ros1": apriltag_ros1.FORMAT,
    "apriltag_ros2": apriltag_ros2.FORMAT,
    "tagslam": tagslam.FORMAT,
    "kalibr": kalibr.FORMAT,
    "clover": clover.FORMAT,
    "fiducials": fiducials.FORMAT,
    "tagmap": own.FORMAT,
}


def read_map_file(
    path: Path,
    fmt: str | None = None,
    *,
    size: float | None = None,
    family: str | None = None,
    bundle: str | None = None,
    layout: Path | None = None,
) -> Imported:
    """Tag map of a file in any of FORMATS (None: guessed from what it holds), and notes on it.

    size: border side [m] for tags whose size the file does not give; family: where it names none;
    bundle: one of several maps in it; layout: map file with the poses of a file of sizes alone.
    """
    content = _parse(read_text(path, MapError), str(path))
    name = guess_format(content, str(path)) if fmt is None else fmt
    poses = None if layout is None else read_map_file(layout, size=size, family=family).tag_map
    options = ReadOptions(size, family, bundle, poses)
    chosen = format_named(name)
    imported = chosen.read(content, str(path), options)
    if size is not None and "size" in chosen.holds:
        unused = f"--size counts only for tags without a size of their own ({chosen.title})"
        return replace(imported, notes=(*imported.notes, unused))
    return imported


def write_map_file(tag_map: TagMap, path: Path, fmt: str) -> list[str]:
    """Write a map in one of FORMATS, whole or not at all; returns what the format cannot hold."""
    chosen = format_named(fmt)
    exported = chosen.write(tag_map)
    write_atomic(path, exported.text)
    return [*losses_of(tag_map, chosen.holds, chosen.title), *exported.losses]


def format_named(name: str) -> Format:
    """The format of that name; MapError lists those there are."""
    if name not in FORMATS:
        raise MapError(choose_one_of("map format", name, FORMATS))
    return FORMATS[name]


def guess_format(content: Content, where: str) -> str:
    """Name of the first format that recognises what a file holds; MapError where none does."""
    for name, candidate in FORMATS.items():
        if candidate.recognises(content):
            return name
    raise MapError(f"{where}: no tag map known here; choose one of {', '.join(FORMATS)}")


def _parse(text: str, where: str) -> Content:
    """A mapping (JSON or YAML), or the words of each line where the lines begin with numbers.

    A list of tags is a mapping with nothing but them; a CSV's header is its first row.
    """
    lines = (line.split("#")[0] for line in text.splitlines())
    if re.match(r"\s*\"?id\"?\s*,", text, re.IGNORECASE):
        return [line.replace('"', "").strip().split(",") for line in lines if line.strip()]
    rows = [words for words in (line.split() for line in lines) if words]
    if rows and all(_is_number(words[0]) for words in rows):
        return rows
    value: Any = None
    if text.lstrip()[:1] in ("{", "["):
        with suppress(MapError):  # YAML's flow style looks alike; its parser names the fault
            value = parse_json(text, where, MapError)
    if value is None:
        value = parse_yaml(text, where, MapError)
    if isinstance(value, list) and value and all(isinstance(tag, dict) for tag in value):
        posed = any("pose" in tag for tag in value)
        return {"tags": value, "field": {}} if posed else {"tags": value}
    if not isinstance(value, dict):
        kind = "empty" if value is None else f"a {type(value).__name__}"
        raise MapError(f"{where}: the file is {kind}; a mapping or a table of numbers is needed")
    return value


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
