"""Walks through a DataFlash log's messages, binary or text, whatever its bytes claim.

Source: ArduPilot's AP_Logger (LogStructure.h): each message is A3 95, its type, then a packed row
that a FMT message (type 128) has described. A row of unknown type is passed over to the next A3 95.
"""

import mmap
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from vio.errors import LogError
from vio.sources.flight_log.tally import Tally

_SYNC, _FMT, _FMT_BYTES = b"\xa3\x95", 128, 89
_TEXT = b"FMT"
_CODES = {  # format character -> of struct, factor of its unit (0: a text)
    "a": ("64s", 0.0), "b": ("b", 1.0), "B": ("B", 1.0), "h": ("h", 1.0), "H": ("H", 1.0),
    "i": ("i", 1.0), "I": ("I", 1.0), "f": ("f", 1.0), "d": ("d", 1.0), "g": ("e", 1.0),
    "n": ("4s", 0.0), "N": ("16s", 0.0), "Z": ("64s", 0.0), "c": ("h", 0.01), "C": ("H", 0.01),
    "e": ("i", 0.01), "E": ("I", 0.01), "L": ("i", 1e-7), "M": ("B", 1.0), "q": ("q", 1.0),
    "Q": ("Q", 1.0),
}  # fmt: skip
Row = dict[str, float]


@dataclass(frozen=True, slots=True)
class _Format:
    """What one FMT message says: the message's name, its packed row, its numeric columns."""

    name: str
    row: struct.Struct
    columns: dict[str, tuple[int, float]]  # name -> place in the row, factor

    def read(self, data: bytes) -> Row:
        values = self.row.unpack(data)
        return {name: values[i] * factor for name, (i, factor) in self.columns.items()}


def messages(path: Path, wanted: set[str], tally: Tally) -> Iterator[tuple[str, Row]]:
    """Name and numeric fields of each wanted message; what is broken is counted and passed over.

    LogError where the file is no DataFlash log.
    """
    with path.open("rb") as file:
        first = file.read(3)
        if first[:2] == _SYNC:
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                yield from _binary(data, path, wanted, tally)
        elif first == _TEXT:
            yield from _text(path, wanted, tally)
        else:
            raise LogError(
                f"{path}: not a DataFlash log; one starts with the bytes A3 95, or with FMT"
            )


def _binary(
    data: mmap.mmap, path: Path, wanted: set[str], tally: Tally
) -> Iterator[tuple[str, Row]]:
    formats: dict[int, _Format | None] = {}
    at, end = 0, len(data)
    while True:
        found = data.find(_SYNC, at)
        if found != at:
            lost = (end if found < 0 else found) - at
            tally.count("dataflash_broken", f"{path}: bytes that are no message", int(lost > 0))
        if found < 0 or found + 3 > end:
            return
        at, kind = found, data[found + 2]
        if kind == _FMT and at + _FMT_BYTES <= end:
            number, made = _format_of(data[at + 3 : at + _FMT_BYTES])
            formats[number] = made
            if made is None:
                tally.count("dataflash_format", f"{path}: a FMT that describes no message")
            at += _FMT_BYTES
            continue
        known = formats.get(kind)
        if known is None or at + 3 + known.row.size > end:
            tally.count("dataflash_broken", f"{path}: bytes that are no message")
            at += 2
            continue
        if known.name in wanted:
            yield known.name, known.read(data[at + 3 : at + 3 + known.row.size])
        at += 3 + known.row.size


def _format_of(body: bytes) -> tuple[int, _Format | None]:
    """The type number that a FMT describes, and how; None where it cannot be."""
    number, length, name, form, columns = struct.unpack("<BB4s16s64s", body)
    codes = [_CODES.get(c) for c in _plain(form)]
    names = _plain(columns).split(",")
    if None in codes or len(codes) != len(names):
        return number, None
    row = struct.Struct("<" + "".join(c[0] for c in codes if c is not None))
    if row.size + 3 != length:
        return number, None
    places = {
        column: (i, code[1])
        for i, (column, code) in enumerate(zip(names, codes, strict=True))
        if code is not None and code[1]
    }
    return number, _Format(_plain(name), row, places)


def _plain(text: bytes) -> str:
    return text.split(b"\x00")[0].decode("latin-1")


def _text(path: Path, wanted: set[str], tally: Tally) -> Iterator[tuple[str, Row]]:
    """A log in text, a message a line: `IMU, 1000, 0.1, ...`; FMT lines name the columns."""
    columns: Mapping[str, list[str]] = {}
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            cells = [cell.strip() for cell in line.split(",")]
            if cells[0] == "FMT" and len(cells) > 5:
                columns = {**columns, cells[3]: cells[5:]}
            elif cells[0] in wanted:
                try:
                    values = [float(cell) for cell in cells[1:]]
                    yield cells[0], dict(zip(columns.get(cells[0], []), values, strict=True))
                except ValueError:
                    tally.count("dataflash_broken", f"{path}: {line[:60]!r} is no message")
