"""Sets estimators side by side: the figures of `comparison.json` and the table on the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tagvo.textfile import write_atomic
from vio.errors import EvaluationError
from vio.evaluate.align import Z_AXIS, apply, estimate_alignment
from vio.evaluate.metrics import Stats, capture_errors, now_errors, stats
from vio.evaluate.records import Errors, Trajectory, TruthLike, Window, only_finite
from vio.evaluate.truth import TruthTrack, clean_truth, interpolate

if TYPE_CHECKING:
    from rich.table import Table

VIEWS = ("capture", "now")


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """One estimator against truth: its aligned trajectory and the errors in both views."""

    trajectory: Trajectory
    capture: Errors
    now: Errors


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the tables: key of STATS, heading, factor to its unit, decimals."""

    key: str
    title: str
    factor: float
    digits: int
    better: str  # min, max or none


COLUMNS = (
    Column("position_rmse_m", "pos rms mm", 1e3, 2, "min"),
    Column("position_median_m", "median mm", 1e3, 2, "min"),
    Column("position_p95_m", "p95 mm", 1e3, 2, "min"),
    Column("position_max_m", "max mm", 1e3, 1, "min"),
    Column("rotation_rmse_deg", "rot rms deg", 1.0, 3, "min"),
    Column("rotation_median_deg", "median deg", 1.0, 3, "min"),
    Column("velocity_rmse_m_s", "vel rms mm/s", 1e3, 1, "min"),
    Column("nees_pose", "NEES /6", 1.0, 2, "none"),
    Column("coverage", "cover %", 1e2, 1, "max"),
    Column("n", "n", 1.0, 0, "none"),
)
_NARROW = tuple(c for c in COLUMNS if c.key not in ("rotation_median_deg", "n"))  # 80 characters


def judge(
    trajectory: Trajectory,
    truth: TruthTrack,
    align: str = "none",
    window: Window | None = None,
    axis_W: tuple[float, float, float] = Z_AXIS,
) -> Judged:
    """Errors of one estimator in both views, aligned by its pairs with truth at capture."""
    window = window or Window()
    outputs = only_finite(trajectory)
    at = interpolate(truth, outputs.t_ns)
    pairs = at.known & window.holds(outputs.t_ns)
    try:
        alignment = estimate_alignment(align, outputs.p_WI[pairs], at.p_WI[pairs], axis_W)
    except EvaluationError as err:
        raise EvaluationError(f"{trajectory.name}: {err}") from None
    aligned = apply(alignment, outputs)
    return Judged(
        aligned, capture_errors(aligned, truth, window), now_errors(aligned, truth, window)
    )


def comparison(
    trajectories: Sequence[Trajectory],
    truth: TruthLike,
    *,
    align: str = "none",
    t_start_ns: int | None = None,
    t_end_ns: int | None = None,
    frames: Mapping[str, int | None],
    timing_ms: Mapping[str, Mapping[str, float]],
    axis_W: tuple[float, float, float] = Z_AXIS,
) -> dict[str, Any]:
    """The content of `comparison.json`; an estimator that is not given is missing in it."""
    window = Window(t_start_ns, t_end_ns)
    track = clean_truth(truth)
    judged = [judge(t, track, align, window, axis_W) for t in trajectories]
    return comparison_of(judged, align, frames, timing_ms)


def comparison_of(
    judged: Sequence[Judged],
    align: str,
    frames: Mapping[str, int | None],
    timing_ms: Mapping[str, Mapping[str, float]],
) -> dict[str, Any]:
    """The same of estimators that are judged already."""
    whole = {
        "align": align,
        "estimators": {one.trajectory.name: both_views(one) for one in judged},
        "frames": dict(frames),
        "timing_ms": {stage: dict(times) for stage, times in timing_ms.items()},
    }
    return dict(jsonable(whole))


def both_views(judged: Judged) -> dict[str, Stats | None]:
    """STATS by view; `capture` is None where no pose meets truth at its own time."""
    capture = stats(judged.capture) if len(judged.capture) else None
    return {"capture": capture, "now": stats(judged.now)}


def jsonable(value: Any) -> Any:
    """The value in JSON's own types; a number that is none (NaN, infinite) becomes None."""
    if isinstance(value, Mapping):
        return {str(key): jsonable(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return jsonable(value.tolist())
    if isinstance(value, list | tuple):
        return [jsonable(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a comparison as strict JSON, whole or not at all."""
    write_atomic(path, json.dumps(jsonable(content), indent=2, allow_nan=False) + "\n")


def best_of(content: Mapping[str, Any], view: str, column: Column) -> frozenset[str]:
    """The estimators with the best figure (as shown) in a view; none where all are equal."""
    values: dict[str, float] = {
        name: round(views[view][column.key] * column.factor, column.digits)
        for name, views in content["estimators"].items()
        if views[view] is not None and views[view][column.key] is not None
    }
    if column.better == "none" or len(set(values.values())) < 2:
        return frozenset()
    best = (min if column.better == "min" else max)(values.values())
    return frozenset(name for name, value in values.items() if value == best)


def rows(
    content: Mapping[str, Any], columns: Sequence[Column] = COLUMNS
) -> list[tuple[str, str, list[tuple[str, bool]]]]:
    """Estimator, view and cells (text, is it the better?), a row per estimator and view."""
    best = {(v, c.key): best_of(content, v, c) for v in VIEWS for c in columns}
    out = []
    for name, views in content["estimators"].items():
        for view in VIEWS:
            figures = views[view] or {}
            cells = [(_text(figures.get(c.key), c), name in best[view, c.key]) for c in columns]
            out.append((name, view, cells))
    return out


def table(content: Mapping[str, Any]) -> Table:
    """The comparison for a terminal: a row per estimator and view, the better bold with a *."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table
    from rich.text import Text

    title = f"against truth, align {content['align']}; * the better in its view"
    out = Table(title=title, box=SIMPLE_HEAD, padding=(0, 0, 0, 1), pad_edge=False)
    names = [name for name, _, _ in rows(content, _NARROW)]
    out.add_column("", no_wrap=True, min_width=max(map(len, names), default=0))
    out.add_column("view", no_wrap=True, min_width=len("capture"))
    for column in _NARROW:
        out.add_column(column.title.replace(" ", "\n"), justify="right", no_wrap=True)
    for name, view, cells in rows(content, _NARROW):
        marked = [Text(t + ("*" if b else " "), style="bold" if b else "") for t, b in cells]
        out.add_row(name, view, *marked)
    return out


_WIDEST = 99_999.5  # longer figures would push the names off 80 columns


def _text(value: float | None, column: Column) -> str:
    if value is None:
        return "-"
    shown = value * column.factor
    if shown >= _WIDEST:
        return f"{shown:.0e}"
    digits = column.digits if shown < 100.0 else max(0, column.digits - 1)
    return f"{shown:.{digits}f}"
