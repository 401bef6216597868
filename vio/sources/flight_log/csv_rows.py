"""Parses rows of CSV: whole blocks at once where they are clean, else row by row with causes."""

import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

from tagvo.geometry import Array, IntArray

BLANK = np.iinfo(np.int64).min  # an optional whole number that the row leaves open
_MAX_INT = 2**62  # differences of stamps must fit in int64
_MAX_FLOAT = 1e30  # no metre, pixel or radian is beyond; powers of what is below stay finite
_BLOCK = 2048
_GROWTH = 1.125  # of a column that is full: what is spare was never touched, and is given back
_WHOLE = re.compile(r"([+-]?\d{1,19})(?:\.0*)?", re.ASCII)


@dataclass(frozen=True, slots=True)
class Wanted:
    """Where the columns stand: indices of whole numbers, floats and texts in a row.

    The first must_ints and must_floats of them are needed, the others may be blank or NaN; a row
    has need cells at least and width at most. vectors: how many floats stand together in an array
    (all of them in one where it is empty).
    """

    ints: list[int]
    floats: list[int]
    texts: list[int]
    must_ints: int
    must_floats: int
    need: int
    width: int
    vectors: tuple[int, ...] = ()

    def slices(self) -> list[slice]:
        """Which of the floats each array holds."""
        if not self.floats:
            return []
        ends = np.cumsum(self.vectors or [len(self.floats)]).tolist()
        return [slice(a, b) for a, b in pairwise([0, *ends])]


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Good rows: ints (n, i), floats (n, f), texts (n lists), line (n,) numbers in the file."""

    ints: IntArray
    floats: Array
    texts: list[list[str]]
    line: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Good rows: ints of (n,) each, floats of (n, vector) each, texts (n lists), line (n,)."""

    ints: list[IntArray]
    floats: list[Array]
    texts: list[list[str]]
    line: IntArray


class _Growing:
    """Columns that grow in place: a list of blocks joined at the end needs the memory twice."""

    def __init__(self, wanted: Wanted) -> None:
        self._slices, self._count = wanted.slices(), 0
        self._ints = [np.empty(_BLOCK, np.int64) for _ in wanted.ints]
        self._floats = [np.empty((_BLOCK, s.stop - s.start)) for s in self._slices]
        self._line = np.empty(_BLOCK, np.int64)
        self._texts: list[list[str]] = []
        self._with_texts = bool(wanted.texts)

    def append(self, block: _Block) -> None:
        a, b = self._count, self._count + len(block.line)
        if b > len(self._line):
            self._resize(int(_GROWTH * b) + _BLOCK)
        for i, column in enumerate(self._ints):
            column[a:b] = block.ints[:, i]
        for part, column in zip(self._slices, self._floats, strict=True):
            column[a:b] = block.floats[:, part]
        self._line[a:b] = block.line
        if self._with_texts:
            self._texts += block.texts
        self._count = b

    def rows(self) -> Rows:
        self._resize(self._count)
        texts = self._texts if self._with_texts else []
        return Rows(self._ints, self._floats, texts, self._line)

    def _resize(self, count: int) -> None:
        for column in (*self._ints, *self._floats, self._line):
            column.resize((count, *column.shape[1:]), refcheck=False)  # nobody else has them yet


class _RowError(ValueError):
    """A row that cannot be used; its text is the cause."""


def parse_rows(
    lines: Iterable[str], start: int, wanted: Wanted, bad: Callable[[str, int], None]
) -> Rows:
    """All good rows; `bad(cause, line number)` hears of each other.

    lines: from line index `start` of the file on; only some thousand are held at a time.
    """
    found = _Growing(wanted)
    for first, block, last in _blocks(iter(lines), start):
        clean = _clean_block(block, first, wanted)
        found.append(clean or _block(block, first, last, wanted, bad))
    return found.rows()


def _blocks(lines: Iterator[str], first: int) -> Iterator[tuple[int, list[str], bool]]:
    """Index of its first line, lines, whether it ends the file; blank lines at the end left out."""
    held: tuple[int, list[str]] | None = None
    while block := list(islice(lines, _BLOCK)):
        if any(map(str.strip, block)):  # a block of blank lines has no row
            if held is not None:
                yield *held, False
            held = first, block
        first += len(block)
    if held is not None:
        while not held[1][-1].strip():
            held[1].pop()
        yield *held, True


