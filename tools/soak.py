#!/usr/bin/env python3
"""The daemon for ten minutes at 30 Hz and a 200 Hz IMU against an in-test autopilot.

    python tools/soak.py [--minutes 10] [--rate 30] [--core 0] [--keep DIR]
                         [--set tagvo.track.mode=on ...]

Says whether anything was lost, how old poses are on arrival, how much memory it gained after the
first minute, and what share of a core it took; --core: the daemon runs on that core alone.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / p) for p in ("", "tests", "tests/oracles")]

from soak_flight import soak


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second")
    parser.add_argument("--core", type=int, help="that the daemon is bound to")
    parser.add_argument("--keep", type=Path, help="an empty folder that is kept")
    parser.add_argument("--set", action="append", default=[], help="KEY=VALUE of the daemon")
    chosen = parser.parse_args()
    words = [word for value in chosen.set for word in ("--set", value)]
    with tempfile.TemporaryDirectory() as temporary:
        run(chosen.keep or Path(temporary), chosen.minutes * 60.0, chosen.rate, chosen.core, words)


def run(folder: Path, seconds: float, rate_hz: float, core: int | None, words: list[str]) -> None:
    def each(k: int, daemon: object) -> None:
        if k % 10 == 0:
            print(f"\r{k:5d} of {seconds:.0f} s", end="", file=sys.stderr, flush=True)

    done = soak(folder, seconds, rate_hz=rate_hz, core=core, words=words, each_second=each)
    print(file=sys.stderr)
    status = done.status
    imu_hz, pose_hz = done.imu_sent / done.seconds, done.got / done.seconds
    print(f"{done.seconds:.0f} s: {imu_hz:.1f} IMU samples a second sent, {pose_hz:.2f} poses got")
    print(f"{done.fused} of {done.got} poses fused by the autopilot")
    print(f"lost on the way: {done.missing_imu()} samples, {done.missing_poses()} poses")
    print(f"dropped: {done.lost() or 'nothing'}")
    p50, p99 = np.percentile(done.ages_ms, [50, 99])
    print(f"capture to arrival at the autopilot: {p50:.1f} ms (p99 {p99:.1f})")
    after = min(60, len(done.rss_mb) // 2)
    growth = done.growth_mb(after)
    print(f"RSS {done.rss_mb[after]:.1f} MB after {after} s, growth since {growth:+.2f} MB")
    print(f"CPU: {100 * done.cpu:.0f} % of a core")
    print(f"  by thread, in the last second: {status['cpu']}")
    for stage, ms in status["timing_ms"].items():
        print(f"  {stage}: {ms['p50']:.2f} ms (p99 {ms['p99']:.2f})")
    print(f"counts: {status['counts']}\ncounters: {status['counters']}")


if __name__ == "__main__":
    main()
