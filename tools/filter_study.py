#!/usr/bin/env python3
"""What the filter reaches: real logs, synthesised poses, simulated flights, seeded starts.

    python tools/filter_study.py april [--latency 0.05]     six rows of euroc_imu_april
    python tools/filter_study.py mh05 [--seeds 20]          poses synthesised from truth
    python tools/filter_study.py autopilots                 the same on both autopilots' logs
    python tools/filter_study.py sim [--seeds 20]           T1, T2, T3 with every nuisance
    python tools/filter_study.py starts [--seeds 1000] [--json FILE]   at rest, moving, hovering

One configuration, the default, for everything. TAGVIO_DATA names the folder of the data.
"""

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from study_flights import FLIGHTS, PoseNoise, PoseStream, circle, hover, simulate_poses, t1

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from tagvo.records import PoseMeasurement
from vio.config.filter import PriorConfig, VioConfig
from vio.filter.eskf import ErrorStateFilter
from vio.records import ImuSample
from vio.sim.sensors.camera_stream import wrong_rig
from vio.sim.sensors.simple_imu import PIXHAWK, simulate_imu
from vio.sources.flight_log.files import read_imu, read_imu_noise, read_phases, read_truth
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally

SLACK_NS = 1000  # stamps of one moment differ by some 100 ns in EuRoC's files
FOUR = [14, 15, 20, 21]
APRIL = {
    "all tags": {}, "four tags": {"only_tags": FOUR},
    "four, every 4th": {"only_tags": FOUR, "every": 4},
    "tag 14": {"only_tags": [14]}, "all, blackouts": {"blackout": (3.0, 1.0)},
    "four, blackouts": {"only_tags": FOUR, "blackout": (3.0, 1.0)},
}  # fmt: skip
IDENTITY = Camera("none", np.array([400.0, 400, 320, 240]), np.zeros(4), (640, 480))
R_CI = geo.exp(np.array([np.pi, 0.0, 0.0])) @ geo.exp(np.array([0.0, 0.0, 0.3]))
RIG = Camera("none", np.array([530.0, 530, 320, 240]), np.zeros(4), (640, 480), R_CI,
             -R_CI @ np.array([0.1, 0.0, -0.05]), 0.03)  # fmt: skip


def rms(x):
    return float(np.sqrt(np.mean(np.sum(np.square(x), axis=-1)))) if len(x) else np.nan


class Errors:
    """Errors of outputs against truth, gathered row by row."""

    def __init__(self):
        self.p, self.r, self.v, self.nees = [], [], [], []

    def add(self, nav, p_WI, R_WI, v_WI=None):
        e = np.concatenate([nav.p_WI - p_WI, geo.log(R_WI.T @ nav.R_WI)])
        self.p.append(e[:3])
        self.r.append(e[3:])
        self.nees.append(e @ np.linalg.solve(nav.cov[:6, :6], e) / 6.0)
        if v_WI is not None:
            self.v.append(nav.v_WI - v_WI)

    def row(self):
        return [1e3 * rms(self.p), np.degrees(rms(self.r)), rms(self.v), float(np.mean(self.nees))]


def april_row(folder, mode, latency, choice, prior):
    log = FlightLog.open(folder, use_detections=True, latency_s=latency, **choice)
    tagvo = TagvoConfig(ambiguity="prior" if prior else "consistent")
    vo = TagVO(log.camera, log.tag_map, tagvo)
    config = VioConfig(update=mode)
    estimator = ErrorStateFilter(config, log.camera, log.imu_noise, log.tag_map, tagvo.floor)
    events, held, vio, last = list(log.events()), [], Errors(), None
    truth = [(int(t), 2, i) for i, t in enumerate(log.truth.t_ns)]
    known = [(e.arrival_ns if e.arrival_ns is not None else e.t_ns) for e in events]
    order = [
        (t, isinstance(e, ImuSample) is False, i)
        for i, (t, e) in enumerate(zip(known, events, strict=True))
    ]
    for t, kind, i in sorted(order + [(t + SLACK_NS, k, i) for t, k, i in truth]):
        if kind == 2:
            R_WI = geo.matrix_from_quat(log.truth.q_WI[i])
            if t - log.t0_ns > 8e9 and last is not None and estimator.nav() is not None:
                vio.add(estimator.nav(), log.truth.p_WI[i], R_WI)
                held.append(last.p_WC + last.R_WC @ log.camera.p_CI - log.truth.p_WI[i])
        elif kind == 0:
            estimator.imu(events[i])
        else:
            trace = vo.trace(events[i], estimator.prior(events[i].t_ns) if prior else None)
            last = trace.pose or last
            if mode == "corners":
                estimator.corners(events[i].t_ns, trace.observations, trace.pose)
            elif trace.pose is not None:
                estimator.pose(trace.pose)
    return vio, 1e3 * rms(held), estimator.counters


