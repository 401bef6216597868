"""Draws tags, axes and grids onto one pair of page axes; `mapshow` makes the page of them."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.maps.draw.views import View, nice_step
from tagvo.tags.tag_map import TagMap, tag_corners

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Transform

INK, EDGE, GRID = "#222222", "#8A8A8A", "#E2E2E2"
AXES = ("#D0312D", "#1A9641", "#2255CC")  # x red, y green, z blue
_CLASSES = ("#56B4E9", "#E69F00", "#CC79A7", "#F0E442", "#0072B2", "#999999")  # Okabe and Ito
_MIN_FONT_PT = 3.0  # smaller ids are left out


def class_colours(count: int) -> list[str]:
    """A colour a size class that colour-blind readers tell apart, smallest class first."""
    if count <= len(_CLASSES):
        return list(_CLASSES[:count])
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [to_hex(colormaps["viridis"](x)) for x in np.linspace(0.4, 1.0, count)]


def limits(tag_map: TagMap, rows: IntArray, view: View) -> tuple[Array, Array]:
    """Page limits (2,), (2,) [m] of some tags, with W's origin where it is near."""
    points = view.project(_printed(tag_map, rows).reshape(-1, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    reach = 0.4 * float((high - low).max())
    if (low - reach < 0.0).all() and (high + reach > 0.0).all():
        low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
    if not view.frontal:
        floor = view.project(np.concatenate([line for _, _, line in _floor_lines(tag_map)]))
        low, high = np.minimum(low, floor.min(axis=0)), np.maximum(high, floor.max(axis=0))
    pad = 0.05 * float((high - low).max())
    return low - pad, high + pad


def _printed(tag_map: TagMap, rows: IntArray) -> Array:
    """Corners of the whole printed tags in W [m]; (n, 4, 3)."""
    corners_T = tag_corners(tag_map.total_size[rows])
    return geo.transform(tag_map.R_WT[rows, None], tag_map.p_WT[rows, None], corners_T)


def draw_tags(ax: "Axes", tag_map: TagMap, rows: IntArray, view: View) -> None:
    low, high = limits(tag_map, rows, view)
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    ax.apply_aspect()
    for spine in ax.spines.values():
        spine.set_visible(view.frontal)
        spine.set_color(EDGE)
    if view.frontal:
        _metric_grid(ax, view, high - low)
    else:
        ax.set_axis_off()
        _floor_grid(ax, tag_map, view)
    depth = tag_map.p_WT[rows] @ view.towards
    _squares(ax, tag_map, rows[np.argsort(depth, kind="stable")], view)
    _axes_of_world(ax, view, low, high)


def _metric_grid(ax: "Axes", view: View, extent: Array) -> None:
    from matplotlib.ticker import FuncFormatter, MultipleLocator

    long, short = float(extent.max()), float(extent.min())
    step = max(min(nice_step(long), nice_step(short, 4)), nice_step(long, 20))
    for axis, (label, sign) in zip((ax.xaxis, ax.yaxis), view.labels, strict=True):
        axis.set_major_locator(MultipleLocator(step))
        axis.set_major_formatter(FuncFormatter(lambda v, _, s=sign: f"{s * v + 0.0:.10g}"))
        axis.set_label_text(label, color=INK)
        axis.set_tick_params(colors=INK, labelsize=8)
    ax.grid(color=GRID, linewidth=0.8)
    ax.set_axisbelow(True)


def _floor_lines(tag_map: TagMap) -> list[tuple[int, float, Array]]:
    """Lines of a metric grid below the map: the axis they mark, its value [m], ends (2, 3) in W."""
    low, high = tag_map.p_WT.min(axis=0), tag_map.p_WT.max(axis=0)
    step = nice_step(float((high - low)[:2].max()))
    low[:2], high[:2] = step * np.floor(low[:2] / step), step * np.ceil(high[:2] / step)
    floor = min(float(low[2]), 0.0)
    lines = []
    for axis in (0, 1):
        for value in np.arange(low[axis], high[axis] + 0.5 * step, step):
            ends = np.array([[low[0], low[1], floor], [high[0], high[1], floor]])
            ends[:, axis] = value
            lines.append((axis, float(value), ends))
    return lines


def _floor_grid(ax: "Axes", tag_map: TagMap, view: View) -> None:
    """Draws the metric grid below the map, with W's x and y written along its near edges."""
    lines = _floor_lines(tag_map)
    last = {axis: value for axis, value, _ in lines}
    for axis, value, ends in lines:
        line = view.project(ends)
        ax.plot(line[:, 0], line[:, 1], color=GRID, linewidth=0.8, zorder=0)
        x, y = line[np.argmin(line[:, 1])]
        unit = f" m ({'xy'[axis]})" if value == last[axis] else ""
        side, shift = (("right", -2), ("left", 2))[axis]  # so that the two do not meet at a corner
        style: dict[str, Any] = {"ha": side, "va": "top", "fontsize": 8, "color": EDGE}
        text = f"{value + 0.0:.10g}{unit}"
        ax.annotate(text, (x, y), (shift, -4), textcoords="offset points", **style)


def _squares(ax: "Axes", tag_map: TagMap, rows: IntArray, view: View) -> None:
    from matplotlib.collections import LineCollection, PolyCollection
    from matplotlib.colors import to_rgba

    which = np.argmin(np.abs(tag_map.size[rows, None] - tag_map.classes), axis=1)
    front = tag_map.R_WT[rows, :, 2] @ view.towards > 0.0
    opaque = np.where(front, 1.0, 0.25)
    colours = class_colours(len(tag_map.classes))
    fill = [to_rgba(colours[c], a) for c, a in zip(which, opaque, strict=True)]
    paper = view.project(_printed(tag_map, rows))
    border = view.project(tag_map.corners_W[rows])
    per_metre = _points_per_metre(ax)
    thin = float(np.clip(0.03 * np.median(tag_map.size) * per_metre, 0.3, 0.8))
    ax.add_collection(
        PolyCollection(
            list(paper), facecolors="#FFFFFFB0", edgecolors=EDGE, linewidths=thin, zorder=2
        )
    )
    ax.add_collection(PolyCollection(list(border), facecolors=fill, edgecolors="none", zorder=3))
    for axis in (0, 1):
        ends = np.zeros((len(rows), 2, 3))  # along the lower and the left edge: the id stays free
        ends[:, :, :2] = -0.42
        ends[:, 1, axis] = 0.25
        ends *= tag_map.size[rows, None, None]
        lines = view.project(
            geo.transform(tag_map.R_WT[rows, None], tag_map.p_WT[rows, None], ends)
        )
        widths = np.clip(0.06 * tag_map.size[rows] * per_metre, 0.5, 3.0)
        shades = [to_rgba(AXES[axis], a) for a in opaque]
        ax.add_collection(LineCollection(list(lines), colors=shades, linewidths=widths, zorder=4))
    _write_ids(ax, tag_map, rows, view, front, per_metre)


def _points_per_metre(ax: "Axes") -> float:
    """Typographic points on the page for a metre of the map."""
    pixels = ax.transData.transform([[0.0, 0.0], [1.0, 0.0]])
    return float(pixels[1, 0] - pixels[0, 0]) * 72.0 / ax.figure.dpi


def _write_ids(
    ax: "Axes", tag_map: TagMap, rows: IntArray, view: View, front: BoolArray, per_metre: float
) -> None:
    centre = view.project(tag_map.p_WT[rows])
    width = np.ptp(view.project(tag_map.corners_W[rows]), axis=1).min(axis=1) * per_metre
    for i, row in enumerate(rows):
        text = str(tag_map.tag_id[row])
        font = min(1.1 * width[i] / len(text), 0.45 * width[i], 18.0)
        if font >= _MIN_FONT_PT:
            shade = INK if front[i] else "#AAAAAA"
            style: dict[str, Any] = {"ha": "center", "va": "center", "color": shade}
            ax.text(
                centre[i, 0], centre[i, 1], text, fontsize=font, zorder=10, clip_on=True, **style
            )


def _axes_of_world(ax: "Axes", view: View, low: Array, high: Array) -> None:
    """W's axes at its origin, or beside the lower right corner where the origin is off the page."""
    if (low <= 0.0).all() and (high >= 0.0).all():
        length = 0.9 * nice_step(float((high - low).max()), 12)
        _triad(ax, view, ax.transData, np.zeros(2), length)
        return
    from matplotlib.transforms import Affine2D, ScaledTranslation

    inches = ax.figure.dpi_scale_trans
    points = Affine2D().scale(1 / 72) + inches + ScaledTranslation(1, 0, ax.transAxes)  # type: ignore[arg-type]
    length = 26.0
    back = np.maximum(0.0, -view.page.min(axis=1)) * 1.3 * length  # room for arms to the left
    _triad(ax, view, points, back + np.array([14.0, 8.0]), length)


def _triad(ax: "Axes", view: View, place: "Transform", origin: Array, length: float) -> None:
    """W's three axes from an origin (2,), arms of that length, in the coordinates of `place`."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=3.0, foreground="white")]
    common: dict[str, Any] = {"transform": place, "clip_on": False}
    for axis, name in enumerate("xyz"):
        arm = view.page[:, axis] * length
        shade, (x, y) = AXES[axis], origin + 1.2 * arm
        if np.hypot(*arm) < 0.15 * length:  # along the line of sight: a dot comes, a cross goes
            mark: dict[str, Any] = (
                {"marker": ".", "ms": 6} if view.towards[axis] > 0.0 else {"marker": "x", "ms": 5}
            )
            disc: dict[str, Any] = {"marker": "o", "ms": 10, "mfc": "white", "mew": 1.6}
            ax.plot(origin[:1], origin[1:], color=shade, zorder=8, **disc, **common)
            ax.plot(origin[:1], origin[1:], color=shade, zorder=9, **mark, **common)
            continue
        tip, start = origin + arm, origin
        arrow = {"arrowstyle": "-|>", "color": shade, "lw": 2.0, "shrinkA": 0, "shrinkB": 0}
        ends: dict[str, Any] = {"xycoords": place, "textcoords": place, "annotation_clip": False}
        xy, text_xy = (tip[0], tip[1]), (start[0], start[1])
        ax.annotate("", xy, text_xy, arrowprops=arrow, zorder=7, **ends)
        style: dict[str, Any] = {"ha": "center", "va": "center", "fontweight": "bold"}
        ax.text(x, y, name, color=shade, zorder=8, path_effects=halo, **style, **common)
