"""`tagvio demo`: a rendered flight by the paper's pose, the joint pose and the filter, in short."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vio.commands import options as opt
from vio.interrupt import gently
from vio.offline.choice import Choice, make_folder
from vio.terminal import progress

if TYPE_CHECKING:
    from collections.abc import Mapping

    from vio.config import Config
    from vio.localize.baselines import Estimator
    from vio.sources.flight_log.log import FlightLog

_WORKERS = 2
_RUNS = {  # folder: what it is, its configuration below configs/
    "new": ("the paper's pose (TBS-OR-(W2+QL2)-MEF)", "paper/NEW.yaml"),
    "joint": ("the joint pose, alone (vo) and with the IMU in the filter (vio)", "arena.yaml"),
}


def command(
    out: opt.OutFolder = Path("tagvio-demo"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Four seconds of the flight alone.")
    ] = False,
) -> None:
    """Render a short flight over the arena's floor; compare visual odometry alone with the filter.

    Writes a whole flight log to DIR/log (tags laid by hand, a lens that distorts, noise, blur, a
    common IMU, images known 60 ms late) and runs it as `tagvio compare` does: DIR/new is the
    paper's pose, DIR/joint the joint pose and the filter. Both tables are printed; each folder
    holds comparison.json, report.html and the trajectories.
    """
    from vio.commands.compare import judge
    from vio.config.shipped import config_path
    from vio.offline.replay import replay_log, vo_baselines

    make_folder(out)
    log = out / "log"
    _fly(log, quick)
    contents = {}
    for name, (title, config) in _RUNS.items():
        choice = Choice(log, out / name, config_path(config), (), "imu0", False, None, 1, None, 0.0)
        baselines, vo_only = (vo_baselines, True) if name == "new" else (_vo_only, False)
        done = replay_log(choice, baselines, vo_only=vo_only, needs_truth=True, inspect=True)
        typer.echo(f"\n{title[0].upper()}{title[1:]}:")
        contents[name] = judge(done, out / name, 0.0, "none", f"tagvio demo: {title}")
        if done.result.interrupted:
            raise typer.Exit(130)
    typer.echo("\n" + sentence(contents["new"], contents["joint"]))


def _vo_only(log: "FlightLog", config: "Config") -> "list[Estimator]":
    from vio.localize.baselines import VoOnly

    return [VoOnly(log.camera)]


def _fly(log: Path, quick: bool) -> None:
    """Write the flight log; Ctrl-C leaves the frames there are and ends the demo."""
    from tagvo import geometry as geo
    from tagvo.camera.calibration import load_camera
    from tagvo.tags.tag_map import load_map
    from vio.config.shipped import config_path
    from vio.sim import demo as demo
    from vio.sim.sensors.simple_imu import PIXHAWK
    from vio.sinks.log_writer import LogWriter

    tag_map = load_map(config_path("maps/arena.yaml"))
    camera = demo.demo_camera(load_camera(config_path("cameras/arena.yaml")))
    flight = demo.demo_flight()
    frame_ns, truth_ns = demo.stamps(quick)
    t = demo.seconds(truth_ns)
    true = flight(t)
    q_WI = geo.quat_from_matrix(true.R_WI)
    with LogWriter(log, replace=True) as writer:
        writer.setup(tag_map, camera, PIXHAWK)
        for row in zip(truth_ns.tolist(), true.p_WI, q_WI, true.v_WI, strict=True):
            writer.truth(*row)
        for sample in demo.imu_samples(flight, PIXHAWK, quick):
            writer.imu(sample)
        with progress(len(frame_ns), "rendering") as step, gently() as stop:
            drawn = demo.frames(flight, tag_map, camera, frame_ns, _WORKERS)
            for done, frame in enumerate(drawn, 1):
                writer.frame(frame)
                step()
                if stop():
                    text = f"stopped by Ctrl-C after {done} of {len(frame_ns)} frames"
                    typer.echo(f"{text}; {log} holds them", err=True)
                    raise typer.Exit(130)
    typer.echo(f"{log}: {len(frame_ns)} frames of {t[-1] - t[0]:.0f} s", err=True)


def sentence(paper: "Mapping[str, Any]", joint: "Mapping[str, Any]") -> str:
    """What came out, in plain words: rms at the moment of each image, and rms live."""
    a, b = (content["estimators"]["vo"]["capture"] for content in (joint, paper))
    if a is None or b is None:
        return "No pose met truth, so there is nothing to compare."
    ours, theirs = a["position_rmse_m"], b["position_rmse_m"]
    factor = f"{theirs / ours:.1f} times closer" if ours < theirs else "no closer"
    return (
        f"At the moment of each image the joint pose is {1e3 * ours:.1f} mm and"
        f" {a['rotation_rmse_deg']:.2f} deg off (rms), the paper's {1e3 * theirs:.1f} mm and"
        f" {b['rotation_rmse_deg']:.2f} deg: {factor} on the same images.\n{_live(joint)}"
    )


def _live(joint: "Mapping[str, Any]") -> str:
    """What the filter does at each moment, beside the joint pose held until the next one comes."""
    views = joint["estimators"]
    held, live = (views.get(name, {}).get("now") for name in ("vo", "vio"))
    if held is None or live is None or None in (held["position_rmse_m"], live["position_rmse_m"]):
        return "The filter gave nothing to compare live."
    late, now = held["position_rmse_m"], live["position_rmse_m"]
    factor = f"{late / now:.1f} times closer" if now < late else "no closer"
    return (
        f"Live, as a controller feels it, the last joint pose held is {1e3 * late:.1f} mm and"
        f" {held['rotation_rmse_deg']:.2f} deg off, the filter (vio) {1e3 * now:.1f} mm and"
        f" {live['rotation_rmse_deg']:.2f} deg: {factor}, at every IMU sample."
    )
