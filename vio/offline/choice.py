"""Which log is run, with what configuration, and where to: the options of one call, opened."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from vio.config import Config
    from vio.sources.flight_log.log import FlightLog


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

    ids, blackout = ids_of(choice.only_tags), pair_of(choice.blackout)
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


def pair_of(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        period, length = (float(word) for word in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"{text!r}; PERIOD,LENGTH in seconds is needed, as 3,1", param_hint="--blackout"
        ) from None
    return period, length
