"""The first page of a printed map: which sheet lies where, and how to put them together."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array
from tagvo.maps.check import size_classes
from tagvo.maps.draw.views import nice_step
from tagvo.maps.printing.cutting import PAPERS
from tagvo.maps.printing.pen import Colour, Pen, fitted, text_width
from tagvo.maps.printing.sheet import GREY, HAIR, THIN, Drawing
from tagvo.tags.tag_map import TagMap

_MARGIN = 0.015  # of the page [m]
_LEFT, _BELOW = 0.010, 0.014  # room for the plan's axes
_TOP, _FOOT = 0.033, 0.064  # of the page, for the headline and for what stands below the plan
_RED: Colour = (0.816, 0.192, 0.176)
_GREEN: Colour = (0.102, 0.588, 0.255)
_BLUE: Colour = (0.133, 0.333, 0.800)
_PALE: Colour = (0.90, 0.90, 0.90)
_DARK: Colour = (0.70, 0.70, 0.70)
_WHITE: Colour = (1.0, 1.0, 1.0)
_BODY, _SMALL = 0.0022, 0.0019  # heights of capitals [m]
_COLUMNS, _LINES, _LINE = 4, 60, 0.004  # of the list of tags


@dataclass(frozen=True, slots=True, eq=False)
class _Plan:
    """From the plane [m] to the page: page = at + scale (plane - base)."""

    at: Array
    base: Array
    scale: float

    def __call__(self, points: Array) -> Array:
        return np.asarray(self.at + self.scale * (points - self.base))


def draw_index(pen: Pen, drawing: Drawing, first_page: int) -> None:
    """The index on an A4 page of its own; `first_page` is that of the first sheet."""
    size = PAPERS["A4"]
    pen.page(size)
    pen.mark("Index of sheets")
    _headline(pen, drawing, size)
    plan = _plan(drawing, size)
    _tags(pen, drawing, plan)
    _sheet_names(pen, drawing, plan, first_page)
    _world(pen, drawing, plan)
    _how_to(pen, drawing, size)


def _headline(pen: Pen, drawing: Drawing, size: tuple[float, float]) -> None:
    tag_map = drawing.plane.tag_map
    room = size[0] - 2 * _MARGIN
    pen.text(
        (_MARGIN, size[1] - 0.020),
        fitted(drawing.title, 0.0045, room, bold=True),
        0.0045,
        bold=True,
    )
    text = (
        f"{len(tag_map)} {'tag' if len(tag_map) == 1 else 'tags'} of {tag_map.family.name} ·"
        f" {sheets_in_words(drawing)}"
    )
    pen.text((_MARGIN, size[1] - 0.026), fitted(text, 0.0024, room), 0.0024)


def sheets_in_words(drawing: Drawing) -> str:
    """Such as `20 sheets of A0 (841 x 1189 mm)`."""
    sheets = drawing.sheets.sheets
    w, h = (1e3 * side for side in sheets[0].paper)
    many = f"{len(sheets)} sheet{'s' if len(sheets) > 1 else ''}"
    longest = " at most" if len({s.paper for s in sheets}) > 1 else ""
    return f"{many} of {drawing.paper.name} ({w:.0f} × {h:.0f} mm{longest})"


def _plan(drawing: Drawing, size: tuple[float, float]) -> _Plan:
    x, y = drawing.sheets.cuts
    room = np.array([size[0] - 2 * _MARGIN - _LEFT, size[1] - _TOP - _FOOT - _BELOW])
    extent = np.array([x[-1] - x[0], y[-1] - y[0]])
    scale = float((room / extent).min())
    left, bottom = 0.5 * (room - scale * extent)
    at = np.array([_MARGIN + _LEFT + left, _FOOT + _BELOW + bottom])
    return _Plan(at, np.array([x[0], y[0]]), scale)


def _tags(pen: Pen, drawing: Drawing, plan: _Plan) -> None:
    """Each print pale, its border square darker with the number in it."""
    plane = drawing.plane
    for frames, colour in ((plane.total, _PALE), (plane.tag_map.size, _DARK)):
        for corners in plan(plane.frames(frames)):
            pen.fill([corners], colour)
    border = plan.scale * plane.tag_map.size
    for at, number, side in zip(plan(plane.at), plane.tag_map.tag_id, border, strict=True):
        height = min(0.62 * side / max(len(str(number)), 2) / 0.78, 0.004)
        pen.text((at[0], at[1] - 0.5 * height), str(number), height, align=0.5)


def _sheet_names(pen: Pen, drawing: Drawing, plan: _Plan, first_page: int) -> None:
    """The cuts, and in the upper left of each sheet its name and page on white."""
    x, y = drawing.sheets.cuts
    upright = [[[v, y[0]], [v, y[-1]]] for v in x]
    level = [[[x[0], v], [x[-1], v]] for v in y]
    pen.lines(plan(np.array(upright + level)), THIN, _BLUE)
    for i, sheet in enumerate(drawing.sheets.sheets):
        wide, high = plan.scale * (sheet.high - sheet.low)
        page = f"p. {first_page + i}"
        per_height = max(text_width(sheet.name, 1.0, bold=True), 0.55 * text_width(page, 1.0))
        tall = min(0.0026, 0.16 * high, 0.85 * wide / (per_height + 0.5))
        x_left, y_top = plan(np.array([sheet.low[0], sheet.high[1]])) + np.array([0.0004, -0.0004])
        low = (x_left, y_top - 2.5 * tall)
        pen.box(low, (x_left + (per_height + 0.5) * tall, y_top), fill=_WHITE)
        name, number = (low[0] + 0.25 * tall, low[1] + 1.25 * tall), (low[0] + 0.25 * tall, low[1])
        pen.text(name, sheet.name, tall, bold=True, colour=_BLUE)
        pen.text((number[0], number[1] + 0.3 * tall), page, 0.55 * tall, colour=_BLUE)


def _world(pen: Pen, drawing: Drawing, plan: _Plan) -> None:
    """Ticks along the plan in coordinates of W, and W's axes where its origin is near."""
    view = drawing.plane.view
    low = np.array([c[0] for c in drawing.sheets.cuts])
    high = np.array([c[-1] for c in drawing.sheets.cuts])
    step = nice_step(float((high - low).max()), 10)
    for axis, (label, sign) in enumerate(view.labels):
        values = step * np.arange(np.ceil(low[axis] / step), np.floor(high[axis] / step) + 1)
        for value in values:
            x, y = plan(np.where(np.arange(2) == axis, value, low))
            words = f"{sign * value + 0.0:.10g}"
            if axis == 0:
                pen.lines(np.array([[[x, y], [x, y - 0.0015]]]), HAIR)
                pen.text((x, y - 0.0042), words, _SMALL, align=0.5)
            else:
                pen.lines(np.array([[[x, y], [x - 0.0015, y]]]), HAIR)
                pen.text((x - 0.0022, y - 0.5 * _SMALL), words, _SMALL, align=1.0)
        x, y = plan(np.where(np.arange(2) == axis, 0.5 * (low + high), low))
        if axis == 0:
            pen.text((x, y - 0.0085), label, _BODY, align=0.5)
        else:
            pen.text((x - 0.0105, y), label, _BODY, align=0.5, angle=0.5 * np.pi)
    reach = 0.25 * float((high - low).max())
    if (low - reach < 0.0).all() and (high + reach > 0.0).all():
        _axes(pen, drawing, plan(np.zeros(2)))


