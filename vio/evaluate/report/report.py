"""Writes report.html: one page that opens offline and shows how well each estimator did."""

import html
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
from vio.evaluate.filter_log import Diary
from vio.evaluate.moved_tags import Judgement
from vio.evaluate.records import Trajectory, TruthLike, Window
from vio.evaluate.report import plots, sections
from vio.evaluate.report.html import page
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
    diary: what the filter believed; sightings, tags: what was seen of the map, and where its tags
    were found; moments: the worst, with their images.
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
    diary: Diary | None = None
    sightings: Sightings | None = None
    tags: Judgement | None = None
    moments: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """All that a section of the report may draw on."""

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
    body = "\n".join(part for part in (section(material) for section in SECTIONS) if part)
    write_atomic(path, page(extra.title, body, get_plotlyjs()))


def head_section(m: Material) -> str:
    """Title, verdict and what was compared with what."""
    known = {k: v for k, v in m.content["frames"].items() if v is not None}
    frames = ", ".join(f"{k.replace('_', ' ')} {v}" for k, v in known.items())
    t = m.truth
    truth = (
        f"Truth: {len(t)} rows ({t.bad} bad and {t.repeated} repeated dropped,"
        f" {t.backward} out of order). Alignment: {m.content['align']}."
    )
    lines = (f"Frames: {frames}." if frames else "", truth, *m.extra.notes)
    notes = "".join(f"<div>{html.escape(line)}</div>" for line in lines if line)
    return (
        f"<h1>{html.escape(m.extra.title)}</h1>\n"
        f'<p class="verdict">{html.escape(verdict(m.content))}</p>\n'
        f'<div class="soft">{notes}</div>'
    )


def table_section(m: Material) -> str:
    """The figures of every estimator in both views."""
    titles = "".join(f"<th>{html.escape(c.title)}</th>" for c in COLUMNS)
    lines = []
    for name, view, cells in rows(m.content):
        figures = "".join(
            f'<td class="better">{t}</td>' if b else f"<td>{t}</td>" for t, b in cells
        )
        who = html.escape(label(name))
        lines.append(f'<tr><td class="left">{who}</td><td class="left">{view}</td>{figures}</tr>')
    return (
        "<h2>Figures</h2>\n"
        '<p class="soft">capture: each pose against truth at the moment it is for; now: what was'
        " known at each moment of truth, the last output held. Marked (*): the better in its view."
        ' NEES/6 is 1 where an estimator knows its own error.</p>\n<div class="wide"><table>'
        f'<tr><th class="left">estimator</th><th class="left">view</th>{titles}</tr>'
        f"{''.join(lines)}</table></div>"
    )


def trajectory_section(m: Material) -> str:
    """The paths in 3-D."""
    caption = "The paths over the tags (grey squares); drag to turn, scroll to zoom."
    fig = plots.trajectory_figure(m.judged, m.truth, m.tag_map)
    if m.extra.tags is not None and m.tag_map is not None and m.extra.tags.suspect.any():
        plots.add_suspects(fig, m.extra.tags, m.tag_map)
    drawn = figure(fig, "trajectory", caption)
    return f"<h2>Trajectory</h2>\n{drawn}"


def error_section(m: Material) -> str:
    """Position and rotation error over time."""
    if not any(len(one.capture) + len(one.now) for one in m.judged):
        return ""
    caption = "Size of the error at capture; a tap on the legend shows the live view (dotted)."
    fig = plots.error_figure(m.judged, m.t_zero_ns)
    if m.extra.tags_t_ns is not None and m.extra.tags_count is not None:
        dark = sections.blackouts(m.extra.tags_t_ns, m.extra.tags_count)
        if plots.add_blackouts(fig, dark, m.t_zero_ns):
            caption += " Shaded: no pose from tags for half a second and more."
    if m.extra.diary is not None and plots.add_resets(fig, m.extra.diary, m.t_zero_ns):
        caption += " Upright lines: the filter began anew."
    drawn = figure(fig, "errors", caption)
    return f"<h2>Error over time</h2>\n{drawn}"


