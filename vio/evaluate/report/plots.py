"""Draws what the report shows: each function turns records into one plotly figure."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.tags.tag_map import TagMap
from vio.evaluate.compare import Judged
from vio.evaluate.filter_log import FilterLog
from vio.evaluate.moved_tags import Judgement
from vio.evaluate.records import Errors
from vio.evaluate.report.polylines import band, in_time, path_in_time, tag_outlines, thin
from vio.evaluate.report.verdict import label
from vio.evaluate.tag_sightings import Sightings
from vio.evaluate.truth import TruthTrack

COLORS = {"vo": "#56B4E9", "vo_fir": "#009E73", "vo_kf": "#CC79A7", "vio": "#D55E00"}  # Okabe-Ito
OTHER_COLOR = "#E69F00"
TRUTH_COLOR = "#000000"  # the page turns it to light ink in the dark
GREY = "#808080"
SUSPECT_COLOR = "#CC3311"
_CLASSES = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")  # Okabe-Ito
_UNITS = ((1e3, "mm"), (180.0 / np.pi, "deg"))
_XYZ, _RXYZ = ("x", "y", "z"), ("rx", "ry", "rz")
_BAND = {
    "fill": "toself",
    "fillcolor": "rgba(128,128,128,0.28)",
    "line": {"width": 1, "color": GREY},
    "hoverinfo": "skip",
    "legendgroup": "band",
}


def color(name: str) -> str:
    """The colour of an estimator in every plot."""
    return COLORS.get(name, OTHER_COLOR)


def trajectory_figure(judged: Sequence[Judged], truth: TruthTrack, tag_map: TagMap | None) -> Any:
    """Paths in W over the outlines of the tags."""
    import plotly.graph_objects as go

    fig = go.Figure()
    if tag_map is not None:
        outline, names = tag_outlines(tag_map)
        fig.add_trace(
            _path3d(outline, "tags", {"color": GREY, "width": 2}, text=names, hoverinfo="text")
        )
    ink = {"color": TRUTH_COLOR, "width": 4}
    fig.add_trace(_path3d(path_in_time(truth.t_ns, truth.p_WI), "truth", ink, meta="ink"))
    for one in judged:
        path = path_in_time(one.trajectory.t_ns, one.trajectory.p_WI)
        name = one.trajectory.name
        fig.add_trace(_path3d(path, label(name), {"color": color(name), "width": 3}))
    fig.update_layout(
        height=560,
        scene={
            "aspectmode": "data",
            "xaxis_title": "x m",
            "yaxis_title": "y m",
            "zaxis_title": "z m",
            "camera": {"eye": {"x": 1.6, "y": 1.6, "z": 1.2}, "up": _up(tag_map)},
        },
    )
    return fig


def error_figure(judged: Sequence[Judged], t_zero_ns: int) -> Any:
    """Size of the position and rotation error over time; the live view waits in the legend."""
    fig = _rows(("position mm", "rotation deg"), height=460)
    for one in judged:
        for view, errors in (("capture", one.capture), ("now", one.now)):
            _add_sizes(fig, errors, one.trajectory.name, view, t_zero_ns)
    return fig


def axis_figure(errors: Errors, name: str, part: int, t_zero_ns: int) -> Any:
    """Error along each axis with its band of 3 sigma; part 0: position in W, 1: rotation in I."""
    factor, unit = _UNITS[part]
    values = (errors.p_W, errors.rotation_I)[part] * factor
    fig = _rows(tuple(f"{axis} {unit}" for axis in (_XYZ, _RXYZ)[part]), height=460)
    for k in range(values.shape[1]):
        first = {"showlegend": k == 0}
        t_s, y = thin(*in_time(errors.t_ns, values[:, k], t_zero_ns))
        line = {"color": color(name), "width": 1.5}
        fig.add_trace(_curve(t_s, y, name=label(name), line=line, **first), row=k + 1, col=1)
        if errors.cov is not None:
            variance = errors.cov[:, 3 * part + k, 3 * part + k]
            sigma = np.sqrt(np.where(variance >= 0.0, variance, np.nan)) * factor
            x, y = band(*in_time(errors.t_ns, 3.0 * sigma, t_zero_ns))
            fig.add_trace(_curve(x, y, name="3 sigma", **_BAND, **first), row=k + 1, col=1)
    return fig


def tags_figure(t_ns: IntArray, count: IntArray, t_zero_ns: int) -> Any:
    """Number of tags used in each frame over time; (m,), (m,)."""
    import plotly.graph_objects as go

    t_s, y = thin(*in_time(t_ns, count.astype(float), t_zero_ns))
    line = {"color": color("vo"), "width": 1.5, "shape": "hv"}
    fig = go.Figure(_curve(t_s, y, line=line, name="tags", showlegend=False))
    fig.update_layout(height=240, xaxis_title="t s", yaxis_title="tags")
    fig.update_yaxes(rangemode="tozero")
    return fig


def timing_figure(timing_ms: Mapping[str, Mapping[str, float | None]]) -> Any:
    """Median (bar) and 99th percentile (mark) of each stage's time."""
    import plotly.graph_objects as go

    stages = list(timing_ms)[::-1]
    p50, p99 = ([timing_ms[s].get(k) for s in stages] for k in ("p50", "p99"))
    bars = go.Bar(x=p50, y=stages, orientation="h", name="median", marker_color=COLORS["vo"])
    style = {"symbol": "line-ns-open", "size": 16, "color": COLORS["vio"], "line": {"width": 3}}
    marks = go.Scatter(x=p99, y=stages, mode="markers", name="99 % are faster", marker=style)
    fig = go.Figure([bars, marks])
    fig.update_layout(height=140 + 34 * len(stages), xaxis_title="ms a frame")
    fig.update_xaxes(rangemode="tozero")
    return fig


