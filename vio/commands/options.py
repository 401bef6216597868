"""The options that `run` and `compare` share, and how they open a log."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from vio.config import Config
    from vio.setup_check.findings import Finding
    from vio.sources.flight_log.log import FlightLog

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


@dataclass(frozen=True, slots=True)
class Choice:
    """The options of one call, as typed."""

    log: Path
    out: Path
    config: Path | None
    assignments: tuple[str, ...]
    imu: str
    detections: bool
    only_tags: str | None
    every: int
    blackout: str | None
    latency: float


def open_all(choice: Choice) -> "tuple[FlightLog, Config]":
    """The log and the configuration of a call; wrong texts of options are wrong usage.

    The folder for the results is made first: a long run must not end for want of it.
    """
    from vio.config import load_config
    from vio.sources.flight_log.log import FlightLog

    ids, blackout = ids_of(choice.only_tags), _pair(choice.blackout)
    make_folder(choice.out)
    log = FlightLog.open(
        choice.log,
        imu=choice.imu,
        use_detections=choice.detections,
        only_tags=ids,
        every=choice.every,
        blackout=blackout,
        latency_s=choice.latency,
    )
    return log, load_config(choice.config or log.config_path, choice.assignments)


def make_folder(path: Path) -> None:
    """Make the folder for results; VioError where it cannot be, or cannot be written."""
    from vio.errors import VioError

    try:
        path.mkdir(parents=True, exist_ok=True)
        with TemporaryFile(dir=path):
            pass
    except OSError as err:
        raise VioError(
            f"--out {path}: {err.strerror or err}; a folder that can be written is needed"
        ) from None


def ids_of(text: str | None) -> list[int] | None:
    """Tag ids with commas between them; else wrong usage."""
    if text is None:
        return None
    try:
        return [int(word) for word in text.split(",") if word.strip()]
    except ValueError:
        raise typer.BadParameter(
            f"{text!r}; tag ids with commas are needed, as 14,15,20", param_hint="--only-tags"
        ) from None


def _pair(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        period, length = (float(word) for word in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{text!r}; PERIOD,LENGTH in seconds is needed, as 3,1", param_hint="--blackout"
        ) from None
    return period, length


def echo_setup(findings: "Sequence[Finding]", refused: bool) -> None:
    """Say on stderr what contradicts the files; what is beyond doubt ended the run."""
    for finding in findings:
        if finding.certain and refused:
            typer.echo(f"error: {finding.text} (--force runs on)", err=True)
        else:
            typer.echo(f"warning: {finding.text}", err=True)


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Say on stderr what a person who watches is waiting for."""
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextmanager
def progress(total: int, what: str) -> "Iterator[Callable[[], None]]":
    """A progress bar on stderr where a person watches; yields what to call after each step."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda: None
        return
    columns = ("[progress.description]{task.description}", BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)
