"""`tagvio replay`: a log in real time through the daemon's path into a flight controller."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from vio.commands import options as opt
from vio.offline.choice import Choice, make_folder

if TYPE_CHECKING:
    from vio.daemon.main import Replayed


def command(
    log: opt.LogFolder,
    connect: str = typer.Option(
        ..., "--connect", metavar="URL",
        help="The flight controller: udpin:HOST:PORT, udpout:, tcp:, or serial:DEVICE:BAUD.",
    ),
    speed: float = typer.Option(
        1.0, "--speed", metavar="X", min=0.1, max=10.0, help="Seconds of the log in one of ours."
    ),
    config: opt.ConfigFile = None,
    assignments: opt.Assignments = None,
    imu: opt.ImuName = "imu0",
    detections: opt.UseDetections = False,
    sitl: Literal["ardupilot", "px4"] | None = typer.Option(
        None, "--sitl",
        help="Be the autopilot's simulator too: it flies on the log's IMU, in lock step.",
    ),
    out: Path | None = typer.Option(
        None, "--out", metavar="DIR", help="With --sitl: where fc.tum and comparison.json go.",
    ),
    sitl_port: int | None = typer.Option(
        None, "--sitl-port", min=1, max=65535,
        help="With --sitl: the simulator's port; else ArduPilot's 9002 (JSON) or PX4's 4560.",
    ),
) -> None:  # fmt: skip
    """Play a flight log in real time into a flight controller, as the daemon would fly it.

    Images are looked at live and IMU samples come when the log's did; stamps are mapped to now.
    The flight controller's own IMU is not asked for. The pose it gets is that of the log: a vehicle
    that is elsewhere, or moves otherwise, will not believe it. At another speed than 1 velocities
    are scaled alike.

    With --sitl its filter flies the log's IMU on our poses; DIR/fc.tum is what it estimates, judged
    beside ours where the log has truth.
    """
    if sitl is not None:
        _into_sitl(log, out, config, assignments, imu, detections, connect, sitl, sitl_port)
        return
    if out is not None or sitl_port is not None:
        raise typer.BadParameter("goes with --sitl", param_hint="--out, --sitl-port")
    from vio.commands.daemon import start_log
    from vio.config import load_config
    from vio.daemon import main
    from vio.interrupt import gently
    from vio.sources.flight_log.log import FlightLog
    from vio.terminal import progress

    start_log()
    opened = FlightLog.open(log, imu=imu, use_detections=detections)
    assigned = (*(assignments or ()), f"mavlink.url={connect}")
    loaded = load_config(config or opened.config_path, assigned)
    with progress(opened.frame_count, "frames") as step, gently() as stop:
        done = main.replay(opened, loaded, speed, stop, step)
        interrupted = stop()
    for text in opened.warnings:
        typer.echo(f"warning: {text}", err=True)
    if done is not None:
        _report(done)
    if interrupted:
        opt.exit_stopped(0 if done is None else done.frames, opened.frame_count)


def _into_sitl(
    log: Path, out: Path | None, config: Path | None, assignments: list[str] | None, imu: str,
    detections: bool, connect: str, sitl: Literal["ardupilot", "px4"], port: int | None,
) -> None:  # fmt: skip
    from vio.commands.sitl_replay import replay_into_sitl

    if out is None:
        raise typer.BadParameter("--sitl needs a folder for what comes back", param_hint="--out")
    make_folder(out)
    choice = Choice(log, out, config, tuple(assignments or ()), imu, detections, None, 1, None, 0.0)
    replay_into_sitl(choice, connect, sitl, port=port)


def _report(done: "Replayed") -> None:
    f, result = done.figures, done.result
    typer.echo(
        f"{done.frames} frames and {done.imu} IMU samples played; {result.frames} frames looked"
        f" at, {result.with_pose} with a pose"
    )
    if f.latency_ms is None:
        state = done.status.get("state")
        typer.echo(f"no pose left: the filter is {state}; counters: {done.status.get('counters')}")
        return
    rate = "" if f.rate_hz is None else f" at {f.rate_hz:.1f} a second"
    typer.echo(f"{f.messages} poses sent{rate}, {f.of_frames} of them at a capture")
    typer.echo(
        "frame to message: {:.1f} ms (p99 {:.1f}); ".format(*f.latency_ms)
        + "stamp against true capture: {:.2f} ms (p99 {:.2f})".format(*f.stamp_error_ms)
    )
    typer.echo(f"{100 * done.cpu_share:.0f} % of a core")
    for stage, ms in done.status.get("timing_ms", {}).items():
        typer.echo(f"  {stage}: {ms['p50']:.2f} ms (p99 {ms['p99']:.2f})")
    if done.advice is not None:
        typer.echo(f"delay to set on the flight controller: {done.advice}")