def april(args):
    folder = Path(os.environ["TAGVIO_DATA"]) / "euroc_imu_april"
    print("rms mm / p95 mm / deg / NEES per dof | VO held, rms mm | counters")
    for mode in ("pose", "corners"):
        for name, choice in APRIL.items():
            e, held, counters = april_row(folder, mode, args.latency, choice, args.prior)
            mm, deg, _, nees = e.row()
            p95 = 1e3 * np.percentile(np.linalg.norm(e.p, axis=1), 95)
            few = {k: v for k, v in counters.items() if k != "imu"}
            print(
                f"{mode:8s}{name:17s}{mm:6.1f}{p95:6.1f}{deg:6.2f}{nees:6.2f} |{held:6.0f} | {few}"
            )


def synthesised(folder, imu_name, seed, hz, metres, deg, blackout, span=None):
    """One run over a log's IMU with poses made from its truth; judged from 8 s on."""
    rng, tally = np.random.default_rng(seed), Tally()
    imu = read_imu(folder / "mav0" / imu_name / "data.csv", tally)
    truth = read_truth(folder / "mav0/state_groundtruth_estimate0/data.csv", tally)
    estimator = ErrorStateFilter(
        VioConfig(), IDENTITY, read_imu_noise(folder / "imu.yaml", imu_name)
    )
    t0, t1 = span or (int(imu.t_ns[0]), int(imu.t_ns[-1]))
    step = max(1, round(1e9 / hz / float(np.median(np.diff(truth.t_ns)))))
    cov = np.diag(np.repeat([metres**2, np.radians(deg) ** 2], 3))
    R = geo.matrix_from_quat(truth.q_WI)
    rows = np.flatnonzero((truth.t_ns >= t0) & (truth.t_ns <= t1))
    poses = []
    for i in rows[::step]:
        e = rng.normal(size=6) * np.sqrt(np.diag(cov))
        if blackout is None or ((truth.t_ns[i] - t0) * 1e-9) % blackout[0] >= blackout[1]:
            m = PoseMeasurement(
                int(truth.t_ns[i]), truth.p_WI[i] + e[:3], R[i] @ geo.exp(e[3:]), cov, (0,)
            )
            poses.append((m.t_ns, m))
    inside = np.flatnonzero((imu.t_ns >= t0) & (imu.t_ns <= t1))
    samples = [(int(imu.t_ns[i]), int(i)) for i in inside]
    asked = [(int(truth.t_ns[i]) + SLACK_NS, int(i)) for i in rows]
    out = Errors()
    tagged = [(t, 0, i) for t, i in samples] + [(t, 1, i) for i, (t, _) in enumerate(poses)]
    for t, kind, i in sorted(tagged + [(t, 2, i) for t, i in asked]):
        if kind == 0:
            estimator.imu(imu.sample(i))
        elif kind == 1:
            estimator.pose(poses[i][1])
        elif t - t0 > 8e9 and estimator.nav() is not None:
            v = None if truth.v_WI is None else truth.v_WI[i]
            out.add(estimator.nav(), truth.p_WI[i], R[i], v)
    x, bias = estimator.state(), [np.nan, np.nan]
    if truth.b_g is not None:
        bias = [np.abs(x[10:13] - truth.b_g[-1]).max(), np.abs(x[13:16] - truth.b_a[-1]).max()]
    return out.row() + bias


CASES = {"20 Hz 2 cm 0.5 deg": (20, 0.02, 0.5, None), "10 Hz 3 cm 1 deg": (10, 0.03, 1.0, None),
         "10 Hz, blackouts": (10, 0.03, 1.0, (5.0, 1.0))}  # fmt: skip


def mh05(args):
    folder = Path(os.environ["TAGVIO_DATA"]) / "euroc_mh05_first55s"
    print("mean over seeds: rms mm, deg, m/s, NEES per dof | largest bias error, gyro and accel")
    for name, case in CASES.items():
        a = np.array([synthesised(folder, "imu0", s, *case) for s in range(args.seeds)])
        m = a.mean(axis=0)
        print(
            f"{name:20s}{m[0]:6.1f}{m[1]:6.2f}{m[2]:7.3f}{m[3]:6.2f} |"
            f" {a[:, 4].max():.4f} {a[:, 5].max():.3f}"
        )


