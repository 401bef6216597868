"""From the start of `tagvio daemon` to its first pose on the wire: median of some restarts.

A vehicle that hovers is seen on images and flown by the in-test PX4; caches are warm after the
first start, which does not count. Bar: 2 s for a moving vehicle; at rest vio.start.still_s adds 1.
"""

import argparse
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


def restart_s(config: Path, port: int) -> float:
    """Seconds from the process's start to the first pose that the autopilot hears."""
    with Live(udp_to(port)) as live:
        began = time.monotonic()
        with Daemon(config):
            until(lambda: live.fc.heard.get(VISION), PATIENCE_S, "a pose")
            return live.start_ns * 1e-9 + live.fc.heard[VISION][0][0] * 1e-9 - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-n", type=int, default=10, help="restarts that count")
    parser.add_argument("--still-s", type=float, default=1.0, help="its vio.start.still_s")
    n, still_s = parser.parse_args().n, parser.parse_args().still_s
    with tempfile.TemporaryDirectory() as folder:
        write_images(Path(folder) / "images")
        port = free_port()
        config = write_config(Path(folder), port)
        restart_s(config, port)
        took = [restart_s(config, port) for _ in range(n)]
    median = statistics.median(took)
    print(" ".join(f"{one:.2f}" for one in took))
    print(f"median {median:.2f} s, without the still window {median - still_s:.2f} s")


if __name__ == "__main__":
    main()
