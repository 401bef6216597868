"""Reads CSV files that were cut, edited or damaged: bad rows are counted, good ones are exact."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, groupby
from pathlib import Path

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.textfile import open_lines
from vio.errors import LogError
from vio.sources.flight_log.columns import Layout, canonical, resolve
from vio.sources.flight_log.csv_rows import Wanted, parse_rows, split
from vio.sources.flight_log.tally import Tally

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.I | re.A)


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The good rows of a file: whole numbers (n,), floats (n,) and texts by column; line (n,).

    vectors: floats (n, k) of columns that stand together, by their names; `floats` are views.
    """

    ints: dict[str, IntArray]
    floats: dict[str, Array]
    texts: dict[str, list[str]]
    line: IntArray
    vectors: dict[tuple[str, ...], Array]

    def __len__(self) -> int:
        return len(self.line)

    def stack(self, names: tuple[str, ...]) -> Array:
        """Columns side by side; (n, len(names)), not a copy where they stand together."""
        if names in self.vectors:
            return self.vectors[names]
        return np.stack([self.floats[name] for name in names], axis=-1)


def read_table(path: Path, layout: Layout, tally: Tally) -> Table:
    """The good rows of a CSV file; bad ones are counted as `<what>_<cause>`.

    A header is needed ('#', units in brackets, blanks, BOM and CRLF are accepted); stamps never
    pass through a float; the file is read line by line, never held. LogError where the header is
    wrong or no row is good.
    """

    def bad(cause: str, number: int) -> None:
        tally.count(f"{layout.what}_{cause}", f"{path} line {number}: row skipped")

    with open_lines(path, LogError) as lines:
        at, header = _header(lines, layout, path)
        columns = resolve(header, layout, path)
        table = _parse(lines, at + 1, columns, layout, len(header), bad)
    if len(table) == 0:
        causes = [k for k in tally.counters if k.startswith(f"{layout.what}_")]
        why = f" (rows came, but: {', '.join(causes)})" if causes else ""
        if f"{layout.what}_not_a_whole_number" in causes:
            why += _in_seconds(path, at, columns, layout)
        raise LogError(f"{path}: no valid row{why}; {layout.meaning} is needed")
    return table


def _in_seconds(path: Path, header_at: int, columns: dict[str, int], layout: Layout) -> str:
    """Where the first row has a decimal number for a whole one, as stamps in seconds are."""
    with open_lines(path, LogError) as lines:
        rows = ((n, split(line)) for n, line in enumerate(lines, 1) if n > header_at + 1)
        number, cells = next(((n, cells) for n, cells in rows if cells), (0, []))
    for name in (n for n in layout.ints if columns[n] < len(cells)):
        cell = cells[columns[name]].strip()
        if re.fullmatch(r"[+-]?\d+\.\d*[1-9]\d*", cell, re.A):
            hint = ": seconds?" if name.startswith("t_") else ""
            return (
                f"; line {number} column {columns[name] + 1}: {cell[:40]} is no whole number{hint}"
            )
    return ""


def _header(lines: Iterator[str], layout: Layout, path: Path) -> tuple[int, list[str]]:
    """Line index and cells of the header: the first line that is no blank and no remark."""
    for at, line in enumerate(lines):
        text = line.strip()
        cells = text.lstrip("#").split(",")
        short = len(cells) < len(layout.order) and not any(map(canonical, cells))
        remark = text.startswith("#") and short
        if not text or remark:
            continue
        if len(cells) < len(layout.order) and text.count(";") >= len(layout.order) - 1:
            raise LogError(f"{path}: separator ; found, a comma is needed;"
                           f" {layout.meaning}")  # fmt: skip
        if any(_NUMBER.fullmatch(cell.strip()) for cell in cells):
            raise LogError(f"{path}: no header line; {layout.meaning} is needed")
        return at, [cell.rstrip("\n") for cell in cells]
    raise LogError(f"{path}: the file is empty; {layout.meaning} is needed")


def _parse(
    lines: Iterator[str],
    start: int,
    columns: dict[str, int],
    layout: Layout,
    width: int,
    bad: Callable[[str, int], None],
) -> Table:
    optional = [name for group in layout.more_floats for name in group if name in columns]
    floats = [*layout.floats, *optional]
    vectors = [tuple(group) for _, group in groupby(floats, key=_vector)]
    ints = [*layout.ints, *(name for name in layout.more_ints if name in columns)]
    at, first = start, ""
    for at, first in enumerate(lines, start):  # noqa: B007 - up to a line that holds cells
        if split(first):
            break
    wanted = Wanted(
        [columns[name] for name in ints],
        [columns[name] for name in floats],
        [columns[name] for name in layout.texts],
        len(layout.ints),
        len(layout.floats),
        need=max(columns.values()) + 1,
        # a header may leave out the columns that nobody needs
        width=max(width, len(split(first))),
        vectors=tuple(map(len, vectors)),
    )
    rows = parse_rows(chain([first], lines), at, wanted, bad)
    return Table(
        dict(zip(ints, rows.ints, strict=True)),
        {
            name: array[:, i]
            for names, array in zip(vectors, rows.floats, strict=True)
            for i, name in enumerate(names)
        },
        {name: [text[i] for text in rows.texts] for i, name in enumerate(layout.texts)},
        rows.line,
        dict(zip(vectors, rows.floats, strict=True)),
    )


def _vector(name: str) -> str:
    """What the components of one vector share: gyro of gyro_x."""
    return name.rpartition("_")[0]
