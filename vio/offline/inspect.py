"""What a comparison looks at besides the figures: the map's tags, the worst moments, the causes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tagvo.geometry import IntArray
from vio.evaluate.breakdown import breakdown, up_of
from vio.evaluate.compare import Judged
from vio.evaluate.moved_tags import Judgement, judge_tags
from vio.evaluate.records import Window
from vio.evaluate.report.frame_picture import picture
from vio.evaluate.report.report import Extra
from vio.evaluate.report.sections import Picture, suspect_lines
from vio.evaluate.truth import TruthTrack
from vio.offline.replay import Replayed
from vio.sources.flight_log.log import FlightLog

if TYPE_CHECKING:
    from vio.evaluate.tag_sightings import SightingBook

_WORST, _APART_NS = 4, 2_000_000_000
_NEAR_NS = 300_000_000


def inspected(
    done: Replayed, judged: Sequence[Judged], truth: TruthTrack, window: Window, title: str
) -> tuple[Extra, list[str]]:
    """What the report shows of a run, and what of it is a warning."""
    log, result = done.log, done.result
    counts = np.array(result.tags_t_ns, dtype=np.int64), np.array(result.tags_count, dtype=np.int64)
    gravity = None if log.tag_map.gravity is None else log.tag_map.gravity.dir
    evaluation = breakdown(judged, truth, log.phases, window, up_of(gravity), counts)
    seen = None if done.book is None else done.book.sightings()
    tags = None if seen is None else judge_tags(seen, log.tag_map)
    suspects = [] if tags is None else suspect_lines(tags, log.tag_map)
    extra = Extra(
        title, window, t_zero_ns=log.t0_ns, tags_t_ns=counts[0], tags_count=counts[1],
        notes=(*done.warnings, *suspects), judged=tuple(judged),
        evaluation={
            "estimators": evaluation,
            "suspect_tags": _listed(tags, log),
            "interrupted": result.interrupted,
        },
        filter_log=None if done.filter_log is None else done.filter_log.log(),
        sightings=seen, tags=tags,
        moments=() if done.book is None else tuple(_worst(judged, done.book, log)),
    )  # fmt: skip
    return extra, suspects


def _listed(tags: Judgement | None, log: FlightLog) -> list[dict[str, Any]] | None:
    if tags is None:
        return None
    return [
        {
            "id": int(log.tag_map.tag_id[tags.row[k]]),
            "offset_m": tags.offset_W[k].tolist(),
            "sigmas": float(tags.distance[k]),
            "frames": int(tags.frames[k]),
        }
        for k in np.flatnonzero(tags.suspect)
    ]


def _worst(judged: Sequence[Judged], book: "SightingBook", log: FlightLog) -> "list[Picture]":
    """The moments of the largest live position errors of `vio` (else of the first), with images."""
    said = [j for j in judged if len(j.now)]
    one = next((j for j in said if j.trajectory.name == "vio"), said[0] if said else None)
    if one is None:
        return []
    size = np.linalg.norm(one.now.p_W, axis=-1)
    out = []
    shift = round(log.camera.timeshift_s * 1e9)
    for row in _peaks(one.now.t_ns, size):
        t_ns = int(one.now.t_ns[row])
        kept = book.nearest(t_ns - shift)
        if kept is None:
            continue
        away = kept.t_ns + shift - t_ns
        image = _image(log, kept.t_ns)
        error = np.degrees(np.linalg.norm(one.now.rotation_I[row]))
        what = f"the nearest frame with a pose is {abs(away) * 1e-9:.2f} s away; "
        caption = (
            f"{(t_ns - log.t0_ns) * 1e-9:.2f} s: {one.trajectory.name} off by"
            f" {1e3 * size[row]:.0f} mm, {error:.2f} deg; {what if abs(away) > _NEAR_NS else ''}"
            f"{len(kept.seen)} tags, {int(kept.rejected.sum())} rejected"
        )
        drawn = picture(image, kept.seen, kept.rejected, log.camera.resolution)
        out.append(Picture(caption, *drawn))
    return out


def _peaks(t_ns: IntArray, size: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> list[int]:
    """Rows of the largest values, apart from one another."""
    left = size.copy()
    out: list[int] = []
    while len(out) < _WORST and np.isfinite(left).any() and float(np.nanmax(left)) > 0.0:
        row = int(np.nanargmax(left))
        out.append(row)
        left[np.abs(t_ns - t_ns[row]) < _APART_NS] = -1.0
    return out


def _image(log: FlightLog, t_ns: int) -> Any:
    rows = np.flatnonzero(log.frames.t_ns == t_ns)
    frame = log.frames.frame(int(rows[0])) if len(rows) else None
    return None if frame is None else frame.image