def split(line: str) -> list[str]:
    """Cells of a line, none where it is blank or a remark; quotes are dropped."""
    text = line.replace('"', "").strip()
    return text.split(",") if text and not text.startswith("#") else []


def _clean_block(lines: list[str], first: int, wanted: Wanted) -> _Block | None:
    """The rows of a block in which every line is good, read by numpy; None where one is not."""
    commas = {line.count(",") for line in lines}
    if wanted.texts or len(commas) != 1 or not wanted.need <= max(commas) + 1 <= wanted.width:
        return None
    n_i, n_f = len(wanted.ints), len(wanted.floats)
    kind = [("i", np.int64, (n_i,))] + ([("f", np.float64, (n_f,))] if n_f else [])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # such as a stamp that would pass through a float
            table = np.loadtxt(
                lines,
                dtype=np.dtype(kind),
                delimiter=",",
                comments=None,
                usecols=wanted.ints + wanted.floats,
                ndmin=1,
            )
    except (ValueError, OverflowError, Warning):
        return None
    ints, floats = table["i"], table["f"] if n_f else np.zeros((len(table), 0))
    usable = np.abs(floats) < _MAX_FLOAT
    in_range = (ints > -_MAX_INT) & (ints < _MAX_INT)
    if len(table) != len(lines) or not in_range.all() or not usable[:, : wanted.must_floats].all():
        return None
    floats = np.where(usable, floats, np.nan)
    return _Block(ints, floats, [], np.arange(first, first + len(lines)) + 1)


def _block(
    lines: list[str], first: int, last: bool, wanted: Wanted, bad: Callable[[str, int], None]
) -> _Block:
    ints, floats, texts, numbers = [], [], [], []
    for at, line in enumerate(lines, first):
        cells = split(line)
        if not cells:
            continue
        try:
            _check_width(cells, wanted, last=last and at == first + len(lines) - 1)
            row = _whole_numbers(cells, wanted), _numbers(cells, wanted)
        except _RowError as cause:
            bad(str(cause), at + 1)
            continue
        ints.append(row[0])
        floats.append(row[1])
        texts.append([cells[i].strip() for i in wanted.texts])
        numbers.append(at + 1)
    return _Block(
        np.array(ints, dtype=np.int64).reshape(len(ints), len(wanted.ints)),
        np.array(floats, dtype=float).reshape(len(ints), len(wanted.floats)),
        texts,
        np.array(numbers, dtype=np.int64),
    )


def _check_width(cells: list[str], wanted: Wanted, last: bool) -> None:
    if len(cells) < wanted.need:
        raise _RowError("truncated" if last else "too_few_columns")
    if len(cells) > wanted.width and any(cell.strip() for cell in cells[wanted.width :]):
        raise _RowError("too_many_columns")


def _whole_numbers(cells: list[str], wanted: Wanted) -> list[int]:
    """Whole numbers, exact; optional ones may be blank or NaN."""
    out = []
    for k, i in enumerate(wanted.ints):
        cell = cells[i].strip()
        match = _WHOLE.fullmatch(cell)
        if match and abs(value := int(match[1])) < _MAX_INT:
            out.append(value)
        elif k >= wanted.must_ints and cell.lower() in ("", "nan"):
            out.append(BLANK)
        else:
            raise _RowError("not_a_whole_number")
    return out


def _numbers(cells: list[str], wanted: Wanted) -> list[float]:
    """Finite numbers; optional ones may be blank, NaN or infinite (then NaN)."""
    out = []
    for k, i in enumerate(wanted.floats):
        cell, must = cells[i], k < wanted.must_floats
        try:
            value = float(cell) if cell.strip() or must else np.nan
        except ValueError:
            raise _RowError("not_a_number") from None
        if "_" in cell:  # Python reads 1_0 as 10; a file never means that
            raise _RowError("not_a_number")
        if not -_MAX_FLOAT < value < _MAX_FLOAT:
            if must:
                raise _RowError("not_finite")
            value = np.nan
        out.append(value)
    return out
