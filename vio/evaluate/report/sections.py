"""What the report shows besides the figures of plotly: tables, suspects, moments."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.tags.tag_map import TagMap
from vio.evaluate.filter_log import FilterLog
from vio.evaluate.moved_tags import Judgement
from vio.evaluate.report.verdict import label
from vio.evaluate.tag_sightings import Sightings

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


@dataclass(frozen=True, slots=True)
class Table:
    """Cells of text under their heads; the first column is words."""

    title: str
    head: list[str]
    rows: list[list[str]]


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """A tag that lies elsewhere than the map says: by how much (3,) in W, found in how many frames.

    distance: of the offset in sigmas.
    """

    tag_id: int
    offset_cm: Array
    distance: float
    frames: int

    @property
    def size_cm(self) -> float:
        """Length of the offset."""
        return float(np.linalg.norm(self.offset_cm))


def breakdown_tables(evaluation: Mapping[str, Any]) -> list[Table]:
    """Errors by what they depend on, drift, axes and consistency, a column an estimator."""
    if not evaluation:
        return []
    head = ["", *map(label, evaluation)]
    parts = {
        title: {name: whole["by"].get(key, {}) for name, whole in evaluation.items()}
        for key, title in _BY.items()
    }
    parts["Drift"] = {
        name: {f"over {span}": figures for span, figures in whole["relative"].items()}
        for name, whole in evaluation.items()
    }
    out = []
    for title, of in parts.items():
        rows = list(dict.fromkeys(row for bins in of.values() for row in bins))
        cells = [[row, *(_pair(bins.get(row)) for bins in of.values())] for row in rows]
        out += [Table(title, head, cells)] if rows else []
    return [*out, Table("Axes, covariance, age", head, _honesty(evaluation))]


def _honesty(evaluation: Mapping[str, Any]) -> list[list[str]]:
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
    return lines


def suspects(tags: Judgement, tag_map: TagMap) -> list[Suspect]:
    """Tags that lie elsewhere than the map says, the worst first."""
    bad = np.flatnonzero(tags.suspect)
    return [
        Suspect(
            int(tag_map.tag_id[tags.row[k]]),
            100.0 * tags.offset_W[k],
            float(tags.distance[k]),
            int(tags.frames[k]),
        )
        for k in bad[np.argsort(-tags.distance[bad])]
    ]


def suspect_lines(tags: Judgement, tag_map: TagMap) -> list[str]:
    """The suspects in words, one a line, the worst first."""
    out = []
    for tag in suspects(tags, tag_map):
        x, y, z = tag.offset_cm
        out.append(
            f"tag {tag.tag_id} disagrees with the map by {tag.size_cm:.1f} cm"
            f" ({x:+.1f}, {y:+.1f}, {z:+.1f}) in {tag.frames} frames: moved, or laid badly?"
        )
    return out


def rejected_share(seen: Sightings) -> dict[int, float]:
    """By tag id, the share of its frames in which the joint pose gave it little weight."""
    return {tag_id: seen.rejected[tag_id] / max(n, 1) for tag_id, n in seen.seen.items()}


def often_rejected(seen: Sightings) -> list[tuple[int, float, int]]:
    """Tags that the joint pose rejects often, the worst first: tag id, share, frames."""
    share = rejected_share(seen)
    often = [(share[t], n, t) for t, n in seen.seen.items() if n >= _FEW and share[t] > _OFTEN]
    return [(t, x, n) for x, n, t in sorted(often, reverse=True)[:_REJECTED]]


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


def beliefs(filter_log: FilterLog) -> Iterator[tuple[str, tuple[Array, Array], tuple[float, str]]]:
    """What a filter log holds to draw: name, values and sigmas, factor and unit."""
    deg = 180.0 / np.pi
    yield "gyro", filter_log.gyro_bias, (deg, "deg/s")
    yield "accel", filter_log.accel_bias, (1.0, "m/s²")
    yield "camera", filter_log.camera_rotation, (deg, "deg")
    yield "offset", filter_log.time_offset, (1e3, "ms")


def _pair(figures: Mapping[str, Any] | None) -> str:
    if not figures or figures.get("position_rmse_m") is None:
        return "-"
    return f"{1e3 * figures['position_rmse_m']:.1f} / {figures['rotation_rmse_deg']:.2f}"
