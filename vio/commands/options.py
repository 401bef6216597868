"""The options that commands share, and what several of them say."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import NoReturn

    from vio.setup_check.findings import Finding

LogFolder = Annotated[
    Path, typer.Argument(metavar="LOG", help="A flight log (a folder).", show_default=False)
]
OutFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Where the results go; made where missing.")
]
ConfigFile = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE", help="Configuration; default: LOG/config.yaml."),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, as tagvo.pose=fused; repeat."),
]
ImuName = Annotated[
    str, typer.Option("--imu", metavar="NAME", help="Which IMU of the log: mav0/NAME.")
]
UseDetections = Annotated[
    bool, typer.Option("--detections", help="Take detections.csv even where there are images.")
]
OnlyTags = Annotated[
    str | None, typer.Option("--only-tags", metavar="1,2,..", help="As if only these tags lay.")
]
Every = Annotated[int, typer.Option("--every", metavar="N", help="Use every N-th frame only.")]
Blackout = Annotated[
    str | None,
    typer.Option(
        "--blackout",
        metavar="PERIOD,LENGTH",
        help="No frames while t mod PERIOD < LENGTH, in seconds.",
    ),
]
Latency = Annotated[
    float, typer.Option("--latency", metavar="S", help="Every frame is known S seconds late.")
]
Force = Annotated[
    bool, typer.Option("--force", help="Run on where the set-up is wrong beyond doubt.")
]


ReplaceLog = Annotated[bool, typer.Option("--replace", help="Replace a log that stands at --out.")]


def exit_stopped(done: int, total: int) -> "NoReturn":
    """Say how far work came that Ctrl-C has stopped, and end the command."""
    typer.echo(f"stopped by Ctrl-C after {done} of {total} frames", err=True)
    raise typer.Exit(130)


def echo_setup(findings: "Sequence[Finding]", refused: bool) -> None:
    """Say on stderr what contradicts the files; what is beyond doubt ended the run."""
    for finding in findings:
        if finding.certain and refused:
            typer.echo(f"error: {finding.text} (--force runs on)", err=True)
        else:
            typer.echo(f"warning: {finding.text}", err=True)