def classes_figure(seen: Sightings, tag_map: TagMap, t_zero_ns: int) -> Any:
    """Number of tags of each size in each frame that was kept."""
    import plotly.graph_objects as go

    fig = go.Figure()
    sizes = np.round(tag_map.size[seen.row], 6)
    for k, size in enumerate(tag_map.classes):
        count = np.bincount(seen.frame[sizes == size], minlength=len(seen.t_ns))
        t_s, y = thin(*in_time(seen.t_ns, count.astype(float), t_zero_ns))
        line = {"color": _CLASSES[k % len(_CLASSES)], "width": 1.5, "shape": "hv"}
        fig.add_trace(_curve(t_s, y, line=line, name=f"{100 * size:.3g} cm"))
    fig.update_layout(height=260, xaxis_title="t s", yaxis_title="tags seen")
    fig.update_yaxes(rangemode="tozero")
    return fig


def belief_figure(
    t_ns: IntArray, value: Array, sigma: Array, unit: tuple[float, str], t_zero_ns: int
) -> Any:
    """A belief of the filter over time with its 3 sigma, a line an axis; (n, k), (n, k)."""
    import plotly.graph_objects as go

    factor, title = unit
    fig = go.Figure()
    for k in range(value.shape[1]):
        tint = _CLASSES[k % len(_CLASSES)]
        mid, half = factor * value[:, k], 3.0 * factor * sigma[:, k]
        for edge in (mid - half, mid + half):
            t_s, y = in_time(t_ns, edge, t_zero_ns)
            line = {"color": tint, "width": 0.7, "dash": "dot"}
            fig.add_trace(_curve(*thin(t_s, y), line=line, showlegend=False, hoverinfo="skip"))
        name = "xyz"[k] if value.shape[1] == 3 else "offset"
        t_s, y = in_time(t_ns, mid, t_zero_ns)
        fig.add_trace(_curve(*thin(t_s, y), line={"color": tint, "width": 1.5}, name=name))
    late = slice(len(t_ns) // 10, None)  # the first moments' width would hide the rest
    spread = factor * np.abs(value[late]) + 3.0 * factor * sigma[late]
    limit = float(spread.max()) if spread.size else 1.0
    fig.update_layout(height=260, xaxis_title="t s", yaxis_title=title)
    fig.update_yaxes(range=[-1.1 * limit, 1.1 * limit])
    return fig


def nis_figure(filter_log: FilterLog, t_zero_ns: int) -> Any:
    """NIS of each frame's pose per degree of freedom, with the two-sided 95 % of chi-square."""
    import plotly.graph_objects as go
    from scipy.stats import chi2

    t_s, y = thin(*in_time(filter_log.t_ns, filter_log.nis, t_zero_ns))
    fig = go.Figure(_curve(t_s, y, line={"color": color("vio"), "width": 1}, showlegend=False))
    for bound in chi2.ppf([0.025, 0.975], 6) / 6.0:
        fig.add_hline(y=float(bound), line={"color": GREY, "dash": "dash", "width": 1})
    fig.update_layout(height=240, xaxis_title="t s", yaxis_title="NIS / 6")
    fig.update_yaxes(rangemode="tozero")
    return fig


def add_blackouts(fig: Any, stretches: Sequence[tuple[int, int]], t_zero_ns: int) -> bool:
    """Shade stretches of time [ns] behind both rows of an error figure; whether there were any."""
    shade = {"type": "rect", "y0": 0.0, "y1": 1.0, "fillcolor": GREY, "opacity": 0.18}
    style = shade | {"line": {"width": 0}, "layer": "below"}
    at = [_seconds(stretch, t_zero_ns) for stretch in stretches]
    _add_shapes(fig, [style | {"x0": x0, "x1": x1} for x0, x1 in at])
    return bool(stretches)


def add_resets(fig: Any, filter_log: FilterLog, t_zero_ns: int) -> bool:
    """Mark where the filter began anew; whether it did."""
    moments = filter_log.t_ns[1:][np.diff(filter_log.resets) > 0].tolist()
    line = {"color": SUSPECT_COLOR, "width": 1.5, "dash": "dashdot"}
    style = {"type": "line", "y0": 0.0, "y1": 1.0, "line": line}
    at = [_seconds((t, t), t_zero_ns) for t in moments]
    _add_shapes(fig, [style | {"x0": x0, "x1": x1} for x0, x1 in at])
    return bool(moments)


def _seconds(stretch: tuple[int, int], t_zero_ns: int) -> tuple[float, float]:
    return (stretch[0] - t_zero_ns) * 1e-9, (stretch[1] - t_zero_ns) * 1e-9


def _add_shapes(fig: Any, shapes: list[dict[str, Any]]) -> None:
    """Add shapes to both rows of a figure; all at once, for plotly looks through all at each."""
    rows = [{"xref": "x", "yref": "y domain"}, {"xref": "x2", "yref": "y2 domain"}]
    both = [shape | row for row in rows for shape in shapes]
    fig.update_layout(shapes=[*fig.layout.shapes, *both])


def add_suspects(fig: Any, tags: Judgement, tag_map: TagMap) -> None:
    """Mark suspect tags, with an arrow's worth of line to where they were found."""
    rows = tags.row[tags.suspect]
    start = tag_map.p_WT[rows]
    end = start + tags.offset_W[tags.suspect]
    points = np.stack([start, end, np.full_like(start, np.nan)], axis=1).reshape(-1, 3)
    names = [f"tag {tag_map.tag_id[row]}" for row in rows for _ in range(3)]
    line = {"color": SUSPECT_COLOR, "width": 8}
    fig.add_trace(_path3d(points, "suspect tags", line, text=names, hoverinfo="text"))


def _add_sizes(fig: Any, errors: Errors, name: str, view: str, t_zero_ns: int) -> None:
    """Add the two lines of one view of one estimator."""
    style = {"color": color(name), "width": 1.5, "dash": "solid" if view == "capture" else "dot"}
    for row, (factor, _) in enumerate(_UNITS):
        size = np.linalg.norm((errors.p_W, errors.rotation_I)[row], axis=-1) * factor
        trace = _curve(
            *thin(*in_time(errors.t_ns, size, t_zero_ns)),
            name=f"{label(name)}, {view}",
            legendgroup=f"{name} {view}",
            showlegend=row == 0,
            visible=True if view == "capture" else "legendonly",
            line=style,
        )
        fig.add_trace(trace, row=row + 1, col=1)


def _curve(t_s: Array, y: Array, **style: Any) -> Any:
    """A line in the plane; single precision halves the page and no eye sees it."""
    import plotly.graph_objects as go

    return go.Scatter(x=t_s.astype(np.float32), y=y.astype(np.float32), mode="lines", **style)


def _path3d(points: Array, name: str, line: dict[str, Any], **more: Any) -> Any:
    import plotly.graph_objects as go

    x, y, z = np.round(points, 4).astype(np.float32).T
    return go.Scatter3d(x=x, y=y, z=z, name=name, mode="lines", line=line, **more)


def _up(tag_map: TagMap | None) -> dict[str, float]:
    """Against gravity where the map knows it, else along its z."""
    if tag_map is None or tag_map.gravity is None:
        return {"x": 0.0, "y": 0.0, "z": 1.0}
    return {axis: -d for axis, d in zip("xyz", tag_map.gravity.dir, strict=True)}


def _rows(titles: tuple[str, ...], height: int) -> Any:
    from plotly.subplots import make_subplots

    fig = make_subplots(rows=len(titles), cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for i, title in enumerate(titles):
        fig.update_yaxes(title_text=title, row=i + 1, col=1)
    fig.update_xaxes(title_text="t s", row=len(titles), col=1)
    fig.update_layout(height=height)
    return fig
