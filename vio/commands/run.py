"""`tagvio run`: a flight log through the estimators, trajectories and counts to files."""

from pathlib import Path

import typer

from vio.commands import options as opt


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
) -> None:
    """Run a flight log and write DIR/vo.tum (a line a frame with a pose) and DIR/run.json.

    Poses are those of the IMU in the map, at capture time, in the form that evo reads. run.json
    counts frames, faults of the log, dropped detections by cause, and times each stage.
    """
    from vio.commands.replay_log import all_arms, replay_log, run_summary, vo_arms
    from vio.evaluate.compare import write_json
    from vio.run import trajectory, tum_rows
    from vio.sinks.tum import write_tum

    choice = opt.Choice(
        log, out, config, tuple(assignments or ()), imu, detections, only_tags, every,
        blackout, latency,
    )  # fmt: skip
    done = replay_log(choice, vo_arms if vo_only else all_arms)
    name = "vo" if done.config.tagvo.fir == "none" else "vo_fir"
    write_tum(out / "vo.tum", *tum_rows(trajectory(name, done.result.outputs[name])))
    if "vio" in done.result.outputs:
        write_tum(out / "vio.tum", *tum_rows(trajectory("vio", done.result.outputs["vio"])))
    summary = run_summary(done)
    write_json(out / "run.json", summary)
    _report(summary, out, done.log.warnings)
    if done.result.interrupted:
        raise typer.Exit(130)


def _report(summary: dict[str, object], out: Path, warnings: list[str]) -> None:
    frames, timing = summary["frames"], summary["timing_ms"]
    assert isinstance(frames, dict)
    assert isinstance(timing, dict)
    for text in warnings:
        typer.echo(f"warning: {text}", err=True)
    rejected = summary["rejected"]
    assert isinstance(rejected, dict)
    causes = ", ".join(f"{n} {cause}" for cause, n in rejected.items()) or "none"
    typer.echo(f"{frames['with_pose']} of {frames['total']} frames gave a pose; without: {causes}")
    if "total" in timing:
        ms = timing["total"]
        typer.echo(f"a frame took {ms['p50']:.2f} ms (p99 {ms['p99']:.2f} ms)")
    typer.echo(f"{out / 'vo.tum'}, {out / 'run.json'}")
