"""Looks for false locks of the tracker: 10,000 tries with wrong priors over disturbed floors.

A lock is false where a reported tag has a corner more than 2 px from where that tag really is.
Run: python tools/false_lock.py [--images 1000] [--priors 10] [--seed 1]
"""

import argparse
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))
from oracles.false_lock_study import SCENES, study


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--images", type=int, default=1000)
    parser.add_argument("--priors", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    done = [0]

    def step() -> None:
        done[0] += 1
        if done[0] % 100 == 0:
            print(f"{done[0]} of {args.images} images", file=sys.stderr)

    tally = study(args.images, args.priors, args.seed, step)
    print(
        f"{'scene':10s} {'frames':>7s} {'tracked':>8s} {'tags':>8s} {'off 2 px':>8s} {'moved':>6s}"
    )
    for scene in SCENES:
        print(
            f"{scene:10s} {tally.frames[scene]:7d} {tally.tracked[scene]:8d}"
            f" {tally.tags[scene]:8d} {tally.off[scene]:8d} {tally.misled[scene]:6d}"
        )
    print(f"worst corner {tally.worst_px:.2f} px; moved: true in the image, 2 px off the map")
    print(dict(sorted(tally.causes.items())))
    return 1 if sum(tally.off.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
