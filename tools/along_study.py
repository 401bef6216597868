#!/usr/bin/env python3
"""Recorded flights of real autopilots with a rendered camera: what each IMU stream is worth.

    TAGVIO_DATA=... python tools/along_study.py [--set KEY=VALUE ...] [--keep DIR]

The camera of configs/scenarios/along.yaml is rendered along the truth of both autopilot_flights and
its tags are found once. The filter then gets the same frames with, in turn, the autopilot's own IMU
log; the same at the stamps of the MAVLink stream; that after ArduPilot's low-pass of 20 Hz, which
the stream has (ArduCopter); the stream itself, in the autopilot's clock, with its arrivals; and the
stream in our clock, as the live mapping stamps it. Live errors (`now`), by phase. An IMU that lags
makes every state lag that is stamped in its clock; `sent` is in the camera's clock, by the offset
that the filter has found, as the daemon stamps what it sends.
"""

import argparse
import os
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import butter, lfilter

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles")]

from clock_study import play

from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from vio.config import Config
from vio.config.filter import VioConfig
from vio.evaluate.metrics import capture_errors, now_errors, stats
from vio.evaluate.records import Window, take
from vio.evaluate.truth import clean_truth
from vio.localize.baselines import VoOnly
from vio.localize.localizer import Localizer
from vio.localize.run import run, trajectory
from vio.records import ImuTrack
from vio.sim.rendered_replay import followed
from vio.sim.scenario import load_scenario, scenario_yaml
from vio.sim.sensors.image_stream import frames
from vio.sim.write_log import write_log
from vio.sources.flight_log.arrivals import read_imu_of
from vio.sources.flight_log.files import read_imu_noise, read_phases, read_truth
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally

CUT_HZ = 20.0
PHASES = ("hover", "T1", "T2", "T3", "T3fast")
HEAD = ("estimator, IMU", *PHASES, "all mm", "deg", "NEES", "sent mm", "offset ms")


def at_stamps(track: ImuTrack, t_ns: np.ndarray) -> ImuTrack:
    """The values of a track at other stamps, known at once."""
    base = int(track.t_ns[0])
    x, xp = (t_ns - base).astype(float), (track.t_ns - base).astype(float)
    gyro, accel = (
        np.stack([np.interp(x, xp, v[:, i]) for i in range(3)], axis=-1)
        for v in (track.gyro_I, track.accel_I)
    )
    return ImuTrack(t_ns, gyro, accel, t_ns.copy())


def low_passed(track: ImuTrack, hz: float) -> ImuTrack:
    """Both sensors after a causal second-order Butterworth, as ArduPilot's LowPassFilter2p."""
    grid = np.arange(track.t_ns[0], track.t_ns[-1], 1_000_000)
    even = at_stamps(track, grid)
    b, a = butter(2, hz, fs=1000.0)
    gyro, accel = (v[0] + lfilter(b, a, v - v[0], axis=0) for v in (even.gyro_I, even.accel_I))
    return replace(even, gyro_I=gyro, accel_I=accel)


def in_our_clock(stream: ImuTrack, tlog: Path) -> ImuTrack:
    """Stamps wrong by what the live clock mapping errs against midpoints of both sides."""
    study = play(tlog)
    wrong_ms = study.causal() - study.between()
    stamps = study.their[study.judged][::10].astype(float)
    off_ns = np.interp(stream.t_ns.astype(float), stamps, 1e6 * wrong_ms, left=0.0, right=0.0)
    t_ns = stream.t_ns + np.rint(off_ns).astype(np.int64)
    return replace(stream, t_ns=t_ns, arrival_ns=np.maximum(stream.arrival_ns, t_ns))


def variants(folder: Path, begin: int) -> dict[str, tuple[str, ImuTrack]]:
    """Name to (whose imu.yaml it is, track from a moment on)."""
    own, stream = (read_imu_of(folder, n, Tally()) for n in ("imu0", "imu_mavlink"))
    (tlog,) = folder.glob("*.tlog")
    out = {
        "own log": ("imu0", own),
        "own log, stream's stamps": ("imu0", at_stamps(own, stream.t_ns)),
    }
    if folder.name.startswith("arducopter"):
        slow = at_stamps(low_passed(own, CUT_HZ), stream.t_ns)
        out[f"the same, {CUT_HZ:g} Hz low-pass"] = ("imu0", slow)
    out["MAVLink, its own clock"] = ("imu_mavlink", stream)
    out["MAVLink, our clock"] = ("imu_mavlink", in_our_clock(stream, tlog))
    return {k: (name, _from(track, begin)) for k, (name, track) in out.items()}


def _from(track: ImuTrack, begin: int) -> ImuTrack:
    keep = track.t_ns >= begin
    return ImuTrack(
        track.t_ns[keep], track.gyro_I[keep], track.accel_I[keep], track.arrival_ns[keep]
    )


def in_the_air(scenario, folder: Path):
    """The scenario from hover to landing: the simulators' truth is of no use at lift-off."""
    t0 = int(read_truth(folder / "mav0/state_groundtruth_estimate0/data.csv", Tally()).t_ns[0])
    phases = {p.name: p for p in read_phases(folder / "phases.csv", Tally())}
    ends = (phases["hover"].t_start_ns, phases["land"].t_start_ns)
    start_s, end_s = (1e-9 * (t - t0) for t in ends)
    along = scenario.along.model_copy(update={"start_s": start_s, "end_s": end_s})
    return scenario.model_copy(update={"along": along})


