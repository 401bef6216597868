"""Cuts a plane into sheets of paper: where to cut so that few tags are, and what lies where.

Lengths in metres; the plane's x, y run to the right and up on paper. On a sheet lie, from its edge
inwards: what a printer cannot print, room for marks (below also a footer), the overlap with the
neighbours, and the sheet's own part of the plane.
"""

from dataclasses import dataclass

import numpy as np

from tagvo.errors import MapError
from tagvo.geometry import Array, IntArray

PAPERS = {
    "A4": (0.210, 0.297),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
LONGEST = 5.08  # a page's side: PDF's 200 inch
MARKS = 0.006  # room for marks around the overlap
FOOTER = 0.015  # room for the ruler and what a sheet says of itself
RULER = 0.1
_LEAST = 0.02  # of the plane on a sheet, or it is no use
_CANDIDATE_STEP, _TENTH = 1e-3, 1e-4
_OFF_GAP = 0.3  # in tags cut: what a cut costs that is not in the middle of a gap


@dataclass(frozen=True, slots=True)
class Paper:
    """Sheets to print on: width and height [m] as fed; a roll's height is as long as is needed.

    margin: what a printer leaves white at each edge; overlap: how much of each neighbour a sheet
    shows besides its own part. turn: auto, portrait or landscape.
    """

    name: str
    width: float
    height: float
    roll: bool = False
    margin: float = 0.005
    overlap: float = 0.005
    turn: str = "auto"


@dataclass(frozen=True, slots=True, eq=False)
class Sheet:
    """One sheet: column and row from the lower left, its part of the plane from low to high (2,).

    bleed: left, bottom, right, top, how much more of the plane is drawn; paper (2,) its width and
    height; at (2,) where `low` lies from the paper's lower left corner [m].
    """

    column: int
    row: int
    low: Array
    high: Array
    bleed: tuple[float, float, float, float]
    paper: tuple[float, float]
    at: Array

    @property
    def name(self) -> str:
        """A letter for the column and a number for the row, A1 at the lower left."""
        letters, n = "", self.column + 1
        while n:
            n, digit = divmod(n - 1, 26)
            letters = chr(65 + digit) + letters
        return f"{letters}{self.row + 1}"

    @property
    def window(self) -> tuple[Array, Array]:
        """The part of the plane that is drawn, from (2,) to (2,)."""
        return self.low - self.bleed[:2], self.high + self.bleed[2:]


@dataclass(frozen=True, slots=True, eq=False)
class Sheets:
    """A plane cut into sheets, by rows from the lower left; cuts along x and y, ends included."""

    sheets: tuple[Sheet, ...]
    cuts: tuple[Array, Array]


def named_paper(name: str) -> tuple[float, float]:
    """Width and height [m] of a paper, upright; MapError where unknown."""
    if name.upper() not in PAPERS:
        raise MapError(f"paper: unknown {name!r}; choose one of {', '.join(PAPERS)}")
    return PAPERS[name.upper()]


def cut_plane(low: Array, high: Array, squares: Array, paper: Paper) -> Sheets:
    """The plane from low to high (2,) on the fewest sheets, then with the fewest tags cut.

    squares (n, 2, 2): lower left and upper right of what should stay whole. Cuts lie at whole
    tenths of a mm, as they are written on the sheets. Raises MapError where the paper is too small
    to hold anything.
    """
    low, high = np.floor(low / _TENTH + 1e-6) * _TENTH, np.ceil(high / _TENTH - 1e-6) * _TENTH
    ways: list[tuple[int, float, float, int, Sheets]] = []
    for turn in ("portrait", "landscape") if paper.turn == "auto" else (paper.turn,):
        sheets = _cut(low, high, squares, paper, turn == "landscape")
        if sheets is not None:
            cut = sum(
                float(_crossed(c[1:-1], squares[:, :, k]).sum()) for k, c in enumerate(sheets.cuts)
            )
            area = sum(s.paper[0] * s.paper[1] for s in sheets.sheets)
            ways.append((len(sheets.sheets), cut, area, len(ways), sheets))
    if not ways:
        least = 2e3 * (paper.margin + MARKS + paper.overlap) + 1e3 * _LEAST
        raise MapError(
            f"paper {paper.name}: {1e3 * paper.width:g} x {1e3 * paper.height:g} mm with margins of"
            f" {1e3 * paper.margin:g} mm and {1e3 * paper.overlap:g} mm of overlap leave no room;"
            f" {max(least, 1e3 * RULER + 2e3 * paper.margin):g} x {least + 1e3 * FOOTER:g} mm do"
        )
    return min(ways, key=lambda way: way[:4])[-1]


def _cut(low: Array, high: Array, squares: Array, paper: Paper, landscape: bool) -> Sheets | None:
    """The cuts with the paper one way; None where it holds nothing so."""
    size = np.array([paper.height, paper.width] if landscape else [paper.width, paper.height])
    edge = paper.margin + MARKS + paper.overlap
    around = np.array([2 * edge, 2 * edge + FOOTER])
    room = size - around
    if room.min() < _LEAST or size[0] < RULER + 2 * paper.margin:
        return None
    cuts = (
        _tenths(cut_lines(low[0], high[0], room[0] - _TENTH, squares[:, :, 0])),
        _tenths(cut_lines(low[1], high[1], room[1] - _TENTH, squares[:, :, 1])),
    )
    many = (len(cuts[0]) - 1, len(cuts[1]) - 1)
    sheets = []
    for row, column in np.ndindex(many[1], many[0]):
        begin = np.array([cuts[0][column], cuts[1][row]])
        part = np.array([cuts[0][column + 1], cuts[1][row + 1]]) - begin
        page, at = size.copy(), np.array([edge, edge + FOOTER])
        if paper.roll:
            long = 0 if landscape else 1
            page[long] = max(RULER + 2 * paper.margin, (part + around)[long])
        elif many == (1, 1):
            at += 0.5 * (room - part)  # a lone sheet has it in its middle
        beside = (column > 0, row > 0, column < many[0] - 1, row < many[1] - 1)
        left, bottom, right, top = (paper.overlap * there for there in beside)
        paper_size = (float(page[0]), float(page[1]))
        sheets.append(
            Sheet(column, row, begin, begin + part, (left, bottom, right, top), paper_size, at)
        )
    return Sheets(tuple(sheets), cuts)


def _tenths(x: Array) -> Array:
    return np.round(x / _TENTH) * _TENTH


def cut_lines(low: float, high: float, room: float, spans: Array) -> Array:
    """Where to cut a length into the fewest parts of at most `room`, ends included; (k + 1,).

    Of those cuts the ones that cross the fewest spans (n, 2), best in the middle of gaps between
    them, then about evenly; found exactly (dynamic programming) over all gaps and every mm.
    """
    parts = max(1, int(np.ceil((high - low) / room - 1e-9)))
    if parts == 1:
        return np.array([low, high])
    even = np.linspace(low, high, parts + 1)[1:-1]
    x, price = _candidates(low, high, even, spans)
    slack = parts * room - (high - low)
    stages: list[tuple[IntArray, IntArray]] = []  # candidates of a cut, which one came before each
    cost = np.zeros(1)
    for k in range(1, parts):
        latest = low + k * room
        here = np.flatnonzero((x >= latest - slack - 1e-9) & (x <= latest + 1e-9))
        before = x[stages[-1][0]] if stages else np.array([low])
        gap = x[here][:, None] - before[None]
        ways = np.where((gap > 1e-6) & (gap <= room + 1e-9), cost[None], np.inf)
        uneven = np.square((x[here] - even[k - 1]) / room)
        stages.append((here, ways.argmin(axis=1)))
        cost = ways.min(axis=1) + price[here] + 1e-3 * uneven
    cuts, best = [high], int(cost.argmin())
    for here, came in reversed(stages):
        cuts.append(float(x[here[best]]))
        best = int(came[best])
    return np.array([low, *reversed(cuts)])


def _candidates(low: float, high: float, even: Array, spans: Array) -> tuple[Array, Array]:
    """Places to cut, in order, and what each costs, in spans crossed; (m,), (m,)."""
    begins, ends = np.sort(spans[:, 0]), np.sort(spans[:, 1])
    after = np.searchsorted(begins, ends - 1e-6)
    last = after < len(begins)
    gaps = 0.5 * (ends[last] + begins[after[last]])
    steps = low + np.arange(_CANDIDATE_STEP, high - low, _CANDIDATE_STEP)
    x = np.concatenate([gaps, steps, even])
    price = _crossed(x, spans) + np.repeat([0.0, _OFF_GAP], [len(gaps), len(steps) + len(even)])
    order = np.argsort(x, kind="stable")
    inside = order[(x[order] > low + 1e-6) & (x[order] < high - 1e-6)]
    return x[inside], price[inside]


def _crossed(lines: Array, spans: Array) -> Array:
    """How many spans (n, 2) each line (m,) cuts in two; (m,)."""
    begun = np.searchsorted(np.sort(spans[:, 0]), lines - 1e-6, side="left")
    ended = np.searchsorted(np.sort(spans[:, 1]), lines + 1e-6, side="right")
    return (begun - ended).astype(float)
