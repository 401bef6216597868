"""Parts of the report that are tables and pictures in plain HTML."""

import base64
import html
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.tags.tag_map import TagMap
from vio.evaluate.filter_log import Diary
from vio.evaluate.moved_tags import Judgement
from vio.evaluate.report.verdict import label
from vio.evaluate.tag_sightings import Sightings

NIS = (
    "Innovation of each frame's pose against what the filter expected, per degree of freedom, and"
    " where 95 % lie for a filter that is exactly right (dashed). The filter trusts correlated"
    " errors less on purpose (vio.r_inflation), so it lies below."
)
_BY = {
    "phase": "By phase",
    "height_m": "By height over the map [m]",
    "speed_m_s": "By speed [m/s]",
    "tags": "By number of tags in use",
}
_REJECTED = 10  # tags listed as often rejected, at most
_OFTEN, _FEW = 0.2, 5
_BLACKOUT_NS = 500_000_000
_BLACKOUT_FRAMES = 2.5  # or as many times the usual spacing of frames


@dataclass(frozen=True, slots=True)
class Picture:
    """A moment: what it shows in words, a JPEG, and its width and height."""

    caption: str
    jpeg: bytes
    size: tuple[int, int]


def breakdown_html(evaluation: Mapping[str, Any]) -> str:
    """Errors by what they depend on, drift, axes and consistency, a column an estimator."""
    if not evaluation:
        return ""
    parts = []
    for key, title in _BY.items():
        of = {name: whole["by"].get(key, {}) for name, whole in evaluation.items()}
        rows = list(dict.fromkeys(row for bins in of.values() for row in bins))
        if rows:
            cells = [[row, *(_pair(bins.get(row)) for bins in of.values())] for row in rows]
            parts.append(f"<h3>{title}</h3>{table(['', *map(label, of)], cells)}")
    drifts = {name: whole["relative"] for name, whole in evaluation.items()}
    rows = list(dict.fromkeys(row for of in drifts.values() for row in of))
    if rows:
        cells = [[f"over {row}", *(_pair(of.get(row)) for of in drifts.values())] for row in rows]
        parts.append(f"<h3>Drift</h3>{table(['', *map(label, drifts)], cells)}")
    parts.append(f"<h3>Axes, covariance, age</h3>{_honesty(evaluation)}")
    said = "Position rms [mm] / rotation rms [deg]; live errors but for the drift."
    return f'<h2>Where the errors are</h2>\n<p class="soft">{said}</p>' + "\n".join(parts)


def _honesty(evaluation: Mapping[str, Any]) -> str:
    names = list(evaluation)
    lines: list[list[str]] = []
    for title, part, key, factor, digits in (
        ("x rms mm", "axes", "x_rms_m", 1e3, 1),
        ("y rms mm", "axes", "y_rms_m", 1e3, 1),
        ("z rms mm", "axes", "z_rms_m", 1e3, 1),
        ("share along its main direction", "axes", "main_share", 1.0, 2),
        ("mean NEES / 6", "consistency", "nees_mean", 1.0, 2),
        ("NEES inside 95 %, two-sided", "consistency", "inside_95", 1.0, 3),
        ("below", "consistency", "below_95", 1.0, 3),
        ("above", "consistency", "above_95", 1.0, 3),
        ("age when known p50 ms", "age_ms", "p50", 1.0, 1),
        ("age when known p99 ms", "age_ms", "p99", 1.0, 1),
    ):
        values = [evaluation[name][part].get(key) for name in names]
        if any(v is not None for v in values):
            shown = ["-" if v is None else f"{factor * v:.{digits}f}" for v in values]
            lines.append([title, *shown])
    return table(["", *map(label, names)], lines)


