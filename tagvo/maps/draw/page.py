"""Draws a tag map to PNG or SVG, so that a person sees at a glance what the file says.

A map on one surface is drawn from its front; any other one in a parallel view from above a corner,
with a panel from the front for each surface. Needs matplotlib, which is imported late, headless.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tagvo.errors import MapError
from tagvo.geometry import IntArray
from tagvo.maps.check import size_classes
from tagvo.maps.draw.tags import AXES, EDGE, INK, class_colours, draw_tags, limits
from tagvo.maps.draw.views import View, corner_view, frontal_view, surface_name, surfaces_of
from tagvo.tags.tag_map import TagMap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MAX_PANELS = 8
_MARGIN_IN, _TOP_IN, _GAP_IN = 0.9, 0.6, 0.9  # room for labels, headline, between panels [inch]
_PANEL_IN = 7.0  # width of a panel
_LONGEST_IN, _SHORTEST_IN = 18.0, 6.5  # sides of a page between which the scale is chosen
_TAG_PT = 20.0  # the smallest tag should come out this wide [pt]


def draw_map(tag_map: TagMap, path: Path, title: str | None = None) -> None:
    """Draw a map to a .png or .svg file: tags, ids, axes, metric grid, legend of the classes."""
    suffix = path.suffix.lower()
    if suffix not in (".png", ".svg"):
        raise MapError(f"{path}: cannot draw to {suffix!r}; a name in .png or .svg is needed")
    try:
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MapError("drawing a map needs matplotlib: pip install matplotlib") from None
    style: Any = {"font.family": "DejaVu Sans", "svg.fonttype": "none", "svg.hashsalt": "tagvio"}
    with rc_context(style):
        figure = Figure(facecolor="white")
        FigureCanvasAgg(figure)
        _lay_out(figure, tag_map)
        _headline(figure, tag_map, title)
        _legend(figure, tag_map)
        path.parent.mkdir(parents=True, exist_ok=True)
        keep = {"Date": None} if suffix == ".svg" else None
        figure.savefig(path, dpi=150, bbox_inches="tight", pad_inches=0.15, metadata=keep)


def _headline(figure: "Figure", tag_map: TagMap, title: str | None) -> None:
    name = title if title is not None else "/".join(Path(tag_map.source).parts[-2:])
    bits = f", border of {tag_map.border_bits} bits" if tag_map.border_bits != 1 else ""
    head = f"{name} · {len(tag_map)} tags of {tag_map.family.name}{bits}"
    y = 1.0 - 0.35 / figure.get_figheight()
    figure.text(0.5, y, head, ha="center", color=INK, fontsize=13)


def _lay_out(figure: "Figure", tag_map: TagMap) -> None:
    surfaces = surfaces_of(tag_map)
    everything = np.arange(len(tag_map))
    if len(surfaces) == 1:
        view = frontal_view(tag_map, everything)
        w, h = _page_size(tag_map, view)
        figure.set_size_inches(w, h)
        wide, high = 1 - 2 * _MARGIN_IN / w, 1 - (_TOP_IN + _MARGIN_IN) / h
        axes = figure.add_axes((_MARGIN_IN / w, _MARGIN_IN / h, wide, high))
        draw_tags(axes, tag_map, everything, view)
    else:
        _lay_out_surfaces(figure, tag_map, surfaces)


def _lay_out_surfaces(figure: "Figure", tag_map: TagMap, surfaces: list[IntArray]) -> None:
    """The whole map above, a panel a surface below, two in a row."""
    everything = np.arange(len(tag_map))
    panels = [(rows, frontal_view(tag_map, rows)) for rows in surfaces[:_MAX_PANELS]]
    heights = [_height(tag_map, rows, view, _PANEL_IN) for rows, view in panels]
    bands = [max(heights[i : i + 2]) for i in range(0, len(heights), 2)]
    bands.insert(0, _height(tag_map, everything, corner_view(), 2 * _PANEL_IN))
    gaps = _GAP_IN * (len(bands) - 1)
    w, h = 2 * _PANEL_IN + 3 * _MARGIN_IN, sum(bands) + gaps + _TOP_IN + 0.3 + _MARGIN_IN
    figure.set_size_inches(w, h)
    top = h - _TOP_IN - 0.3
    for i, (rows, view) in enumerate([(everything, corner_view()), *panels]):
        band, column = (0, 0) if i == 0 else (1 + (i - 1) // 2, (i - 1) % 2)
        y = top - sum(bands[: band + 1]) - _GAP_IN * band
        x = _MARGIN_IN + column * (_PANEL_IN + _MARGIN_IN)
        wide = 2 * _PANEL_IN + _MARGIN_IN if i == 0 else _PANEL_IN
        axes = figure.add_axes((x / w, y / h, wide / w, bands[band] / h))
        draw_tags(axes, tag_map, rows, view)
        head = f"{len(rows)} tags {surface_name(view)}" if i else "from above (pale: from behind)"
        axes.set_title(head, color=INK, fontsize=10)


def _height(tag_map: TagMap, rows: IntArray, view: View, width: float) -> float:
    """Height [inch] that a view takes on a width, within reason."""
    low, high = limits(tag_map, rows, view)
    wide, tall = high - low
    return float(np.clip(width * tall / wide, 0.2 * width, 0.75 * width))


def _page_size(tag_map: TagMap, view: View) -> tuple[float, float]:
    """Width and height [inch] of a page on which the smallest tag can still be read."""
    low, high = limits(tag_map, np.arange(len(tag_map)), view)
    extent = high - low
    scale = _TAG_PT / 72.0 / float(tag_map.size.min())
    scale = float(np.clip(scale, _SHORTEST_IN / extent.max(), _LONGEST_IN / extent.max()))
    width, height = np.maximum(extent * scale, 1.2)
    return max(float(width) + 2 * _MARGIN_IN, 8.0), float(height) + _MARGIN_IN + _TOP_IN


def _legend(figure: "Figure", tag_map: TagMap) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    classes = size_classes(tag_map)
    handles: list[Patch | Line2D] = [
        Patch(facecolor=colour, label=_class_text(c.border, c.total, c.count))
        for colour, c in zip(class_colours(len(classes)), classes, strict=True)
    ]
    handles.append(Patch(facecolor="white", edgecolor=EDGE, label="whole print (total)"))
    for colour, axis in zip(AXES[:2], "xy", strict=True):
        handles.append(Line2D([], [], color=colour, lw=3, label=f"{axis} of the tag"))
    columns = len(handles) if len(handles) <= 4 else 3
    style: dict[str, Any] = {"fontsize": 9, "frameon": False, "labelcolor": INK}
    figure.legend(
        handles=handles, loc="upper center", ncols=columns, bbox_to_anchor=(0.5, 0.0), **style
    )


def _class_text(border: float, total: float, count: int) -> str:
    tags = "1 tag" if count == 1 else f"{count} tags"
    return f"{1e3 * border:.4g} mm border, {1e3 * total:.4g} mm total: {tags}"
