#!/usr/bin/env python3
"""How well the autopilot's stamps are mapped to our clock, on the recorded companion links.

    TAGVIO_DATA=... tools/clock_study.py

Every HIGHRES_IMU stamp as the live source maps it when it comes, against references that know the
future too: `line`, a least-squares line through the TIMESYNC midpoints of 10 s around it; and
`midpoints`, the midpoints on both sides of it. `line of its own` is what even the midpoints
themselves are off that line: no mapping that follows the clock can be nearer to it.
"""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "oracles")]

from clock_study import lag_ms, play, quantiles

ROW = "{:18} {:>16} {:8.2f} {:8.2f} {:8.2f}"


def main() -> None:
    """Print the table."""
    folder = os.environ.get("TAGVIO_DATA")
    if not folder:
        sys.exit("tools/clock_study.py: TAGVIO_DATA names no folder")
    print(f"{'[ms]':18} {'against':>16} {'p50':>8} {'p95':>8} {'max':>8}")
    for path in sorted(Path(folder, "autopilot_flights").glob("*/*.tlog")):
        study = play(path)
        line, between, causal = study.line(), study.between(), study.causal()
        print(ROW.format(study.name, "line", *quantiles(causal - line)))
        print(ROW.format("", "midpoints", *quantiles(causal - between)))
        print(ROW.format("", "line of its own", *quantiles(between - line)))
        late = (study.arrival - study.ours)[study.judged] * 1e-6
        print(f"{'':18} arrival after stamp: median {sorted(late)[len(late) // 2]:.2f} ms; "
              f"{study.counters}, steps of the clock: {study.epochs}")  # fmt: skip
        print(f"{'':18} gyro behind the autopilot's own log: {lag_ms(path.parent):.1f} ms, "
              "which no clock shows")  # fmt: skip


if __name__ == "__main__":
    main()