def _axes(pen: Pen, drawing: Drawing, origin: Array) -> None:
    """W's axes that lie in the page, with arrow heads, and its origin."""
    for axis, (name, colour) in enumerate((("x", _RED), ("y", _GREEN), ("z", _BLUE))):
        way = drawing.plane.view.page[:, axis]
        if np.hypot(*way) < 0.5:
            continue
        side = 0.0012 * np.array([-way[1], way[0]])
        tip, neck = origin + 0.016 * way, origin + 0.013 * way
        pen.lines(np.array([[origin, neck]]), 0.0006, colour)
        pen.fill([np.stack([tip, neck + side, neck - side])], colour)
        x, y = tip + 0.0022 * way
        pen.text((x, y - 0.0011), name, 0.0024, bold=True, colour=colour, align=0.5)
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    pen.fill([origin + 0.0011 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)])
    pen.text((origin[0] - 0.0018, origin[1] - 0.0034), "W", 0.0024, bold=True, align=1.0)


def _how_to(pen: Pen, drawing: Drawing, size: tuple[float, float]) -> None:
    """The classes on the left and the steps on the right, below the plan."""
    top = _FOOT - 0.006
    pen.lines(np.array([[[_MARGIN, _FOOT], [size[0] - _MARGIN, _FOOT]]]), HAIR, GREY)
    pen.text((_MARGIN, top), "Sizes", _BODY, bold=True)
    for i, words in enumerate(class_lines(drawing.plane.tag_map)[:8]):
        pen.text((_MARGIN, top - 0.0045 * (i + 1)), words, _SMALL)
    overlap = 1e3 * drawing.paper.overlap
    steps: Sequence[str] = (
        "1  Print at actual size (100 %); no fitting, no scaling.",
        "2  Measure both rulers of a sheet: 100 mm along and across the feed.",
        f"3  Sheets show {overlap:g} mm more than their part where a neighbour follows.",
        "4  Of two neighbours cut one at its crop marks, from mark to mark, and lay",
        "    its edge on the other's crop marks. The outer edges may stay.",
        "5  The lower left cut corner of each sheet is written at its foot, in W.",
        "6  Matt paper; glossy foil mirrors lamps.",
    )
    if len(drawing.sheets.sheets) == 1:
        steps = (*steps[:2], "3  " + steps[6][3:])
    left = 0.5 * size[0] - 0.008
    pen.text((left, top), "How to lay it", _BODY, bold=True)
    for i, words in enumerate(steps):
        pen.text((left, top - 0.0045 * (i + 1)), words, _SMALL)