def axis_section(m: Material) -> str:
    """Error by axis, for estimators that state a covariance."""
    parts = []
    for one in m.judged:
        errors, name = one.capture, one.trajectory.name
        if errors.cov is None or not len(errors):
            continue
        pair = "".join(
            figure(
                plots.axis_figure(errors, name, part, m.t_zero_ns),
                f"axes-{name}-{part}",
                ("Position in W", "Rotation in I")[part],
            )
            for part in (0, 1)
        )
        outside = f"{share_outside(one):.1%} of the errors lie outside 3 sigma (0.3 % should)."
        parts.append(
            f"<h3>{html.escape(label(name))}</h3>\n"
            f'<div class="soft">{outside}</div><div class="pair">{pair}</div>'
        )
    return "<h2>Error by axis, with 3 sigma</h2>\n" + "\n".join(parts) if parts else ""


def tags_section(m: Material) -> str:
    """Tags of each frame."""
    t_ns, count = m.extra.tags_t_ns, m.extra.tags_count
    if t_ns is None or count is None or not len(t_ns):
        return ""
    caption = f"Tags used in each frame, median {np.median(count):.0f}."
    drawn = figure(plots.tags_figure(t_ns, count, m.t_zero_ns), "tags", caption)
    if m.extra.sightings is not None and m.tag_map is not None:
        by_class = plots.classes_figure(m.extra.sightings, m.tag_map, m.t_zero_ns)
        drawn += figure(by_class, "classes", "Tags seen, by their size.")
    return f"<h2>Tags</h2>\n{drawn}"


def breakdown_section(m: Material) -> str:
    """Where the errors are, and whether the covariances know of them."""
    return sections.breakdown_html(m.extra.evaluation.get("estimators", {}))


def suspects_section(m: Material) -> str:
    """Tags that lie elsewhere than the map says, and those that were often rejected."""
    if m.extra.tags is None or m.extra.sightings is None or m.tag_map is None:
        return ""
    return sections.suspects_html(m.extra.tags, m.extra.sightings, m.tag_map)


def moments_section(m: Material) -> str:
    """The worst moments as the camera saw them."""
    return sections.moments_html(m.extra.moments)


def diary_section(m: Material) -> str:
    """What the filter came to believe of its biases and its rig."""
    diary = m.extra.diary
    if diary is None or len(diary) < 2:
        return ""
    parts = [
        figure(plots.belief_figure(diary.t_ns, *belief, unit, m.t_zero_ns), f"belief-{name}", text)
        for name, belief, unit, text in sections.beliefs(diary)
    ]
    drawn = figure(plots.nis_figure(diary, m.t_zero_ns), "nis", sections.NIS)
    return f'<h2>What the filter believes</h2>\n<div class="pair">{"".join(parts)}</div>{drawn}'


def timing_section(m: Material) -> str:
    """Time that each stage takes."""
    timing = m.content["timing_ms"]
    if not timing:
        return ""
    drawn = figure(plots.timing_figure(timing), "timing", "Time each stage takes for a frame.")
    return f"<h2>Timing</h2>\n{drawn}"


SECTIONS = (
    head_section,
    table_section,
    trajectory_section,
    error_section,
    moments_section,
    breakdown_section,
    axis_section,
    diary_section,
    tags_section,
    suspects_section,
    timing_section,
)


def share_outside(one: Judged) -> float:
    """Share of the six errors at capture that exceed three of their own sigmas."""
    errors = one.capture
    if errors.cov is None or not len(errors):
        return 0.0
    variance = np.diagonal(errors.cov, axis1=-2, axis2=-1)
    e = np.concatenate([errors.p_W, errors.rotation_I], axis=-1)
    return float(np.mean(e * e > 9.0 * variance))


def figure(fig: Any, div_id: str, caption: str) -> str:
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
    drawn = fig.to_html(
        full_html=False, include_plotlyjs=False, div_id=div_id, config=_FIGURE_CONFIG
    )
    text = html.escape(caption)
    return f'<figure aria-label="{text}"><figcaption>{text}</figcaption>{drawn}</figure>'
