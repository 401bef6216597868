"""Reads CSV files that were cut, edited or damaged: bad rows are counted, good ones are exact."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.textfile import read_text
from vio.errors import LogError
from vio.sources.columns import Layout, canonical, resolve
from vio.sources.tally import Tally

BLANK = np.iinfo(np.int64).min  # an optional whole number that the row leaves open
_MAX_INT = 2**62  # differences of stamps must fit in int64
_WHOLE = re.compile(r"([+-]?\d{1,19})(?:\.0*)?", re.ASCII)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I | re.A)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The good rows of a file: whole numbers (n,), floats (n,) and texts by column; line (n,)."""

    ints: dict[str, IntArray]
    floats: dict[str, Array]
    texts: dict[str, list[str]]
    line: IntArray

    def __len__(self) -> int:
        return len(self.line)

    def stack(self, names: tuple[str, ...]) -> Array:
        """Columns side by side; (n, len(names))."""
        return np.stack([self.floats[name] for name in names], axis=-1)


class _RowError(ValueError):
    """A row that cannot be used; its text is the cause."""


def read_table(path: Path, layout: Layout, tally: Tally) -> Table:
    """The good rows of a CSV file; bad ones are counted as `<what>_<cause>`.

    A header is needed ('#', units in brackets, blanks, BOM and CRLF are accepted); stamps never
    pass through a float. LogError where the header is wrong or no row is good.
    """
    lines = read_text(path, LogError, "replace").split("\n")
    at, header = _header(lines, layout, path)
    columns = resolve(header, layout, path)
    table = _parse(lines, at + 1, len(header), columns, layout, path, tally)
    if len(table) == 0:
        causes = [k for k in tally.counters if k.startswith(f"{layout.what}_")]
        why = f" (rows came, but: {', '.join(causes)})" if causes else ""
        raise LogError(f"{path}: no valid row{why}; {layout.meaning} is needed")
    return table


def _header(lines: list[str], layout: Layout, path: Path) -> tuple[int, list[str]]:
    """Line index and cells of the header: the first line that is no blank and no remark."""
    for at, line in enumerate(lines):
        text = line.strip()
        cells = text.lstrip("#").split(",")
        remark = text.startswith("#") and not any(map(canonical, cells))
        if not text or remark:
            continue
        if _NUMBER.fullmatch(cells[-1].strip()):
            raise LogError(f"{path}: no header line; {layout.meaning} is needed")
        return at, cells
    raise LogError(f"{path}: the file is empty; {layout.meaning} is needed")


def _parse(
    lines: list[str],
    start: int,
    width: int,
    columns: dict[str, int],
    layout: Layout,
    path: Path,
    tally: Tally,
) -> Table:
    optional = [name for group in layout.more_floats for name in group if name in columns]
    float_names = [*layout.floats, *optional]
    int_names = [*layout.ints, *(name for name in layout.more_ints if name in columns)]
    int_at, float_at = [columns[n] for n in int_names], [columns[n] for n in float_names]
    text_at = [columns[n] for n in layout.texts]
    rows: list[tuple[list[int], list[float], list[str], int]] = []
    need, width = max(columns.values()) + 1, _row_width(lines, start, width)
    must = len(layout.floats)
    for at, cells in _split(lines, start):
        try:
            _check_width(cells, need, width, last=at == len(lines) - 1)
            ints = _whole_numbers(cells, int_at, len(layout.ints))
            floats = _numbers(cells, float_at, must)
            rows.append((ints, floats, [cells[i].strip() for i in text_at], at + 1))
        except _RowError as cause:
            tally.count(f"{layout.what}_{cause}", f"{path} line {at + 1}: row skipped")
    ints_ = np.array([r[0] for r in rows], dtype=np.int64).reshape(len(rows), len(int_names))
    floats_ = np.array([r[1] for r in rows], dtype=float).reshape(len(rows), len(float_names))
    return Table(
        {name: ints_[:, i] for i, name in enumerate(int_names)},
        {name: floats_[:, i] for i, name in enumerate(float_names)},
        {name: [r[2][i] for r in rows] for i, name in enumerate(layout.texts)},
        np.array([r[3] for r in rows], dtype=np.int64),
    )


def _split(lines: list[str], start: int) -> Iterator[tuple[int, list[str]]]:
    for at in range(start, len(lines)):
        text = lines[at].replace('"', "").strip()
        if text and not text.startswith("#"):
            yield at, text.split(",")


def _row_width(lines: list[str], start: int, width: int) -> int:
    """Cells that a row may have: the header's, or those of the first row where it has more."""
    _, first = next(_split(lines, start), (0, []))
    return max(width, len(first))


def _check_width(cells: list[str], need: int, width: int, last: bool) -> None:
    if len(cells) < need:
        raise _RowError("truncated" if last else "too_few_columns")
    if len(cells) > width and any(cell.strip() for cell in cells[width:]):
        raise _RowError("too_many_columns")


def _whole_numbers(cells: list[str], at: list[int], must: int) -> list[int]:
    """Whole numbers, exact; columns from the `must`-th on may be blank or NaN."""
    out = []
    for k, i in enumerate(at):
        cell = cells[i].strip()
        match = _WHOLE.fullmatch(cell)
        if match and abs(value := int(match[1])) < _MAX_INT:
            out.append(value)
        elif k >= must and cell.lower() in ("", "nan"):
            out.append(BLANK)
        else:
            raise _RowError("not_a_whole_number")
    return out


def _numbers(cells: list[str], at: list[int], must: int) -> list[float]:
    """Finite numbers; columns from the `must`-th on may be blank, NaN or infinite (then NaN)."""
    out = []
    for k, i in enumerate(at):
        cell = cells[i]
        try:
            value = float(cell)
        except ValueError:
            if k < must or cell.strip():
                raise _RowError("not_a_number") from None
            value = float("nan")
        if not -1e300 < value < 1e300:
            if k < must:
                raise _RowError("not_finite")
            value = float("nan")
        elif "_" in cell:  # Python reads 1_0 as 10; a file never means that
            raise _RowError("not_a_number")
        out.append(value)
    return out
