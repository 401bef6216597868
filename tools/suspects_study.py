#!/usr/bin/env python3
"""Does a comparison name the tag that was moved by 3 cm, and no other?

    python tools/suspects_study.py [--seeds 20] [--scenario t1_qr ...] [--images]

For each seed a flight over the arena's floor is judged twice: with the map as it is, and with one
of the tags seen moved. By exact corners with noise, or by rendered images (slower).
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).parents[1] / p) for p in ("", "tests/oracles")]

from suspect_study import a_tag, flight, judged


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenario", nargs="+", default=["t1_qr"])
    parser.add_argument("--images", action="store_true")
    chosen = parser.parse_args()
    for name in chosen.scenario:
        named = others = without = 0
        offs, sizes, heights = [], [], []
        for seed in range(1, chosen.seeds + 1):
            recording, seen = flight(seed, name, corners=not chosen.images)
            rng = np.random.default_rng(seed)
            none, all_tags = judged(recording, seen)
            row, offset = a_tag(recording, seen, rng)
            some, found = judged(recording, seen, (row, offset))
            tag_id = int(recording.tag_map.tag_id[row])
            named, others = named + (tag_id in some), others + len(some - {tag_id})
            without += len(none)
            at = np.flatnonzero(found.row == row)
            if len(at):
                offs.append(1e3 * float(np.linalg.norm(found.offset_W[at[0]] - offset)))
            if tag_id not in some:
                print(f"{name} seed {seed}: tag {tag_id} not named, {found.distance[at]} sigmas,"
                      f" seen in {found.frames[at]} frames")  # fmt: skip
            largest = all_tags.distance.max() if len(all_tags.row) else 0.0
            sizes.append(largest)
            heights.append(len(all_tags.row))
        print(
            f"{name}: named {named} of {chosen.seeds}, others {others}; none moved: {without} named"
            f" (largest distance {max(sizes):.1f} sigmas, {np.median(heights):.0f} tags judged);"
            f" offset found to {np.median(offs):.1f} mm (median)"
        )


if __name__ == "__main__":
    main()