def suspects_html(tags: Judgement, seen: Sightings, tag_map: TagMap) -> str:
    """Suspect tags with where they were found, and tags that the joint pose rejects often."""
    parts = ["<h2>The map</h2>"]
    bad = np.flatnonzero(tags.suspect)
    judged = f"{len(tags.row)} tags were seen in enough frames to be judged"
    if not len(bad):
        parts.append(f"<p>No tag is suspect: {judged}.</p>")
    else:
        cells = []
        for k in bad[np.argsort(-tags.distance[bad])]:
            x, y, z = 100.0 * tags.offset_W[k]
            tag_id = int(tag_map.tag_id[tags.row[k]])
            cells.append([
                f"tag {tag_id} disagrees by {100.0 * np.linalg.norm(tags.offset_W[k]):.1f} cm",
                f"{x:+.1f} {y:+.1f} {z:+.1f}", f"{tags.distance[k]:.0f}", str(tags.frames[k]),
                f"{100.0 * _share(seen, tag_id):.0f} %",
            ])  # fmt: skip
        head = ["", "x y z cm", "sigmas", "frames", "rejected"]
        parts.append(f"<p>Suspect tags; {judged}.</p>{table(head, cells)}")
    often = [(_share(seen, t), n, t) for t, n in seen.seen.items() if n >= _FEW]
    often = sorted((row for row in often if row[0] > _OFTEN), reverse=True)[:_REJECTED]
    if often:
        cells = [[f"tag {t}", f"{100 * share:.0f} %", str(n)] for share, n, t in often]
        rows = table(["", "rejected", "of frames"], cells)
        parts.append(f"<h3>Often rejected by the joint pose</h3>{rows}")
    return "\n".join(parts)


def suspect_lines(tags: Judgement, tag_map: TagMap) -> list[str]:
    """The suspects in words, one a line, the worst first."""
    bad = np.flatnonzero(tags.suspect)
    out = []
    for k in bad[np.argsort(-tags.distance[bad])]:
        x, y, z = 100.0 * tags.offset_W[k]
        size = 100.0 * float(np.linalg.norm(tags.offset_W[k]))
        out.append(
            f"tag {tag_map.tag_id[tags.row[k]]} disagrees with the map by {size:.1f} cm"
            f" ({x:+.1f}, {y:+.1f}, {z:+.1f}) in {tags.frames[k]} frames: moved, or laid badly?"
        )
    return out


def moments_html(moments: Sequence[Picture]) -> str:
    """Pictures with their captions."""
    if not moments:
        return ""
    shown = "".join(
        f"<figure><figcaption>{html.escape(m.caption)}</figcaption>"
        f'<svg role="img" aria-label="{html.escape(m.caption)}" style="width:100%"'
        f' viewBox="0 0 {m.size[0]} {m.size[1]}"><image width="{m.size[0]}" height="{m.size[1]}"'
        f' href="data:image/jpeg;base64,{base64.b64encode(m.jpeg).decode()}"/></svg></figure>'
        for m in moments
    )
    return (
        '<h2>Worst moments</h2>\n<p class="soft">What the camera saw: tags in use outlined,'
        f' rejected ones crossed out.</p><div class="pair">{shown}</div>'
    )


def blackouts(t_ns: IntArray, count: IntArray) -> list[tuple[int, int]]:
    """Stretches without tags [ns]: half a second, and longer than a slow camera's frames lie apart.

    Frames (m,) [ns] and their tags (m,).
    """
    if len(t_ns) < 2:
        return []
    usual_ns = float(np.median(np.diff(np.sort(t_ns))))
    used = np.sort(t_ns[count > 0])
    gaps = np.flatnonzero(np.diff(used) >= max(_BLACKOUT_NS, _BLACKOUT_FRAMES * usual_ns))
    return [(int(used[k]), int(used[k + 1])) for k in gaps]


def beliefs(
    diary: Diary,
) -> Iterator[tuple[str, tuple[Array, Array], tuple[float, str], str]]:
    """What a diary holds to draw: name, values and sigmas, factor and unit, caption."""
    deg = 180.0 / np.pi
    yield ("gyro", diary.gyro_bias, (deg, "deg/s"), "Gyro bias, with 3 sigma (dotted).")
    yield ("accel", diary.accel_bias, (1.0, "m/s²"), "Accelerometer bias.")
    yield (
        "camera", diary.camera_rotation, (deg, "deg"),
        "The camera's rotation, less that of the calibration file.",
    )  # fmt: skip
    yield ("offset", diary.time_offset, (1e3, "ms"), "Time offset of the camera.")


def table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """An HTML table whose first column is words."""
    titles = "".join(f"<th>{html.escape(t)}</th>" for t in head)
    body = "".join(
        '<tr><td class="left">'
        + html.escape(line[0])
        + "</td>"
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in line[1:])
        + "</tr>"
        for line in lines
    )
    return f'<div class="wide"><table><tr>{titles}</tr>{body}</table></div>'


def _pair(figures: Mapping[str, Any] | None) -> str:
    if not figures or figures.get("position_rmse_m") is None:
        return "-"
    return f"{1e3 * figures['position_rmse_m']:.1f} / {figures['rotation_rmse_deg']:.2f}"


def _share(seen: Sightings, tag_id: int) -> float:
    return seen.rejected[tag_id] / max(seen.seen[tag_id], 1)