def found(recording, scenario):
    """All frames with the tags that the detector finds, images let go."""
    vo = TagVO(recording.camera, recording.tag_map, TagvoConfig())
    pictures = frames(recording, scenario, corners=False, workers=2)
    total = len(recording.frames)
    for k, frame in enumerate(pictures):
        if k % 20 == 0:
            print(f"\r{k:5d} of {total} frames", end="", file=sys.stderr, flush=True)
        yield replace(frame, image=None, detections=vo.detect(frame))
    print("\r", end="", file=sys.stderr)


def fly(log: Path, update: str):
    """Errors at every moment of truth of vo and vio; the time offset in the end [ms]."""
    opened = FlightLog.open(log, use_detections=True)
    config = Config(vio=VioConfig(update=update))
    localizer = Localizer(opened.camera, opened.tag_map, config, opened.imu_noise)
    result = run(opened.events(), localizer, [VoOnly(opened.camera)])
    truth, state = clean_truth(opened.truth), localizer.filter.state()
    offset = np.nan if state is None else 1e3 * (state[20] - opened.camera.timeshift_s)
    paths = {n: trajectory(n, result.outputs[n]) for n in ("vo", "vio")}
    return paths, truth, opened.phases, offset


def as_sent(path, frames, t0_ns: int, offset_ns: float):
    """The states at the true times of their stamps in the camera's clock."""
    true_ns = t0_ns + np.rint(1e9 * frames.t_s)
    stamps = (path.t_ns - frames.t_ns[0]) - offset_ns
    shown = (frames.t_ns - frames.t_ns[0]).astype(float)
    t_ns = np.interp(stamps, shown, true_ns - true_ns[0]) + true_ns[0]
    keep = (stamps >= 0.0) & (stamps <= shown[-1])
    return replace(take(path, keep), t_ns=np.rint(t_ns[keep]).astype(np.int64))


def row(who: str, path, truth, phases, sent=None, offset: str = "") -> None:
    spans = {p.name: Window(p.t_start_ns, p.t_end_ns) for p in phases}
    cells = [stats(now_errors(path, truth, spans[n]))["position_rmse_m"] for n in PHASES]
    whole = Window(spans["hover"].t_start_ns, spans["land"].t_start_ns)
    s = stats(now_errors(path, truth, whole))
    nees = s["nees_pose"]
    print(
        f"{who:38s}" + "".join(f"{1e3 * (c or np.nan):9.1f}" for c in cells)
        + f"{1e3 * s['position_rmse_m']:9.1f}{s['rotation_rmse_deg']:9.2f}"
        + f"{np.nan if nees is None else nees:9.2f}"
        + ("" if sent is None else f"{at_captures(sent, truth, whole):9.1f}{offset:>11s}"),
        flush=True,
    )  # fmt: skip


def at_captures(path, truth, window: Window) -> float:
    """Position rms [mm] at the stamps of the states."""
    return 1e3 * stats(capture_errors(path, truth, window))["position_rmse_m"]


def study(folder: Path, scenario, keep: Path) -> None:
    print(
        f"\n{folder.name}\n{HEAD[0]:38s}"
        + "".join(f"{h:>9s}" for h in HEAD[1:-1])
        + f"{HEAD[-1]:>11s}"
    )
    scenario = in_the_air(scenario, folder)
    recording = followed(scenario, folder, "imu0")
    pictures, vo_shown = list(found(recording, scenario)), False
    shift_ms = 1e3 * recording.camera.timeshift_s
    begin = int(recording.truth.t_ns[0]) + round(1e9 * (scenario.along.start_s or 0.0))
    for name, (whose, track) in variants(folder, begin).items():
        noise = read_imu_noise(folder / "imu.yaml", whose)
        log = keep / folder.name / name.replace(" ", "_").replace(",", "").replace("'", "")
        log.parent.mkdir(parents=True, exist_ok=True)
        text = scenario_yaml(scenario, f"along {folder.name}: {name}")
        write_log(
            log, replace(recording, imu=track, noise=noise), iter(pictures), text, replace=True
        )
        for update in ("pose", "corners"):
            paths, truth, phases, offset = fly(log, update)
            if not vo_shown:
                row("vo, held", paths["vo"], truth, phases)
                vo_shown = True
            vio, t0 = paths["vio"], int(recording.truth.t_ns[0])
            sent = as_sent(vio, recording.frames, t0, 1e6 * (offset + shift_ms))
            row(f"vio {update}, {name}", vio, truth, phases, sent, f"{offset:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="words")
    parser.add_argument("--only", metavar="FLIGHT", help="arducopter_flight or px4_flight")
    parser.add_argument("--keep", type=Path, help="a folder for the flight logs")
    chosen = parser.parse_args()
    data = os.environ.get("TAGVIO_DATA")
    if not data:
        sys.exit("tools/along_study.py: TAGVIO_DATA names no folder")
    scenario = load_scenario("along", chosen.words)
    print("position rms [mm] at every moment of truth, by phase; rotation rms; NEES per dof")
    with tempfile.TemporaryDirectory() as temporary:
        for folder in sorted(Path(data, "autopilot_flights").glob("*_flight")):
            if chosen.only in (None, folder.name):
                study(folder, scenario, chosen.keep or Path(temporary))


if __name__ == "__main__":
    main()
