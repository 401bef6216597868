"""`tagvio run`: a flight log through the estimators, trajectories and counts to files."""

from pathlib import Path
from typing import Annotated

import typer

from vio.commands import options as opt
from vio.offline.choice import Choice

_CAUSES = {"too_early": "beyond the last IMU sample"}  # the filter's word means: for its IMU


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
    live: Annotated[
        int | None,
        typer.Option("--live", metavar="PORT", min=0, max=65535, help="Serve a Foxglove view."),
    ] = None,
    mcap: Annotated[
        Path | None, typer.Option("--mcap", metavar="FILE", help="Write what a view would show.")
    ] = None,
) -> None:
    """Run a flight log through tagvo and the filter; write trajectories and counts.

    DIR/vo.tum: a line a frame with a pose, at capture time. DIR/vio.tum: a line an IMU sample once
    the filter has started. Poses are those of the IMU in the map, in the form that evo reads.
    DIR/run.json counts frames, faults of the log, what was dropped or rejected and why, the
    filter's states, and times each stage. A set-up that contradicts itself (axes, signs,
    T_cam_imu, clocks, tag sizes, gravity) is named, and ends the run where it is beyond doubt.
    --live and --mcap show images with tags, the map, the body with its trail and covariance, and
    plots in Foxglove (extra `live`).
    """
    from vio.evaluate.compare import write_json
    from vio.localize.run import trajectory, tum_rows
    from vio.offline.replay import replay_log, run_summary, vo_baselines
    from vio.sinks.tum import write_tum

    choice = Choice(
        log, out, config, tuple(assignments or ()), imu, detections, only_tags, every,
        blackout, latency,
    )  # fmt: skip
    done = replay_log(choice, vo_baselines, vo_only=vo_only, force=force, view=(live, mcap))
    if done.refused and not done.result.frames:
        write_json(out / "run.json", run_summary(done))
        opt.echo_setup(done.setup, done.refused)
        raise typer.Exit(1)
    name = "vo" if done.config.tagvo.fir == "none" else "vo_fir"
    write_tum(out / "vo.tum", *tum_rows(trajectory(name, done.result.outputs[name])))
    files = [out / "vo.tum"]
    if done.vio is not None:
        files.append(out / "vio.tum")
        write_tum(files[1], *tum_rows(trajectory("vio", done.result.outputs["vio"])))
    summary = run_summary(done)
    write_json(out / "run.json", summary)
    _report(summary, [*files, out / "run.json"], done.warnings)
    opt.echo_setup(done.setup, done.refused)
    if done.refused:
        raise typer.Exit(1)
    if done.result.interrupted:
        raise typer.Exit(130)


def _report(summary: dict[str, object], files: list[Path], warnings: list[str]) -> None:
    frames, timing = summary["frames"], summary["timing_ms"]
    assert isinstance(frames, dict)
    assert isinstance(timing, dict)
    for text in warnings:
        typer.echo(f"warning: {text}", err=True)
    rejected = summary["rejected"]
    assert isinstance(rejected, dict)
    causes = ", ".join(f"{n} {_CAUSES.get(c, c)}" for c, n in rejected.items()) or "none"
    typer.echo(f"{frames['with_pose']} of {frames['total']} frames gave a pose; without: {causes}")
    if "total" in timing:
        ms = timing["total"]
        typer.echo(f"a frame took {ms['p50']:.2f} ms (p99 {ms['p99']:.2f} ms)")
    if frames["fused"] is not None:
        states = summary["states"]
        assert isinstance(states, dict)
        spent = ", ".join(f"{n} {state}" for state, n in states.items())
        typer.echo(
            f"the filter took {frames['fused']}, rejected {frames['rejected']}; samples: {spent}"
        )
    typer.echo(", ".join(map(str, files)))
