"""The main plots of a comparison as PNG files, for slides and papers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tagvo.tags.tag_map import TagMap
from vio.evaluate.compare import Judged
from vio.evaluate.report.plots import GREY, TRUTH_COLOR, color
from vio.evaluate.report.polylines import in_time, path_in_time, tag_outlines
from vio.evaluate.report.verdict import label
from vio.evaluate.truth import TruthTrack

_DPI, _WIDTH_IN = 150, 9.0


def write_pngs(
    folder: Path,
    judged: Sequence[Judged],
    truth: TruthTrack,
    tag_map: TagMap | None,
    t_zero_ns: int,
) -> list[Path]:
    """errors.png (live, over time) and trajectory.png (from above) in a folder that is there."""
    return [
        _errors(folder / "errors.png", judged, t_zero_ns),
        _trajectory(folder / "trajectory.png", judged, truth, tag_map),
    ]


def _errors(path: Path, judged: Sequence[Judged], t_zero_ns: int) -> Path:
    """Position and rotation error as known at each moment of truth."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(_WIDTH_IN, 5.0), layout="constrained")
    above, below = fig.subplots(2, 1, sharex=True)
    for one in judged:
        for axes, e, factor in (
            (above, one.now.p_W, 1e3), (below, one.now.rotation_I, 180.0 / np.pi)
        ):  # fmt: skip
            t_s, y = in_time(one.now.t_ns, factor * np.linalg.norm(e, axis=-1), t_zero_ns)
            name = one.trajectory.name
            axes.plot(t_s, y, color=color(name), lw=1.0, label=label(name))
    above.set_ylabel("position error, live [mm]")
    below.set_ylabel("rotation error, live [deg]")
    below.set_xlabel("t [s]")
    for axes in (above, below):
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
    above.legend(loc="upper right")
    FigureCanvasAgg(fig).print_figure(path, dpi=_DPI)
    return path


def _trajectory(
    path: Path, judged: Sequence[Judged], truth: TruthTrack, tag_map: TagMap | None
) -> Path:
    """Paths in the map's x and y over the tags."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=(_WIDTH_IN, _WIDTH_IN), layout="constrained")
    axes = fig.subplots()
    if tag_map is not None:
        x, y, _ = tag_outlines(tag_map)[0].T
        axes.plot(x, y, color=GREY, lw=0.6)
    x, y, _ = path_in_time(truth.t_ns, truth.p_WI).T
    axes.plot(x, y, color=TRUTH_COLOR, lw=2.5, label="truth")
    for one in judged:
        x, y, _ = path_in_time(one.trajectory.t_ns, one.trajectory.p_WI).T
        axes.plot(x, y, color=color(one.trajectory.name), lw=1.0, label=label(one.trajectory.name))
    axes.set_aspect("equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.legend(loc="upper right")
    FigureCanvasAgg(fig).print_figure(path, dpi=_DPI)
    return path
