"""`tagvio simulate`: a flight log of a scenario: images, IMU, truth, and all that goes wrong."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands import options as opt
from vio.interrupt import gently
from vio.terminal import progress, waiting

if TYPE_CHECKING:
    from vio.sim.recording import Recording
    from vio.sim.scenario import Scenario


Name = Annotated[
    str,
    typer.Argument(
        metavar="SCENARIO",
        help="A scenario file, or the name of one that came with tagvio, as t1_qr.",
        show_default=False,
    ),
]
Out = Annotated[
    Path, typer.Option("--out", metavar="LOG", help="Folder of the log; made where missing.")
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, as vehicle=hr; repeat."),
]
Along = Annotated[
    Path | None,
    typer.Option("--along", metavar="LOG2", help="Fly along the truth of this log, with its IMU."),
]
Imu = Annotated[
    str, typer.Option("--imu", metavar="NAME", help="With --along: the IMU that becomes imu0.")
]
Corners = Annotated[
    bool, typer.Option("--detections", help="Write exact corners with noise in place of images.")
]
Workers = Annotated[
    int, typer.Option("--workers", metavar="N", min=1, max=64, help="Images drawn at a time.")
]


def command(
    scenario: Name,
    out: Out,
    assignments: Settings = None,
    along: Along = None,
    imu: Imu = "imu0",
    corners: Corners = False,
    workers: Workers = 2,
    replace: opt.ReplaceLog = False,
) -> None:
    """Simulate a flight and write it as a flight log, for `tagvio run` and `tagvio compare`.

    A scenario says who flies what over which map, and what goes wrong: with the tags, the light,
    the lens, the clocks, the IMU, the calibration. Those that came with tagvio:

    t1_qr, t1_hr, t2_qr, t2_hr, t3_qr, t3_hr, static_qr, static_hr: the paper's flights; clean:
    T3 with nothing wrong but the IMU's noise; nuisances: T3, its rig wrong, its frames late and
    missing; occlusion, sparse, fast: hidden tags, few tags, 4 m/s.

    The same scenario and seed give the same log. LOG/scenario.yaml holds every value that was
    used, LOG/truth_rig.yaml the rig as it was. Ctrl-C leaves the flight so far.

    tagvio simulate t1_hr --out t1 --set seed=3 --set scene.hidden_share=0.3

    tagvio simulate static_hr --out xl --set flight.place=XL --set flight.heights_m=[1.4]

    tagvio simulate nuisances --out fast --detections --set flight.speed_m_s=1.5
    """
    from vio.sim.scenario import load_scenario, scenario_yaml

    if imu != "imu0" and along is None:
        raise typer.BadParameter(
            "it picks an IMU of --along LOG2, which is not given", param_hint="--imu"
        )
    chosen = load_scenario(scenario, assignments or ())
    with waiting("planning the flight"):
        recording = _recording(chosen, along, imu)
    for note in recording.notes:
        typer.echo(note, err=True)
    head = f"Made by tagvio simulate {scenario}" + (
        f" --along {along} --imu {imu}" if along else ""
    )
    done = _write(out, recording, chosen, scenario_yaml(chosen, head), corners, workers, replace)
    total = len(recording.frames)
    if done < total:
        typer.echo(f"stopped by Ctrl-C after {done} of {total} frames; {out} holds them", err=True)
        raise typer.Exit(130)
    typer.echo(f"{out}: {total} frames, {len(recording.imu)} IMU samples")


def _recording(scenario: "Scenario", along: Path | None, imu: str) -> "Recording":
    if along is None:
        from vio.sim.recording import simulated

        return simulated(scenario)
    from vio.sim.rendered_replay import followed

    return followed(scenario, along, imu)


def _write(
    out: Path,
    recording: "Recording",
    scenario: "Scenario",
    text: str,
    corners: bool,
    workers: int,
    replace: bool,
) -> int:
    """The log, with a bar for who watches; how many frames were written."""
    from contextlib import closing

    from vio.sim.sensors.image_stream import frames
    from vio.sim.write_log import write_log

    what = "writing corners" if corners else "rendering"
    with progress(len(recording.frames), what) as step, gently() as stop:
        drawn = frames(recording, scenario, corners=corners, workers=workers)
        with closing(drawn) as pictures:
            return write_log(out, recording, pictures, text, replace=replace, step=step, stop=stop)
