"""`tagvio convert`: other people's logs as flight logs; flight logs as TUM or a ROS 2 bag."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands import options as opt
from vio.interrupt import gently
from vio.terminal import progress, waiting

if TYPE_CHECKING:
    from vio.convert.records import Foreign
    from vio.convert.write import Written
    from vio.sources.flight_log.tally import Tally

Inputs = Annotated[
    list[Path], typer.Argument(metavar="FILE...", help="Files of one flight.", show_default=False)
]
Out = Annotated[
    Path, typer.Option("--out", metavar="OUT", help="Where it goes; its ending says as what.")
]
Topics = Annotated[
    list[str] | None,
    typer.Option("--topic", metavar="WHAT=NAME", help="Of a bag: imu, accel (where the gyro"
                 " has a topic of its own), image, truth, camera or detections; none leaves it"
                 " out. Repeat."),
]  # fmt: skip
Map = Annotated[
    Path | None, typer.Option("--map", metavar="FILE", help="The tag map of the flight.")
]
Camera = Annotated[
    Path | None,
    typer.Option(
        "--camera",
        metavar="FILE[:NAME]",
        help="Calibration of the camera: Kalibr,"
        " EuRoC, ROS, OpenCV, PhotonVision and others; NAME of one of several, as cam1.",
    ),
]
Noise = Annotated[
    Path | None, typer.Option("--imu-noise", metavar="FILE", help="Kalibr's imu.yaml.")
]
ImuCsv = Annotated[
    Path | None,
    typer.Option("--imu-csv", metavar="FILE", help="IMU: timestamp [ns], gyro, specific force."),
]
TruthCsv = Annotated[
    Path | None,
    typer.Option("--truth-csv", metavar="FILE", help="Truth: timestamp [ns], p, q wxyz [, v]."),
]
Stamps = Annotated[
    Path | None,
    typer.Option("--stamps", metavar="FILE", help="Of a video: CSV with timestamp [ns] a frame."),
]
Rectified = Annotated[
    str,
    typer.Option("--rectified", metavar="yes|no|auto", help="Whether a bag's pixels are of"
                 " rectified images (P of camera_info, no distortion); auto: by the topic."),
]  # fmt: skip
Shift = Annotated[
    str, typer.Option("--shift", metavar="X,Y,Z", help="Added to the truth's positions [m].")
]


def command(
    files: Inputs,
    out: Out,
    topic: Topics = None,
    tag_map: Map = None,
    camera: Camera = None,
    noise: Noise = None,
    imu_csv: ImuCsv = None,
    truth_csv: TruthCsv = None,
    stamps: Stamps = None,
    rectified: Rectified = "auto",
    shift: Shift = "0,0,0",
    replace: opt.ReplaceLog = False,
) -> None:
    """Convert the log of another system to a flight log for `tagvio run` and `compare`.

    Reads ROS 1 bags (.bag), ROS 2 bags (the folder, .mcap or .db3), ArduPilot's DataFlash (.bin),
    PX4's ULog (.ulg), recorded MAVLink links (.tlog), videos with CSV files, and flight logs.
    Several files of one flight become one log: a .bin with the .tlog beside it.

    OUT is a flight log; with the ending .mcap a ROS 2 bag in MCAP (a folder); with .tum the truth
    as a TUM trajectory. What an autopilot stamps stays in its clock, uneven as it is; NED and FRD
    become east, north, up and forward, left, up.

    tagvio convert flight.bag --out log --map tagmap.yaml --camera camchain-imucam.yaml

    tagvio convert flight.BIN flight.tlog --out log --shift 2.4,3.4,0

    tagvio convert video.mp4 --stamps frames.csv --imu-csv imu.csv --out log --map tagmap.yaml

    tagvio convert log --out log.mcap
    """
    from vio.convert.open import read_foreign, shifted, together
    from vio.convert.write import read_rig, write_bag, write_flight_log, write_truth
    from vio.errors import LogError
    from vio.sources.flight_log.tally import Tally

    moved, named, flat = _numbers(shift), _topics(topic or []), _yes_or_no(rectified)
    if camera is not None:
        named["camera"] = "none"  # what is given wins, whatever the bag says
    kind, tally = _kind(out, files), Tally()
    with waiting("reading"):
        parts = [(path, read_foreign(path, tally, named, stamps, flat)) for path in files]
        found = shifted(together([*parts, *_tables(imu_csv, truth_csv, tally)]), moved)
    for note in found.notes:
        typer.echo(note, err=True)
    total = 0 if found.frames is None else found.frames.total
    with gently() as stop, progress(total, "writing frames") as step:
        if kind == ".tum":
            said = write_truth(out, found)
        elif kind == ".mcap":
            said = write_bag(out, found, step, stop)
        else:
            rig = read_rig(found, (tag_map, camera, noise), tally)
            said = write_flight_log(out, found, rig, step, stop, replace=replace)
    _echo_written(out, said, tally)
    if stop():
        opt.exit_stopped(said.frames, total)
    if total and not said.frames and kind != ".tum":
        raise LogError(f"{out}: not one of {total} images could be read; {said.text}")


def _kind(out: Path, files: list[Path]) -> str:
    """.tum, .mcap, or nothing for a flight log."""
    from vio.errors import LogError

    if any(out.resolve() == path.resolve() for path in files):
        raise LogError(f"--out {out}: is what is to be converted; another name is needed")
    return out.suffix.lower() if out.suffix.lower() in (".mcap", ".tum") else ""


def _echo_written(out: Path, said: "Written", tally: "Tally") -> None:
    for text in tally.warnings:
        typer.echo(f"warning: {text}", err=True)
    typer.echo(f"{out}: {said.text}")


def _tables(
    imu_csv: Path | None, truth_csv: Path | None, tally: "Tally"
) -> "list[tuple[Path, Foreign]]":
    """IMU and truth of CSV files, as parts of the flight."""
    from vio.convert.records import Foreign
    from vio.sources.flight_log.files import read_imu, read_truth

    out = []
    if imu_csv is not None:
        out.append((imu_csv, Foreign({"imu0": read_imu(imu_csv, tally)})))
    if truth_csv is not None:
        out.append((truth_csv, Foreign(truth=read_truth(truth_csv, tally))))
    return out


def _topics(assignments: list[str]) -> dict[str, str]:
    from vio.convert.topics import TYPES

    out = {}
    for text in assignments:
        what, equals, name = text.partition("=")
        if what not in TYPES or not equals or not name:
            raise typer.BadParameter(
                f"{text!r}; WHAT=NAME is needed, WHAT one of {', '.join(TYPES)}",
                param_hint="--topic",
            )
        out[what] = name
    return out


def _yes_or_no(text: str) -> bool | None:
    known = {"yes": True, "no": False, "auto": None}
    if text not in known:
        raise typer.BadParameter(f"{text!r}; yes, no or auto is needed", param_hint="--rectified")
    return known[text]


def _numbers(text: str) -> list[float]:
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 3 or not all(abs(v) < 1e7 for v in values):
        raise typer.BadParameter(
            f"{text!r}; X,Y,Z in metres is needed, as 2.4,3.4,0", param_hint="--shift"
        )
    return values
