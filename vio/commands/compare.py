"""`tagvio compare`: one log through several estimators, each against truth."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from vio.commands import options as opt
from vio.offline.choice import Choice

if TYPE_CHECKING:
    from vio.evaluate.records import Window
    from vio.offline.replay import Replayed

Align = Literal["none", "yaw", "se3"]


def command(
    log: opt.LogFolder,
    out: opt.OutFolder,
    config: opt.ConfigFile = None,
    assignments: opt.Assignments = None,
    imu: opt.ImuName = "imu0",
    detections: opt.UseDetections = False,
    vo_only: bool = typer.Option(False, "--vo-only", help="Tag visual odometry alone."),
    only_tags: opt.OnlyTags = None,
    every: opt.Every = 1,
    blackout: opt.Blackout = None,
    latency: opt.Latency = 0.0,
    force: opt.Force = False,
    skip: float = typer.Option(
        0.0, "--skip", metavar="S", min=0.0, max=1e9, help="Judge from S seconds on."
    ),
    align: Align = typer.Option("none", "--align", help="Align to truth before judging."),
    png: bool = typer.Option(False, "--png", help="Also write errors.png and trajectory.png."),
) -> None:
    """Compare estimators on one log against its truth.

    Writes DIR/comparison.json, DIR/report.html (opens offline), DIR/evaluation.json (errors by
    phase, height, speed and tags, drift, consistency, suspect tags) and a .tum trajectory each, and
    prints a table: `capture` compares a pose with truth at its own time, `now` compares what was
    known at each moment of truth. A tag that lies elsewhere than the map says is named.
    """
    choice = Choice(
        log, out, config, tuple(assignments or ()), imu, detections, only_tags, every,
        blackout, latency,
    )  # fmt: skip
    from vio.evaluate.compare import write_json
    from vio.offline.replay import all_baselines, replay_log, run_summary

    done = replay_log(
        choice, all_baselines, vo_only=vo_only, needs_truth=True, inspect=True, force=force
    )
    opt.echo_setup(done.setup, done.refused)
    if done.refused:
        write_json(out / "run.json", run_summary(done))
        for text in done.warnings:
            typer.echo(f"warning: {text}", err=True)
        raise typer.Exit(1)
    judge(done, out, skip, align, f"tagvio compare {done.log.path.name}", png=png)
    if done.result.interrupted:
        raise typer.Exit(130)


def _window(done: "Replayed", skip: float) -> "Window":
    """From `skip` seconds to where the run ended, where a camera's clock is moved to the IMU's.

    A run that was stopped is judged up to the last event it took: it knew nothing of what follows.
    """
    from vio.errors import EvaluationError
    from vio.evaluate.records import Window

    log, reached_ns = done.log, done.result.reached_ns
    shift_ns = round(log.camera.timeshift_s * 1e9)
    start = log.t0_ns if log.imu is not None else log.t0_ns + shift_ns
    end = max(log.end_ns, log.end_ns + shift_ns)
    if start + round(skip * 1e9) > end:
        raise EvaluationError(
            f"--skip {skip:g}: {log.path} lasts {1e-9 * (end - start):.1f} s; fewer are needed"
        )
    if done.result.interrupted and reached_ns is not None:
        end = min(end, reached_ns)
    return Window(start + round(skip * 1e9), end)


def judge(
    done: "Replayed", out: Path, skip: float, align: Align, title: str, *, png: bool = False
) -> "dict[str, Any]":
    """Write what a comparison leaves in `out`, print its table; the content of comparison.json."""
    from rich.console import Console

    from vio.evaluate.compare import comparison_of, table, write_json
    from vio.evaluate.compare import judge as judge_one
    from vio.evaluate.report.png import write_pngs
    from vio.evaluate.report.report import write_report
    from vio.evaluate.truth import clean_truth
    from vio.localize.run import trajectory, tum_rows
    from vio.offline.inspect import inspected
    from vio.offline.replay import frame_counts, run_summary
    from vio.sinks.tum import write_tum

    log, result = done.log, done.result
    assert log.truth is not None
    trajectories = [trajectory(name, outputs) for name, outputs in result.outputs.items()]
    window, truth = _window(done, skip), clean_truth(log.truth)
    judged = [judge_one(t, truth, align, window) for t in trajectories]
    content = comparison_of(judged, align, frame_counts(done), done.timing_ms)
    if result.interrupted:
        content["interrupted"] = True
    for one in trajectories:
        write_tum(out / f"{one.name}.tum", *tum_rows(one))
    write_json(out / "comparison.json", content)
    write_json(out / "run.json", run_summary(done))
    extra, said = inspected(done, judged, truth, window, title)
    write_json(out / "evaluation.json", extra.evaluation)
    write_report(out / "report.html", content, trajectories, log.truth, log.tag_map, extra)
    if png:
        write_pngs(out, judged, truth, log.tag_map, log.t0_ns)
    for text in [*done.warnings, *said]:
        typer.echo(f"warning: {text}", err=True)
    Console().print(table(content))
    typer.echo(f"{out / 'comparison.json'}, {out / 'report.html'}")
    return content
