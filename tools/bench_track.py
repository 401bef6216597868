"""T1, T2, T3 rendered, the filter in the loop: tracking against a full search at decimate 2.

Both arms have their own detector, tagvo and filter and see the same images frame by frame, in
turns; timed from pixels to the filter's update. Beside them, untimed, decimate 1 says which tags
of 20 px and more there were.
Run: python tools/bench_track.py [--seconds 20] [--hz 15] [--flights T1,T2,T3] [--json FILE]
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is loaded

import argparse
import json
import resource
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from time import perf_counter_ns, thread_time_ns

import numpy as np

sys.path[:0] = [
    str(Path(__file__).parents[1] / "tests"),
    str(Path(__file__).parents[1] / "tests/vio"),
]
from flights import CAMERA
from simulated import arena, corners_seen
from study_flights import FLIGHTS

from tagvo import geometry as geo
from tagvo.config import TagvoConfig
from tagvo.detect.apriltag import AprilTagDetector
from tagvo.records import Frame
from tagvo.render.view import Look, displaced, render_view
from vio.config import Config
from vio.localize.localizer import Localizer
from vio.sim.sensors.simple_imu import PIXHAWK, simulate_imu

CAM = replace(CAMERA, model="radtan", coeffs=np.array([-0.18, 0.05, 0.001, -0.0005]))
SETTINGS = {
    "decimate 2": {"detector": {"decimate": 2.0}},
    "track": {"track": {"mode": "on"}},
}
BIG_PX, NEAR_PX, RIM_PX, LATE_NS, EXPOSURE_S = 20.0, 3.0, 6.0, 60_000_000, 0.004


class Arm:
    """One way from pixels to the filter, with what it took and how far off it was."""

    def __init__(self, settings: dict, tag_map, start) -> None:
        config = TagvoConfig.model_validate(settings)
        whole = Config(tagvo=config)
        self.localizer = Localizer(CAM, tag_map, whole, PIXHAWK, lap=self._lap)
        self.wall, self.cpu, self.how, self.corner, self.error = [], [], Counter(), [], []
        self.stages: dict[str, list[float]] = {}
        self._last = 0

    def _lap(self, stage: str) -> None:
        now = thread_time_ns()
        self.stages.setdefault(stage, []).append((now - self._last) * 1e-6)
        self._last = now

    def frame(self, frame: Frame):
        w, c = perf_counter_ns(), thread_time_ns()
        self._last = c
        self.localizer.process(frame)
        self.cpu.append((thread_time_ns() - c) * 1e-6)
        self.wall.append((perf_counter_ns() - w) * 1e-6)
        trace = self.localizer.trace
        self.how.update({k: v for k, v in trace.counts.items() if v})
        return trace


def fly(name: str, args, arms: dict[str, Arm], tag_map, found: dict) -> None:
    flight, whole = FLIGHTS[name]()
    seconds, rng = min(args.seconds, whole), np.random.default_rng(5)
    floor = displaced(tag_map, np.random.default_rng(12))
    track, _ = simulate_imu(flight, seconds, PIXHAWK, rng)
    R_IC, p_IC = geo.invert(CAM.R_CI, CAM.p_CI)
    reference = AprilTagDetector(tag_map.family, 1.0)
    at, t_imu = 0, track.t_ns
    for k in range(int(seconds * args.hz)):
        t_ns = round(k / args.hz * 1e9)
        while at < len(track) and t_imu[at] <= t_ns + LATE_NS:
            for arm in arms.values():
                arm.localizer.process(track.sample(at))
            at += 1
        motion = flight(np.array([t_ns * 1e-9]) + EXPOSURE_S * np.array([-1.0, 0.0, 1.0]) / 3.0)
        R, p = geo.compose(motion.R_WI, motion.p_WI, R_IC, p_IC)
        image = render_view(
            floor, CAM, R, p, look=Look(texture=12.0), supersample=2, noise_sigma=2.5, rng=rng
        )
        frame = Frame(t_ns, image, arrival_ns=t_ns + LATE_NS)
        rows, px = corners_seen(floor, CAM, R[1], p[1])
        order = list(arms) if k % 2 else list(arms)[::-1]
        traces = {n: arms[n].frame(frame) for n in order}
        judge(reference.detect(image), traces, rows, px, tag_map, found)
        for n, arm in arms.items():
            d = traces[n].detections
            q = d.corners_px - px[np.maximum(tag_map.rows(d.tag_id), 0)]
            arm.corner.append(q[np.abs(q).max(axis=(1, 2)) < NEAR_PX].reshape(-1))
            nav = arm.localizer.filter.nav()
            if nav is not None and t_ns > 3e9:
                truth = flight(np.array([nav.t_ns * 1e-9])).p_WI[0]
                arm.error.append(float(np.linalg.norm(nav.p_WI - truth)))


def judge(full, traces, rows, px, tag_map, found) -> None:
    """Which tags of decimate 1 of 20 px and more, inside the rim, each arm had."""
    q = full.corners_px
    side = geo.shortest_sides(q)
    inside = ((q > RIM_PX) & (q < np.array(CAM.resolution) - 1 - RIM_PX)).all(axis=(1, 2))
    big = set(full.tag_id[(side >= BIG_PX) & inside].tolist())
    for name, trace in traces.items():
        got = set(trace.detections.tag_id.tolist())
        tracked = trace.counts.get("tracked_frames", 0) > 0
        found[name, "all"] += len(big)
        found[name, "had"] += len(big & got)
        if tracked:
            found[name, "tracked_all"] += len(big)
            found[name, "tracked_had"] += len(big & got)


def figures(arm: Arm, found: Counter, name: str) -> dict:
    wall, cpu = np.percentile(arm.wall, [50, 99]), np.percentile(arm.cpu, [50, 99])
    corner = np.concatenate(arm.corner)
    return {
        "wall_ms": {"p50": wall[0], "p99": wall[1]},
        "cpu_ms": {"p50": cpu[0], "p99": cpu[1]},
        "stages_cpu_ms_p50": {s: float(np.median(v)) for s, v in arm.stages.items()},
        "share_of_big_tags": found[name, "had"] / max(found[name, "all"], 1),
        "share_in_tracked_frames": found[name, "tracked_had"] / max(found[name, "tracked_all"], 1),
        "corner_rms_px": float(np.sqrt(2.0 * np.mean(corner**2))),
        "vio_rms_mm": 1e3 * float(np.sqrt(np.mean(np.square(arm.error)))),
        "counts": dict(sorted(arm.how.items())),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--hz", type=float, default=15.0)
    parser.add_argument("--flights", default="T1,T2,T3")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    tag_map, out = arena(), {}
    warm = {n: Arm(s, tag_map, 0.0) for n, s in SETTINGS.items()}
    fly("T2", argparse.Namespace(seconds=4.0, hz=5.0), warm, tag_map, Counter())  # compiles
    for name in args.flights.split(","):
        arms, found = {n: Arm(s, tag_map, 0.0) for n, s in SETTINGS.items()}, Counter()
        fly(name, args, arms, tag_map, found)
        out[name] = {n: figures(arm, found, n) for n, arm in arms.items()}
        a, b = out[name]["decimate 2"], out[name]["track"]
        for clock in ("wall_ms", "cpu_ms"):
            r = {q: a[clock][q] / b[clock][q] for q in ("p50", "p99")}
            out[name][f"speedup_{clock}"] = r
            print(f"{name} {clock}: {r['p50']:.2f} times faster (p50), {r['p99']:.2f} (p99)")
        print(json.dumps(out[name], indent=1))
    out["max_rss_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if args.json:
        args.json.write_text(json.dumps(out, indent=1))


if __name__ == "__main__":
    main()
