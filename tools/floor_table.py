"""The paper's variants and the joint pose on rendered views of the arena's floor, as a table.

Every place is rendered and searched once; all variants work on the same detections. Exact: the
tags lie where the map says. Misplaced: each place has its own floor, every tag off by the map's
own sigmas (2 mm in x and y, 1 mm in z, 0.3 deg of yaw, 0.1 deg of tilt about x and y), and the
solvers get the map as it should be.
Run: python tools/floor_table.py [--places 200] [--corners exact] [--out floor.md]
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from oracles.floor_study import Errors, Study, study, variants, views
from simulated import HEIGHTS, arena, pinhole

from tagvo.textfile import write_atomic
from vio.terminal import progress

CASES = {"exact map": False, "misplaced tags": True}
FIGURES = {  # heading: of which error, by what
    "mean cm": ("position_cm", np.mean),
    "median cm": ("position_cm", np.median),
    "mean deg": ("rotation_deg", np.mean),
    "median deg": ("rotation_deg", np.median),
}
Studies = dict[str, dict[float, Study]]


def figure(errors: Errors, heading: str) -> float:
    """A figure over the views that had a pose."""
    name, by = FIGURES[heading]
    values = getattr(errors, name)
    return float(by(values[np.isfinite(values)]))


def run_all(args: argparse.Namespace) -> Studies:
    """A study of each case and height."""
    tag_map, camera, configs = arena(), pinhole(), variants(args.ambiguity)
    exact = args.corners == "exact"
    out: Studies = {}
    with progress(2 * len(CASES) * len(args.heights) * args.places, "views") as step:
        for case, misplaced in CASES.items():
            out[case] = {}
            for height in args.heights:
                seen = []
                for view in views(
                    tag_map, camera, height, args.places, args.seed,
                    misplaced=misplaced, exact_corners=exact,
                ):  # fmt: skip
                    seen.append(view)
                    step()
                out[case][height] = study(seen, tag_map, camera, configs, step)
    return out


def table(case: str, studies: dict[float, Study]) -> list[str]:
    """Markdown: a row a variant, and per height mean / median of position and rotation."""
    heads = [f"{h:g} m: cm mean/median, deg mean/median" for h in studies]
    lines = [f"| {case} | {' | '.join(heads)} |", "| --- |" + " ---: |" * len(heads)]
    for name in next(iter(studies.values())).errors:
        cells = []
        for one in studies.values():
            figures = [figure(one.errors[name], heading) for heading in FIGURES]
            cells.append("{:.3f}/{:.3f} {:.3f}/{:.3f}".format(*figures))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    counts = [np.isfinite(s.errors["joint"].position_cm) for s in studies.values()]
    lines.append(f"| views with a pose | {' | '.join(f'{c.sum()} of {c.size}' for c in counts)} |")
    return lines


def findings(results: Studies) -> list[str]:
    """Where the joint pose is not ahead of a TBS-OR, and how far QL2 and CL2 are apart."""
    behind, ratios = [], []
    for case, studies in results.items():
        for height, one in studies.items():
            for name in (n for n in one.errors if n.startswith("TBS-OR")):
                for heading in FIGURES:
                    a, b = figure(one.errors["joint"], heading), figure(one.errors[name], heading)
                    ratios.append(b / a)
                    if a >= b:
                        behind.append(f"{case}, {height:g} m, {heading}: {a:.3f}, {name} {b:.3f}")
    lines = [f"TBS-OR over joint, all figures: {min(ratios):.2f} to {max(ratios):.1f} times."]
    lines += [f"JOINT NOT AHEAD: {text}" for text in behind]
    gaps = [s.gap_deg for studies in results.values() for s in studies.values()]
    every = [s.all_gaps_deg for studies in results.values() for s in studies.values()]
    small, whole = np.concatenate(gaps), np.concatenate(every)
    lines.append(
        f"QL2 against CL2 at spreads below 3 deg: {small.max():.1e} deg at most ({len(small)}"
        f" means); at any spread {whole.max():.1e} deg ({len(whole)} means)."
    )
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--places", type=int, default=200, help="a height and case (200)")
    parser.add_argument("--heights", type=float, nargs="+", default=list(HEIGHTS), metavar="M")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--corners", choices=("detected", "exact"), default="detected",
        help="exact: the found tags with projected corners, as a check",
    )  # fmt: skip
    parser.add_argument(
        "--ambiguity", choices=("first", "consistent"), default="first",
        help="which of a tag's two poses the paper's variants take (first: the paper's)",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, help="write the result there as Markdown, too")
    args = parser.parse_args()
    results = run_all(args)
    head = (
        f"{args.places} places a height, seed {args.seed}, 640x480, f = 530 px, tilt 4 deg,"
        f" {args.corners} corners, ambiguity {args.ambiguity}"
    )
    lines = [head]
    for case, studies in results.items():
        lines += ["", *table(case, studies)]
    text = "\n".join([*lines, "", *findings(results)]) + "\n"
    print(text, end="")
    if args.out:
        write_atomic(args.out, text)
    return int("JOINT NOT AHEAD" in text)


if __name__ == "__main__":
    sys.exit(main())
