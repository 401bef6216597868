"""Draws one sheet of a printed map: its tags, crop marks, rulers, and what it says of itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.maps.printing.cutting import FOOTER, RULER, Paper, Sheet, Sheets
from tagvo.maps.printing.pen import Colour, Pen, fitted
from tagvo.maps.printing.plane import Number, Plane

HAIR, THIN = 0.0001, 0.0002  # widths of lines [m]
GREY: Colour = (0.55, 0.55, 0.55)
_BODY = 0.0018  # height of capitals [m]
_MARK = 0.005  # length of a crop mark
_GAP = 0.001  # between the overlap and a mark


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """What is printed: the plane with its numbers, cut into sheets of a paper; its title."""

    plane: Plane
    numbers: Sequence[Number]
    sheets: Sheets
    paper: Paper
    title: str

    def rows_on(self, sheet: Sheet) -> IntArray:
        """Rows of the tags that show on a sheet, in the order of the map."""
        squares = self.plane.squares(np.arange(len(self.plane.at)))
        low, high = sheet.window
        shown = (squares[:, 0] < high) & (squares[:, 1] > low)
        return np.flatnonzero(shown.all(axis=1))


def draw_sheet(pen: Pen, drawing: Drawing, sheet: Sheet, what: str, note: str) -> None:
    """One page; `what` heads its footer, such as `Sheet B3 · page 4 of 21`, `note` comes below."""
    pen.page(sheet.paper)
    pen.mark(what)
    rows = drawing.rows_on(sheet)
    shift = sheet.at - sheet.low
    low, high = sheet.window
    with pen.clipped(low + shift, high + shift):
        for row in rows:
            pen.fill([loop + shift for loop in drawing.plane.outlines(int(row))])
        for number in drawing.numbers:
            if (number.low < high).all() and (number.high > low).all():
                pen.fill([number.pointer + shift])
                at = number.start + shift
                pen.text(at, number.words, number.height, angle=number.angle)
    _crop_marks(pen, sheet, drawing.paper)
    _rulers(pen, sheet, drawing.paper)
    _footer(pen, drawing, sheet, (what, note), rows)


def _crop_marks(pen: Pen, sheet: Sheet, paper: Paper) -> None:
    """Two lines at each corner of the sheet's own part, outside what is drawn."""
    low, high = sheet.at, sheet.at + sheet.high - sheet.low
    near, far = paper.overlap + _GAP, paper.overlap + _GAP + _MARK
    ends = []
    for x, out_x in ((low[0], -1.0), (high[0], 1.0)):
        for y, out_y in ((low[1], -1.0), (high[1], 1.0)):
            ends.append([[x + out_x * near, y], [x + out_x * far, y]])
            ends.append([[x, y + out_y * near], [x, y + out_y * far]])
    pen.lines(np.array(ends), HAIR)


def _rulers(pen: Pen, sheet: Sheet, paper: Paper) -> None:
    """100 mm along the lower edge, and along the left one where a sheet is high enough."""
    start = np.array([paper.margin + 0.001, paper.margin + 0.0065])
    _ruler(pen, start, np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    if sheet.high[1] - sheet.low[1] > RULER + 4 * _MARK:
        start = np.array([paper.margin + 0.0032, sheet.at[1] + 2 * _MARK])
        _ruler(pen, start, np.array([0.0, 1.0]), np.array([-1.0, 0.0]))


def _ruler(pen: Pen, start: Array, along: Array, up: Array) -> None:
    """A ruler of 100 mm with a tick each mm; its base line is as long, ends included."""
    steps = np.arange(round(1e3 * RULER) + 1)
    high = np.select([steps % 10 == 0, steps % 5 == 0], [0.003, 0.002], 0.0012)
    feet = start + 1e-3 * steps[:, None] * along
    ticks = np.stack([feet, feet + high[:, None] * up], axis=1)
    pen.lines(np.concatenate([ticks, [[start, start + RULER * along]]]), HAIR)
    angle = float(np.arctan2(along[1], along[0]))
    for at, words, align in ((0.0, "0", 0.0), (0.5, "50", 0.5), (1.0, "100 mm", 1.0)):
        pen.text(start + at * RULER * along - 0.0024 * up, words, 0.0015, align=align, angle=angle)


def _footer(
    pen: Pen, drawing: Drawing, sheet: Sheet, head: tuple[str, str], rows: IntArray
) -> None:
    """The texts right of the ruler and a plan of the sheets in the corner."""
    paper = drawing.paper
    left, right = paper.margin + RULER + 0.006, sheet.paper[0] - paper.margin
    high = FOOTER - 0.002
    low, top = drawing.sheets.cuts[0][[0, -1]], drawing.sheets.cuts[1][[0, -1]]
    wide = min(high * (low[1] - low[0]) / (top[1] - top[0]), 0.03)
    if right - left > wide + 0.02 and len(drawing.sheets.sheets) > 1:
        right -= wide
        _plan(pen, drawing.sheets, sheet, np.array([right, paper.margin]), np.array([wide, high]))
        right -= 0.003
    ids = ", ".join(str(i) for i in drawing.plane.tag_map.tag_id[rows])
    tags = "tag" if len(rows) == 1 else "tags"
    size = f"actual size: rulers are 100 mm · overlap {1e3 * paper.overlap:g} mm"
    texts = (*head, size, f"{drawing.title} · {tags} {ids}")
    for i, words in enumerate(texts):
        at = (left, paper.margin + FOOTER - 0.0035 - 0.0031 * i)
        bold = i == 0
        pen.text(at, fitted(words, _BODY, right - left, bold), _BODY, bold=bold)


def place_of(plane: Plane, sheet: Sheet) -> str:
    """Where the sheet's lower left cut corner lies, in words."""
    parts = []
    for (label, sign), value in zip(plane.view.labels, sheet.low, strict=True):
        axis = label[0] if label.endswith("in W [m]") else "along"
        parts.append(f"{axis} {sign * value + 0.0:.4f} m")
    return f"lower left cut corner at {', '.join(parts)} in W"


def _plan(pen: Pen, sheets: Sheets, sheet: Sheet, at: Array, size: Array) -> None:
    """All sheets in small with this one filled, in a box of some size."""
    x, y = sheets.cuts
    scale = min(size[0] / (x[-1] - x[0]), size[1] / (y[-1] - y[0]))
    base = np.array([x[0], y[0]])

    def put(point: Array) -> Array:
        return np.asarray(at + scale * (point - base))

    pen.box(put(sheet.low), put(sheet.high), fill=(0.0, 0.0, 0.0))
    upright = [[[v, y[0]], [v, y[-1]]] for v in x]
    level = [[[x[0], v], [x[-1], v]] for v in y]
    pen.lines(put(np.array(upright + level)), HAIR, GREY)
