"""Whether the covariances are honest: NEES / 6 of the joint and the fused pose at four heights.

Frames over configs/maps/arena.yaml by exact projection; corner noise of 0.3 px, laying errors and
the calibration's errors are drawn anew for each. Run: python tools/check_covariance.py
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from covariance import FUSED_RANGE, JOINT_RANGE, consistency
from simulated import HEIGHTS


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    print(f"{'height':>6s} {'path':>6s} {'NEES/6':>7s} {'median':>7s} {'max':>8s} {'range':>10s}")
    bad = 0
    for height in HEIGHTS:
        figures = consistency(height, args.frames, args.seed)
        for path, (low, high) in (("joint", JOINT_RANGE), ("fused", FUSED_RANGE)):
            v = figures.values[path]
            good = low < v.mean() < high
            bad += not good
            print(
                f"{height:6.1f} {path:>6s} {v.mean():7.3f} {np.median(v):7.3f} {v.max():8.2f}"
                f" {low:4.2f}-{high:4.2f} {'ok' if good else 'OUT'}"
                f"  ({len(v)} of {figures.frames} places show a tag)"
            )
    return bad


if __name__ == "__main__":
    sys.exit(main())
