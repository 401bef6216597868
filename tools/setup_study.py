#!/usr/bin/env python3
"""Wrong set-ups are named, right ones are not: nine edits of one flight, and untouched flights.

    python tools/setup_study.py wrong [--seed 1]            nine mistakes in a simulated t1_qr
    python tools/setup_study.py right [--seeds 20]          t1_qr, t2_qr, t3_qr, seed after seed
    python tools/setup_study.py real                        real logs (TAGVIO_DATA)

`wrong`: finding, share of IMU samples in TRACKING and NEES per dof there, the run forced to its
end; `right` and `real`: the findings, none of which should be. Exit 1 where it is otherwise.
"""

import argparse
import os
import shutil
import sys
import tempfile
from contextlib import closing
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles")]

from setup_faults import CODES, GROSS, judge, tilt_10

from vio.sim.recording import simulated
from vio.sim.scenario import load_scenario, scenario_yaml
from vio.sim.sensors.image_stream import frames
from vio.sim.write_log import write_log

RIGHT = ("t1_qr", "t2_qr", "t3_qr")
REAL = ("euroc_imu_april", "tagslam_aviary", "tagslam_line5")  # the last two: sizes alone


def flight(name, seed, folder):
    scenario = load_scenario(name, [f"seed={seed}"])
    recording = simulated(scenario)
    with closing(frames(recording, scenario, corners=True, workers=1)) as drawn:
        write_log(folder, recording, drawn, scenario_yaml(scenario, "by setup_study"))
    return folder


def said(judged):
    return "; ".join(f"{'certain' if f.certain else 'named'} {f.code} {f.value:.3g}"
                     for f in judged.findings)  # fmt: skip


def wrong(args, work):
    base, bad = flight("t1_qr", args.seed, work / "t1"), 0
    for name, edit in {**GROSS, "T_cam_imu tilted 10": tilt_10}.items():
        log = work / "edited"
        shutil.copytree(base, log)
        edit(log)
        found = judge(log)
        shutil.rmtree(log)
        codes = {f.code for f in found.findings}
        certain = any(f.certain for f in found.findings)
        named = bool(codes & CODES[name])
        fine = named and (certain or found.tracking <= 0.2 or found.nees <= 2.0)
        bad += not fine
        print(f"{name:22s} {'' if fine else 'MISSED '}{said(found)}; forced on: TRACKING"
              f" {100 * found.tracking:.0f} %, NEES there {found.nees:.1f}, resets {found.resets}",
              flush=True)  # fmt: skip
    return bad


def right(args, work):
    bad = 0
    for name in RIGHT:
        for seed in range(args.first, args.first + args.seeds):
            log = flight(name, seed, work / "log")
            found = judge(log)
            shutil.rmtree(log)
            bad += bool(found.findings) or found.noise_words is not None
            print(f"{name} {seed:3d} {said(found) or '-'} {found.noise_words or ''}; TRACKING"
                  f" {100 * found.tracking:.0f} %, NEES {found.nees:.2f}, resets {found.resets}",
                  flush=True)  # fmt: skip
    return bad


def real(args, work):
    bad = 0
    for name in REAL:
        found = judge(Path(os.environ["TAGVIO_DATA"]) / name)
        bad += bool(found.findings)
        print(f"{name} {said(found) or '-'} {found.noise_words or ''}; TRACKING"
              f" {100 * found.tracking:.0f} %, resets {found.resets}", flush=True)  # fmt: skip
    return bad


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("wrong", "right", "real"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        bad = globals()[args.what](args, Path(work))
    print(f"{bad} wrong")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
