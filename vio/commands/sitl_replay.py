"""What `tagvio replay --sitl` does: a log's IMU and our poses into a simulated autopilot."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from vio.offline.choice import Choice, open_all
from vio.terminal import progress, waiting

if TYPE_CHECKING:
    from numpy.random import Generator

    from vio.evaluate.records import Trajectory
    from vio.sitl.play import Played
    from vio.sitl.records import SitlEnd
    from vio.sources.flight_log.log import FlightLog

Autopilot = Literal["ardupilot", "px4"]
_SEED = 1


def replay_into_sitl(
    choice: Choice,
    url: str,
    autopilot: Autopilot,
    rest_s: float = 30.0,
    port: int | None = None,
) -> None:
    """Play a log in lock step; DIR/fc.tum is the autopilot's estimate, DIR/vio.tum our filter's.

    url: the autopilot's MAVLink link; port: of its simulator interface, None: the usual one
    (ArduPilot's JSON 9002, PX4's 4560). Where the log has truth both are judged against it
    (DIR/comparison.json). Exit code 130 where it was stopped.
    """
    import numpy as np

    from vio.commands import options as opt
    from vio.filter import eskf as flt
    from vio.interrupt import gently
    from vio.localize.localizer import Localizer
    from vio.localize.run import trajectory, tum_rows
    from vio.localize.warmup import warm_up
    from vio.sinks.tum import write_tum
    from vio.sitl.play import play
    from vio.sitl.vision import LogVision

    assigned = (*choice.assignments, f"mavlink.url={url}", f"mavlink.autopilot={autopilot}")
    log, config = open_all(_with(choice, assigned))
    R_BI = np.array(config.vehicle.T_BI)[:3, :3]
    rng = np.random.default_rng(_SEED)
    end = _end(autopilot, rng, port)
    with waiting("loading compiled code (the first run compiles it, up to a minute)"):
        warm_up(log.camera, config.tagvo, config.vio)
    localizer = Localizer(log.camera, log.tag_map, config, log.imu_noise)
    with progress(log.frame_count, "frames") as step, gently() as stop:
        vision = LogVision(log, localizer, step)
        played = play(log, end, vision, config.mavlink, R_BI, rng, rest_s=rest_s, stop=stop)
        interrupted = stop()
    vio = trajectory("vio", vision.outputs)
    for one in (vio, played.fc):
        write_tum(choice.out / f"{one.name}.tum", *tum_rows(one))
    frames: dict[str, int | None] = {"total": vision.frames, "with_pose": vision.with_pose}
    counters = {} if localizer.filter is None else localizer.filter.counters
    frames["fused"] = sum(counters.get(name, 0) for name in flt.TAKEN)
    frames["rejected"] = sum(counters.get(name, 0) for name in flt.REFUSED)
    end_ns = int(vio.known_ns[-1]) if interrupted and len(vio) else None
    _report(log, played, vio, choice.out, frames, end_ns)
    if interrupted:
        opt.exit_stopped(vision.frames, log.frame_count)


def _with(choice: Choice, assignments: tuple[str, ...]) -> Choice:
    from dataclasses import replace

    return replace(choice, assignments=assignments)


def _end(autopilot: Autopilot, rng: "Generator", port: int | None) -> "SitlEnd":
    from vio.sitl import ardupilot, px4

    if autopilot == "ardupilot":
        return ardupilot.ArduPilotEnd(port=ardupilot.PORT if port is None else port)
    return px4.Px4End(rng, port=px4.PORT if port is None else port)


def _report(
    log: "FlightLog", played: "Played", vio: "Trajectory", out: Path,
    frames: dict[str, int | None], end_ns: int | None,
) -> None:  # fmt: skip
    """Say what came out; end_ns: the last moment that was played, None: the log's end."""
    from rich.console import Console

    from vio.evaluate.compare import comparison, table, write_json

    for text in log.warnings:
        typer.echo(f"warning: {text}", err=True)
    counts = ", ".join(f"{n} {cause}" for cause, n in sorted(played.counters.items()))
    typer.echo(f"{played.seconds:.1f} s of simulated time; {counts}")
    typer.echo(f"{len(played.fc)} poses of the autopilot: {out / 'fc.tum'}")
    judged = [one for one in (vio, played.fc) if len(one)]
    if not len(played.fc):
        typer.echo("warning: the autopilot told no position: did it fuse our poses?"
                   " `tagvio doctor` says what is wrong", err=True)  # fmt: skip
    if log.truth is None or not judged:
        return
    content = comparison(judged, log.truth, t_end_ns=end_ns, frames=frames, timing_ms={})
    write_json(out / "comparison.json", content)
    Console().print(table(content))
    typer.echo(str(out / "comparison.json"))