def autopilots(args):
    print("from hover to land: rms mm, deg, m/s, NEES per dof")
    for name in ("arducopter_flight", "px4_flight"):
        folder = Path(os.environ["TAGVIO_DATA"]) / "autopilot_flights" / name
        phases = {p.name: p for p in read_phases(folder / "phases.csv", Tally())}
        span = (phases["hover"].t_start_ns, phases["land"].t_start_ns)
        for imu in ("imu0", "imu_mavlink"):
            for case in ("20 Hz 2 cm 0.5 deg", "10 Hz, blackouts"):
                row = synthesised(folder, imu, 0, *CASES[case], span)
                print(
                    f"{name:18s}{imu:12s}{case:20s}{row[0]:6.1f}{row[1]:6.2f}{row[2]:7.3f}{row[3]:6.2f}"
                )


def told_noise(stream, rig_too):
    """Outliers left out, the slow errors' share and time known; the oracle has the true rig too."""
    noise = PoseNoise()
    share = noise.slow[0] ** 2 / (noise.slow[0] ** 2 + noise.white[0] ** 2)  # the rotation's: 0.33
    prior = {
        "extrinsic_rotation_deg": 0.001 if rig_too else 2.0 / np.sqrt(3.0),
        "time_offset_s": 1e-5 if rig_too else 0.03,
        "lever_arm_m": 1e-5 if rig_too else 0.01 / np.sqrt(3.0),
    }  # fmt: skip
    config = VioConfig(
        pose_bias_share=share, pose_bias_time_s=noise.slow_s, r_inflation=1.0, r_adapt=False,
        lever_arm=True, extrinsic_walk_rad=0.0, time_offset_walk_s=0.0,
        prior=PriorConfig(**prior),
    )  # fmt: skip
    good = np.flatnonzero(~stream.outlier)
    poses = [stream.poses[i] for i in good]
    return config, PoseStream(poses, stream.arrival_ns[good], stream.outlier[good])


def simulated(name, seed, told):
    """One simulated flight through the filter; told: "everything", "noise" (not the rig) or ""."""
    flight, duration = FLIGHTS[name]()
    return flown(flight, duration, [seed, ord(name[1])], told, PoseNoise())


def flown(flight, duration, seed, told, noise, begin_s=0.0, whole=False):
    """Errors from 3 s after the start; at the end, offset [ms] and extrinsics [deg] too; resets.

    whole: also the times of the errors, and all jumps of the estimate, new starts among them.
    """
    rng = np.random.default_rng(seed)
    imu, _ = simulate_imu(flight, duration, PIXHAWK, rng)
    stream = simulate_poses(flight, duration, RIG, noise, rng)
    rig, config = wrong_rig(RIG, 2.0, 0.01, rng), VioConfig()
    rig = Camera(rig.model, rig.intrinsics, rig.coeffs, rig.resolution, rig.R_CI, rig.p_CI)
    if told:
        config, stream = told_noise(stream, told == "everything")
        rig = RIG if told == "everything" else rig
    estimator = ErrorStateFilter(config, rig, PIXHAWK)
    truth, out, t_s = flight(imu.t_ns * 1e-9), Errors(), []
    events = [(int(t), 0, i) for i, t in enumerate(imu.t_ns) if t >= begin_s * 1e9]
    events += [(int(t), 1, i) for i, t in enumerate(stream.arrival_ns) if t > begin_s * 1e9]
    for t, kind, i in sorted(events):
        if kind == 1:
            estimator.pose(stream.poses[i])
            continue
        nav = estimator.imu(imu.sample(i))
        if nav is not None and t > (begin_s + 3.0) * 1e9 and i % 4 == 0:
            out.add(nav, truth.p_WI[i], truth.R_WI[i], truth.v_WI[i])
            t_s.append(t * 1e-9)
    x = estimator.state()
    jumps = (t_s, estimator.health().resets) if whole else ()
    if x is None:
        return out, np.inf, np.inf, 0, *jumps
    turned = np.degrees(geo.angle(RIG.R_CI @ geo.matrix_from_quat(x[16:20])))
    resets = estimator.counters.get("resets", 0)
    return out, 1e3 * (x[20] - RIG.timeshift_s), turned, resets, *jumps


def _sim_row(task):
    errors, offset, turned, _ = simulated(*task)
    return [*errors.row(), offset, turned]


def in_parallel(work, tasks, jobs):
    if jobs == 1:
        return [work(task) for task in tasks]
    with ProcessPoolExecutor(jobs) as pool:
        return list(pool.map(work, tasks))


