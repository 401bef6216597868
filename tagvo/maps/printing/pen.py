"""Draws true-size vector pages in metres; the one place that knows reportlab.

Coordinates run from a page's lower left corner to the right and up; sizes of text are the heights
of its capitals.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from io import BytesIO
from typing import Any, TypeAlias

import numpy as np

from tagvo.errors import MapError
from tagvo.geometry import Array

Colour: TypeAlias = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
_PT = 72.0 / 0.0254  # points a metre
_CAPITAL = 0.718  # height of Helvetica's capitals and digits, in ems
_FACES = {False: "Helvetica", True: "Helvetica-Bold"}


class Pen:
    """A PDF that grows page by page in memory; `done` closes it."""

    def __init__(self, title: str) -> None:
        _reportlab("rl_config").useA85 = 0  # as text a quarter more bytes, a fifth more time
        self._buffer = BytesIO()
        self._canvas: Any = _reportlab("pdfgen.canvas").Canvas(
            self._buffer, pageCompression=1, invariant=1
        )
        self._canvas.setTitle(_plain(title))
        self._canvas.setCreator("tagvio map print")
        self._canvas.setViewerPreference("PrintScaling", "None")  # viewers offer actual size
        self.pages = 0

    def page(self, size: tuple[float, float]) -> None:
        """Begin a page of that width and height [m]."""
        if self.pages:
            self._canvas.showPage()
        self._canvas.setPageSize((size[0] * _PT, size[1] * _PT))
        self.pages += 1

    def mark(self, name: str) -> None:
        """Give the page an entry in the outline that viewers show beside it."""
        key = f"page{self.pages}"
        self._canvas.bookmarkPage(key)
        self._canvas.addOutlineEntry(_plain(name), key)

    def done(self) -> bytes:
        """The whole file."""
        self._canvas.save()
        return self._buffer.getvalue()

    @contextmanager
    def clipped(self, low: Array, high: Array) -> Iterator[None]:
        """Within it nothing is drawn outside the rectangle from low to high (2,)."""
        self._canvas.saveState()
        path = self._canvas.beginPath()
        path.rect(*(low * _PT), *((high - low) * _PT))
        self._canvas.clipPath(path, stroke=0, fill=0)
        yield
        self._canvas.restoreState()

    def fill(self, loops: Iterable[Array], colour: Colour = BLACK) -> None:
        """Fill the area between outlines (k, 2) as one path; holes run the other way round."""
        path = self._canvas.beginPath()
        for loop in loops:
            points = (loop * _PT).tolist()
            path.moveTo(*points[0])
            for point in points[1:]:
                path.lineTo(*point)
            path.close()
        self._canvas.setFillColorRGB(*colour) if colour != BLACK else self._canvas.setFillGray(0)
        self._canvas.drawPath(path, stroke=0, fill=1, fillMode=1)

    def lines(self, ends: Array, width: float, colour: Colour = BLACK) -> None:
        """Straight lines (n, 2, 2) of a width [m]."""
        self._stroke(width, colour)
        self._canvas.lines((np.reshape(ends, (-1, 4)) * _PT).tolist())

    def box(
        self,
        low: Sequence[float] | Array,
        high: Sequence[float] | Array,
        *,
        fill: Colour | None = None,
        line: Colour | None = None,
        width: float = 0.0002,
    ) -> None:
        """A rectangle from low to high (2,), filled or outlined or both."""
        if fill is not None:
            self._canvas.setFillColorRGB(*fill)
        self._stroke(width, line or BLACK)
        low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
        sides = ((high - low) * _PT).tolist()
        style = {"stroke": int(line is not None), "fill": int(fill is not None)}
        self._canvas.rect(*(low * _PT).tolist(), *sides, **style)

    def text(
        self,
        at: Sequence[float] | Array,
        words: str,
        height: float,
        *,
        bold: bool = False,
        colour: Colour = BLACK,
        align: float = 0.0,
        angle: float = 0.0,
    ) -> None:
        """Words from a point of their base line; align 0 begins there, 0.5 centres, 1 ends."""
        words = _plain(words)
        self._canvas.saveState()
        self._canvas.translate(float(at[0]) * _PT, float(at[1]) * _PT)
        self._canvas.rotate(float(np.degrees(angle)))
        self._canvas.setFont(_FACES[bold], height * _PT / _CAPITAL)
        self._canvas.setFillColorRGB(*colour)
        self._canvas.drawString(-align * text_width(words, height, bold) * _PT, 0.0, words)
        self._canvas.restoreState()

    def _stroke(self, width: float, colour: Colour) -> None:
        self._canvas.setLineWidth(width * _PT)
        self._canvas.setStrokeColorRGB(*colour)


def text_width(words: str, height: float, bold: bool = False) -> float:
    """How wide words come out [m]; MapError where reportlab is missing."""
    measured = _reportlab("pdfbase.pdfmetrics").stringWidth
    return float(measured(_plain(words), _FACES[bold], height * _PT / _CAPITAL)) / _PT


def fitted(words: str, height: float, room: float, bold: bool = False) -> str:
    """As much of the words as fits into a room [m], with an ellipsis where some do not."""
    if text_width(words, height, bold) <= room:
        return words
    while words and text_width(words + "…", height, bold) > room:
        words = words[:-1]
    return words.rstrip(" ,") + "…" if words else ""


def _reportlab(module: str) -> Any:
    """A module of reportlab; MapError says how to install it."""
    try:
        return import_module(f"reportlab.{module}")
    except ImportError:
        raise MapError(
            "printing a map needs reportlab, which is not installed:"
            " pip install 'tagvio[print]', or pip install reportlab"
        ) from None


def _plain(words: str) -> str:
    """What the standard fonts can show of a text; the rest becomes question marks."""
    return words.encode("cp1252", "replace").decode("cp1252")
