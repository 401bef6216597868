"""Writes report.html: one page that opens offline and shows how well each estimator did."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tagvo.geometry import IntArray
from tagvo.tags.tag_map import TagMap
from tagvo.textfile import write_atomic
from vio.evaluate.align import Z_AXIS
from vio.evaluate.compare import COLUMNS, Judged, judge, rows
from vio.evaluate.filter_log import FilterLog
from vio.evaluate.moved_tags import Judgement
from vio.evaluate.records import Trajectory, TruthLike, Window
from vio.evaluate.report import plots, sections
from vio.evaluate.report.html import render
from vio.evaluate.report.sections import Picture
from vio.evaluate.report.verdict import label, verdict
from vio.evaluate.tag_sightings import Sightings
from vio.evaluate.truth import TruthTrack, clean_truth

_FIGURE_CONFIG = {"responsive": True, "displaylogo": False}


@dataclass(frozen=True, slots=True, eq=False)
class Extra:
    """What a report may show besides: title, what was run, and the tags of each frame.

    window and axis_W: as given to `comparison`; t_zero_ns: where the time axis starts (None: at
    truth's first row); tags_t_ns, tags_count (m,): tags used in each frame; notes: lines of text;
    judged: the trajectories' errors, where they are known already; evaluation: of `breakdown`;
    filter_log: what the filter believed; sightings, tags: what was seen of the map, and where its
    tags were found; moments: the worst, with their images.
    """

    title: str = "tagvio compare"
    window: Window = field(default_factory=Window)
    axis_W: tuple[float, float, float] = Z_AXIS
    t_zero_ns: int | None = None
    tags_t_ns: IntArray | None = None
    tags_count: IntArray | None = None
    notes: tuple[str, ...] = ()
    judged: tuple[Judged, ...] = ()
    evaluation: Mapping[str, Any] = field(default_factory=dict)
    filter_log: FilterLog | None = None
    sightings: Sightings | None = None
    tags: Judgement | None = None
    moments: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """All that a part of the report may draw on."""

    content: Mapping[str, Any]
    judged: tuple[Judged, ...]
    truth: TruthTrack
    tag_map: TagMap | None
    extra: Extra
    t_zero_ns: int


def write_report(
    path: Path,
    content: Mapping[str, Any],
    trajectories: Sequence[Trajectory],
    truth: TruthLike,
    tag_map: TagMap | None,
    extra: Extra | None = None,
) -> None:
    """Write the report of a comparison (`content`: of `comparison.json`) to one HTML file."""
    from plotly.offline import get_plotlyjs

    extra = extra or Extra()
    track = clean_truth(truth)
    align = content["align"]
    judged = extra.judged or tuple(
        judge(t, track, align, extra.window, extra.axis_W) for t in trajectories
    )
    zero = int(track.t_ns[0]) if extra.t_zero_ns is None else extra.t_zero_ns
    material = Material(content, judged, track, tag_map, extra, zero)
    write_atomic(path, render("report.html", library=get_plotlyjs(), **view(material)))


def view(m: Material) -> dict[str, Any]:
    """What the template report.html shows, by the names it has there."""
    x = m.extra
    frames = {k: v for k, v in m.content["frames"].items() if v is not None}
    timing = m.content["timing_ms"]
    return {
        "title": x.title,
        "verdict": verdict(m.content),
        "frames": ", ".join(f"{k.replace('_', ' ')} {v}" for k, v in frames.items()),
        "truth": m.truth,
        "align": m.content["align"],
        "notes": x.notes,
        "columns": [column.title for column in COLUMNS],
        "rows": [(label(name), *rest) for name, *rest in rows(m.content)],
        "trajectory": _trajectory(m),
        "errors": _errors(m),
        "moments": x.moments,
        "breakdown": sections.breakdown_tables(x.evaluation.get("estimators", {})),
        "axes": _axes(m),
        "beliefs": _beliefs(m),
        "tags": _tags(m),
        "map": _map(m),
        "timing": timing and figure(plots.timing_figure(timing), "timing"),
    }


def _trajectory(m: Material) -> str:
    """The paths in 3-D."""
    fig = plots.trajectory_figure(m.judged, m.truth, m.tag_map)
    if m.extra.tags is not None and m.tag_map is not None and m.extra.tags.suspect.any():
        plots.add_suspects(fig, m.extra.tags, m.tag_map)
    return figure(fig, "trajectory")


def _errors(m: Material) -> dict[str, Any] | None:
    """Position and rotation error over time, and whether blackouts and resets are marked in it."""
    if not any(len(one.capture) + len(one.now) for one in m.judged):
        return None
    x, fig, dark = m.extra, plots.error_figure(m.judged, m.t_zero_ns), False
    if x.tags_t_ns is not None and x.tags_count is not None:
        spans = sections.blackouts(x.tags_t_ns, x.tags_count)
        dark = plots.add_blackouts(fig, spans, m.t_zero_ns)
    resets = x.filter_log is not None and plots.add_resets(fig, x.filter_log, m.t_zero_ns)
    return {"drawn": figure(fig, "errors"), "blackouts": dark, "resets": resets}


def _axes(m: Material) -> list[dict[str, Any]]:
    """Error by axis, for estimators that state a covariance."""
    out = []
    for one in m.judged:
        errors, name = one.capture, one.trajectory.name
        if errors.cov is None or not len(errors):
            continue
        position, rotation = (
            figure(plots.axis_figure(errors, name, part, m.t_zero_ns), f"axes-{name}-{part}")
            for part in (0, 1)
        )
        out.append({"estimator": label(name), "outside": share_outside(one),
                    "position": position, "rotation": rotation})  # fmt: skip
    return out


def _beliefs(m: Material) -> dict[str, str] | None:
    """What the filter came to believe of its biases and its rig, and its innovations."""
    log = m.extra.filter_log
    if log is None or len(log) < 2:
        return None
    drawn = {
        name: figure(plots.belief_figure(log.t_ns, *belief, unit, m.t_zero_ns), f"belief-{name}")
        for name, belief, unit in sections.beliefs(log)
    }
    return drawn | {"nis": figure(plots.nis_figure(log, m.t_zero_ns), "nis")}


def _tags(m: Material) -> dict[str, Any] | None:
    """Tags of each frame, and how large they were."""
    t_ns, count, seen = m.extra.tags_t_ns, m.extra.tags_count, m.extra.sightings
    if t_ns is None or count is None or not len(t_ns):
        return None
    classes = None
    if seen is not None and m.tag_map is not None:
        classes = figure(plots.classes_figure(seen, m.tag_map, m.t_zero_ns), "classes")
    drawn = figure(plots.tags_figure(t_ns, count, m.t_zero_ns), "tags")
    return {"drawn": drawn, "median": np.median(count), "classes": classes}


def _map(m: Material) -> dict[str, Any] | None:
    """Tags that lie elsewhere than the map says, and those that were often rejected."""
    tags, seen = m.extra.tags, m.extra.sightings
    if tags is None or seen is None or m.tag_map is None:
        return None
    return {
        "judged": len(tags.row),
        "suspects": sections.suspects(tags, m.tag_map),
        "rejected_share": sections.rejected_share(seen),
        "often_rejected": sections.often_rejected(seen),
    }


def share_outside(one: Judged) -> float:
    """Share of the six errors at capture that exceed three of their own sigmas."""
    errors = one.capture
    if errors.cov is None or not len(errors):
        return 0.0
    variance = np.diagonal(errors.cov, axis1=-2, axis2=-1)
    e = np.concatenate([errors.p_W, errors.rotation_I], axis=-1)
    return float(np.mean(e * e > 9.0 * variance))


def figure(fig: Any, div_id: str) -> str:
    """A plotly figure in the page's clothes as an HTML fragment."""
    fig.update_layout(
        template="none",
        paper_bgcolor="rgba(0,0,0,0)",
        plot_bgcolor="rgba(0,0,0,0)",
        font={"family": "system-ui, sans-serif", "size": 13},
        margin={"l": 60, "r": 10, "t": 10, "b": 45},
        modebar={"bgcolor": "rgba(0,0,0,0)", "color": plots.GREY, "activecolor": plots.GREY},
        legend={"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0},
    )
    drawn: str = fig.to_html(
        full_html=False, include_plotlyjs=False, div_id=div_id, config=_FIGURE_CONFIG
    )
    return drawn
