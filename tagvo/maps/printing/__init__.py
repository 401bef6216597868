"""Prints a tag map at true size: vector pages to lay side by side, or one tag a sheet.

Every length on paper is that of the map. Black areas are outlines, not cells, so that no hairline
shows within a tag.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tagvo.geometry import Array
from tagvo.maps.printing.cutting import Paper, Sheet, Sheets, cut_plane
from tagvo.maps.printing.index import class_lines, draw_index, draw_list, list_pages
from tagvo.maps.printing.pen import Pen, text_width
from tagvo.maps.printing.plane import Number, numbers_beside, plane_of
from tagvo.maps.printing.sheet import Drawing, draw_sheet, place_of
from tagvo.tags.tag_map import TagMap
from tagvo.textfile import write_atomic

_WHITE = 0.002  # around the outermost tags [m]


@dataclass(frozen=True, slots=True)
class Print:
    """A print ready to be drawn: one drawing, or for `each` one a tag; what to say of it.

    without_number: ids that no place was found for; cut: tags on more than one sheet; flattened:
    by how much tags were moved onto the common plane at most [m].
    """

    drawings: tuple[Drawing, ...]
    each: bool
    without_number: tuple[int, ...]
    cut: int
    flattened: float

    @property
    def sheets(self) -> int:
        """Sheets in all, without the index."""
        return sum(len(d.sheets.sheets) for d in self.drawings)


def plan_print(
    tag_map: TagMap, paper: Paper, *, each: bool = False, numbers: bool = True, title: str = "map"
) -> Print:
    """What to print where; each: every tag in a plane of its own, on one sheet or more.

    Raises MapError where reportlab is missing, the paper is too small or the tags share no plane.
    """
    maps = [_alone(tag_map, row) for row in range(len(tag_map))] if each else [tag_map]
    drawings, without, cut, flattened = [], [], 0, 0.0
    for one in maps:
        plane = plane_of(one)
        found, bare = numbers_beside(plane, text_width) if numbers else ([], [])
        squares = plane.squares(np.arange(len(one)))
        low, high = _outline(squares, found)
        drawing = Drawing(plane, found, cut_plane(low, high, squares, paper), paper, title)
        drawings.append(drawing)
        without += [int(one.tag_id[row]) for row in bare]
        cut += _cut(drawing.sheets, squares)
        flattened = max(flattened, plane.flattened)
    return Print(tuple(drawings), each, tuple(without), cut, flattened)


def _alone(tag_map: TagMap, row: int) -> TagMap:
    """One tag of a map, upright at the origin of a plane of its own."""
    one = tag_map.only(tag_map.tag_id[[row]])
    return replace(one, p_WT=np.zeros((1, 3)), R_WT=np.eye(3)[None])


def _outline(squares: Array, numbers: list[Number]) -> tuple[Array, Array]:
    """The rectangle around all prints and numbers, from (2,) to (2,)."""
    low = np.min([*squares[:, 0], *(n.low for n in numbers)], axis=0) - _WHITE
    high = np.max([*squares[:, 1], *(n.high for n in numbers)], axis=0) + _WHITE
    return low, high


def _cut(sheets: Sheets, squares: Array) -> int:
    """How many squares (n, 2, 2) a cut goes through."""
    cut = np.zeros(len(squares), dtype=bool)
    for axis, cuts in enumerate(sheets.cuts):
        for line in cuts[1:-1]:
            low, high = squares[:, 0, axis], squares[:, 1, axis]
            cut |= (low < line - 1e-6) & (high > line + 1e-6)
    return int(cut.sum())


def draw_print(
    ready: Print, path: Path, *, index: bool = True, step: Callable[[], None] = lambda: None
) -> int:
    """Write the PDF, whole or not at all; -> its pages. `step` is called after each sheet."""
    title = ready.drawings[0].title
    pen = Pen(title)
    before = (list_pages(len(ready.drawings)) if ready.each else 1) if index else 0
    if index and ready.each:
        draw_list(pen, ready.drawings, title, before + 1)
    elif index:
        draw_index(pen, ready.drawings[0], before + 1)
    last = before + ready.sheets
    for drawing in ready.drawings:
        for sheet in drawing.sheets.sheets:
            head, note = _words(drawing, sheet, ready.each)
            draw_sheet(pen, drawing, sheet, f"{head} · page {pen.pages + 1} of {last}", note)
            step()
    write_atomic(path, pen.done())
    return last


def _words(drawing: Drawing, sheet: Sheet, each: bool) -> tuple[str, str]:
    """Headline of a sheet, and what lies below it."""
    if not each:
        return f"Sheet {sheet.name}", place_of(drawing.plane, sheet)
    m = drawing.plane.tag_map
    head = f"Tag {m.tag_id[0]}"
    if len(drawing.sheets.sheets) > 1:
        head += f" · sheet {sheet.name}"
    return head, f"{m.family.name} · {class_lines(m)[0].removesuffix(': 1 tags')}"