def class_lines(tag_map: TagMap) -> list[str]:
    """A line a size class, the largest first."""
    return [
        f"border {1e3 * c.border:.4g} mm, total {1e3 * c.total:.4g} mm: {c.count} tags"
        for c in reversed(size_classes(tag_map))
    ]


def list_pages(entries: int) -> int:
    """How many pages `draw_list` takes."""
    return -(-entries // (_COLUMNS * _LINES))


def draw_list(pen: Pen, drawings: Sequence[Drawing], title: str, first_page: int) -> None:
    """Which tag is on which page, for tags one a sheet; `list_pages` A4 pages."""
    page, many = first_page, _COLUMNS * _LINES
    for start in range(0, len(drawings), many):
        _list_head(pen, f"{title} · {len(drawings)} tags, one a sheet")
        for i, drawing in enumerate(drawings[start : start + many]):
            column, line = divmod(i, _LINES)
            sheets = len(drawing.sheets.sheets)
            pages = f"p. {page}" if sheets == 1 else f"p. {page} to {page + sheets - 1}"
            tag_map = drawing.plane.tag_map
            words = f"tag {tag_map.tag_id[0]}, {1e3 * tag_map.size[0]:.4g} mm: {pages}"
            width = (PAPERS["A4"][0] - 2 * _MARGIN) / _COLUMNS
            at = (_MARGIN + column * width, PAPERS["A4"][1] - 0.036 - line * _LINE)
            pen.text(at, fitted(words, _SMALL, width - 0.002), _SMALL)
            page += sheets


def _list_head(pen: Pen, head: str) -> None:
    size = PAPERS["A4"]
    pen.page(size)
    pen.mark("Index of tags")
    room = size[0] - 2 * _MARGIN
    pen.text((_MARGIN, size[1] - 0.020), fitted(head, 0.0040, room, bold=True), 0.0040, bold=True)
    text = "Print at actual size (100 %) and measure both rulers of a sheet: 100 mm."
    pen.text((_MARGIN, size[1] - 0.026), text, _BODY)