def sim(args):
    print(
        "rms over seeds: position cm, deg, velocity cm/s | NEES per dof | offset ms,"
        " extrinsics deg | position over the oracle's"
    )
    for name in FLIGHTS:
        first = None
        for told in ("everything", "noise", ""):
            tasks = [(name, s, told) for s in range(args.seeds)]
            a = np.array(in_parallel(_sim_row, tasks, args.jobs))
            q = np.sqrt(np.mean(np.square(a), axis=0))
            first = first or q[0]
            who = f"told {told}" if told else "the filter"
            print(
                f"{name} {who:16s}{q[0] / 10:6.2f}{q[1]:6.2f}{100 * q[2]:6.2f} |"
                f"{a[:, 3].mean():6.2f} |{q[4]:6.1f}{q[5]:6.2f} | {q[0] / first:.2f}",
                flush=True,
            )


HOW = ("at rest", "moving", "hovering")


def _start_flight(seed, rng):
    """Flight, duration and the time at which its sensors begin: at rest, in motion, hovering."""
    if seed % 3 == 0:
        return *t1()[:1], 14.0, 0.0
    if seed % 3 == 1:
        return *circle(float(rng.uniform(0.0, 1.5)), rng)[:1], 14.0, 2.0
    yaw = float(np.radians(rng.uniform(-5.0, 5.0)))
    return *hover(float(rng.uniform(0.0, 0.1)), yaw, rng, 14.0), 0.0


def _start(seed):
    """Where a start ends: speed then [m/s], largest errors from 3 and 8 s on [m, deg], resets."""
    rng = np.random.default_rng([seed, 77])
    flight, duration, begin = _start_flight(seed, rng)
    noise = PoseNoise(dropouts=0)
    e, t_s, resets = started(flight, duration, [seed, 78], noise, begin)
    v = float(np.linalg.norm(flight(np.array([begin])).v_WI[0]))
    enough = len(e.p) > 0.95 * (duration - begin - 3.0) * 50.0
    far = np.linalg.norm(e.p, axis=1) if enough else np.full(1, np.inf)
    turned = np.degrees(np.linalg.norm(e.r, axis=1)) if enough else np.full(1, np.inf)
    late = np.array(t_s) > begin + 8.0 if enough else np.full(1, True)
    return v, far.max(), turned.max(), rms(e.p), resets, far[late].max(), turned[late].max()


def started(flight, duration, seed, noise, begin_s):
    """Errors from 3 s after the beginning and their times; how often the filter jumped."""
    errors, _, _, _, t_s, resets = flown(flight, duration, seed, "", noise, begin_s, whole=True)
    return errors, t_s, resets


def starts(args):
    """A start is beyond that has no output from 3 s on, or is a metre or 20 deg off after 8 s."""
    a = np.array(in_parallel(_start, range(args.seeds), args.jobs))
    beyond = np.flatnonzero((a[:, 5] > 1.0) | (a[:, 6] > 20.0))
    print(
        f"{args.seeds} starts, at up to {a[:, 0].max():.2f} m/s; beyond {len(beyond)}"
        f" {beyond.tolist()}; resets_max {int(a[:, 4].max())}"
    )
    for k, who in enumerate(HOW):
        b = a[k::3]
        print(
            f"{who:9s} from 3 s on: largest error {100 * b[:, 1].max():.1f} cm,"
            f" {b[:, 2].max():.1f} deg; 99 % {100 * np.percentile(b[:, 1], 99):.1f} cm; from 8 s"
            f" {100 * b[:, 5].max():.1f} cm, {b[:, 6].max():.1f} deg; median rms"
            f" {100 * np.median(b[:, 3]):.1f} cm; resets {int(b[:, 4].sum())}"
        )
    if args.json:
        figures = {
            "starts": args.seeds, "beyond": len(beyond), "beyond_seeds": beyond.tolist(),
            "resets_max": int(a[:, 4].max()), "resets": int(a[:, 4].sum()),
        }  # fmt: skip
        args.json.write_text(json.dumps(figures, indent=1) + "\n")


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("april", "mh05", "autopilots", "sim", "starts"))
    parser.add_argument("--latency", type=float, default=0.0)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1, help="processes, for sim and starts")
    parser.add_argument(
        "--prior", action="store_true", help="tagvo.ambiguity=prior from the filter"
    )
    parser.add_argument("--json", type=Path, help="starts: the figures as a file")
    args = parser.parse_args()
    globals()[args.what](args)


if __name__ == "__main__":
    main()
