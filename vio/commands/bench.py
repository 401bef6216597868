"""`tagvio bench`: what finding tags costs and how well it is done, beside other detectors."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vio.interrupt import gently
from vio.offline.choice import make_folder
from vio.terminal import progress, waiting

if TYPE_CHECKING:
    from collections.abc import Iterable

    from tagvo.camera.model import Camera
    from tagvo.tags.tag_map import TagMap
    from vio.bench.measure import Score
    from vio.bench.scenes import View

_FRAMES = {"640x480": 16, "1280x720": 8, "1640x1232": 6}  # of each look
_QUICK = {"640x480": 5}


def command(
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="Write all figures as JSON.")
    ] = None,
    photos: Annotated[
        Path | None,
        typer.Option(
            "--photos",
            metavar="DIR",
            help="Real photographs too: images/, camera.yaml, tagmap.yaml.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Few frames of 640x480 alone.")] = False,
) -> None:
    """Compare the tracker and the detector with other detectors on this machine.

    Rendered views along the demo's flight (sharp; blurred by 3 to 6 px; noisy; dark) at three
    sizes of image, and photographs if you have some. All run in one process and one thread, frame
    by frame in turns; trust the ratios (how many times faster than apriltag-python at decimate 2,
    CPU time of the thread) more than the milliseconds. The tracker is told where the camera is to
    5 mm and 0.3 deg, as the filter knows it; detectors get the image alone. Recall is that of tags
    wholly in view, by the shortest side in pixels. pyapriltags takes part where it is installed.
    """
    from vio.bench import scenes as scenes

    cases: list[tuple[str, TagMap, Camera, Iterable[View], int]] = []
    for size, count in (_QUICK if quick else _FRAMES).items():
        tag_map, camera = scenes.floor_and_camera(size)
        for look in scenes.LOOKS:
            views = scenes.rendered(tag_map, camera, look, count)
            cases.append((f"{size} {look}", tag_map, camera, views, count))
    if photos is not None:
        tag_map, camera, seen = scenes.photographs(photos)
        cases.append((f"photographs {photos.name}", tag_map, camera, seen, len(seen)))
    if out is not None:
        make_folder(out.parent)
    results, missing, interrupted = _run(cases)
    for text in missing:
        typer.echo(f"left out: {text}", err=True)
    if out is not None:
        from vio.evaluate.compare import write_json

        write_json(out, {"scenes": results, "left_out": missing, "interrupted": interrupted})
        typer.echo(str(out))
    if interrupted:
        typer.echo(f"stopped by Ctrl-C in scene {len(results)} of {len(cases)}", err=True)
        raise typer.Exit(130)


def _run(
    cases: "list[tuple[str, TagMap, Camera, Iterable[View], int]]",
) -> "tuple[dict[str, Any], list[str], bool]":
    """Measure every case and print its table as soon as it is done."""
    from vio.bench import measure as bench
    from vio.bench.scenes import floor_and_camera
    from vio.localize.warmup import warm_tracker

    with waiting("loading compiled code (the first run compiles it, up to two minutes)"):
        warm_tracker(*floor_and_camera("640x480"))
    results: dict[str, Any] = {}
    missing: dict[str, None] = {}
    made: dict[str, tuple[Any, Any]] = {}
    with gently() as stop:
        for title, tag_map, camera, views, count in cases:
            key = f"{tag_map.source} {camera.resolution}"
            if key not in made:
                found, memory, absent = bench.ways(tag_map, camera)
                made = {key: (found, memory)}
                missing |= dict.fromkeys(absent)
            with progress(count, title) as step:
                scores = bench.measure(views, tag_map, camera, made[key][0], step, stop)
            for name, score in scores.items():
                score.memory_mb = made[key][1][name]
            results[title] = _table(title, scores)
            if stop():
                return results, list(missing), True
    return results, list(missing), False


def _table(title: str, scores: "dict[str, Score]") -> dict[str, Any]:
    """Print one scene; its figures by way."""
    from vio.bench.measure import BINS, REFERENCE, figures

    rows = {name: figures(score, scores.get(REFERENCE)) for name, score in scores.items()}
    head = " ".join(f"{low:>4d}+" for low in BINS)
    typer.echo(f"\n{title} ({next(iter(rows.values()))['frames']} frames)")
    typer.echo(
        f"{'':28s} {'faster':>6s} {'ms p50':>7s} {'p99':>7s}  {head} {'rms px':>7s} {'pose mm':>8s}"
        f" {'off':>3s} {'MB':>5s}"
    )
    for name, row in rows.items():
        ms = row["cpu_ms"] or {"p50": None, "p99": None}
        recall = " ".join(_cell(_percent(row["recall_by_px"][str(low)]), 5, 0) for low in BINS)
        typer.echo(
            f"{name:28s} {_cell(row['faster_cpu_p50'], 6, 2)} {_cell(ms['p50'], 7, 2)}"
            f" {_cell(ms['p99'], 7, 2)}  {recall} {_cell(row['corner_rms_px'], 7, 3)}"
            f" {_cell(row['pose_median_mm'], 8, 2)} {row['off_3px']:3d} {row['memory_mb']:5.0f}"
        )
    return rows


def _percent(share: float | None) -> float | None:
    return None if share is None else 100.0 * share


def _cell(value: float | None, width: int, digits: int) -> str:
    return f"{'-':>{width}s}" if value is None else f"{value:{width}.{digits}f}"
