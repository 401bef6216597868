"""From the start of `tagvio daemon` to its first pose on the wire: median of some restarts.

A vehicle that hovers is seen on images and flown by the in-test PX4, whose heartbeats come at any
phase; caches are warm after the first start, which does not count. Bar: 2 s for a moving vehicle,
for which the start does not wait for rest: so here, where no rest is believed, unless --rest (then
vio.start.still_s adds 1).
"""

import argparse
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path[:0] = [
    str(Path(__file__).parents[1] / "tests/vio"),
    str(Path(__file__).parents[1] / "tests"),
]

from fc_live import Live, free_port, udp_to, until
from still_flight import Daemon, write_config, write_images

VISION = "VISION_POSITION_ESTIMATE"
PATIENCE_S = 300.0  # the first start may compile


NO_REST = ("--set", "vio.start.still_gyro_rad_s=1e-5")


def restart_s(config: Path, port: int, phase_s: float, words: tuple[str, ...]) -> float:
    """Seconds from the process's start to the first pose that the autopilot hears."""
    byte_code = {"PYTHONDONTWRITEBYTECODE": "", "PYTHONPYCACHEPREFIX": str(config.parent / "pyc")}
    with Live(udp_to(port)) as live:
        time.sleep(phase_s)
        began = time.monotonic()
        with Daemon(config, *words, env=byte_code):
            until(lambda: live.fc.heard.get(VISION), PATIENCE_S, "a pose")
            return live.start_ns * 1e-9 + live.fc.heard[VISION][0][0] * 1e-9 - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=10, help="restarts that count")
    parser.add_argument("--rest", action="store_true", help="the vehicle stands still")
    given = parser.parse_args()
    words = () if given.rest else NO_REST
    with tempfile.TemporaryDirectory() as folder:
        write_images(Path(folder) / "images")
        port = free_port()
        config = write_config(Path(folder), port)
        restart_s(config, port, 0.0, words)
        took = [restart_s(config, port, k / given.n, words) for k in range(given.n)]
    print(" ".join(f"{one:.2f}" for one in took))
    print(f"median {statistics.median(took):.2f} s, load {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
