#!/usr/bin/env python3
"""What a viewer that has stalled costs a flight: the daemon's latency with it and without.

    python tools/live_cost.py [--pairs 5] [--seconds 20] [--rate 30]

Pairs of flights, one after the other: without a live view, and with one whose client asked for
everything and reads nothing. Medians of capture to arrival at the in-test autopilot.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml

sys.path[:0] = [str(Path(__file__).parents[1] / p) for p in ("", "tests", "tests/oracles")]

import soak_flight

sys.path[:0] = [str(Path(__file__).parents[1] / "tests/vio")]

from fc_live import free_port
from live_client import Client


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=30.0, help="frames a second")
    chosen = parser.parse_args()
    plain = soak_flight.write_config
    found = []
    for k in range(chosen.pairs):
        pair = []
        for live in (None, free_port()) if k % 2 == 0 else (free_port(), None):
            soak_flight.write_config = with_view(plain, live)
            with tempfile.TemporaryDirectory() as folder:
                pair.append((live is not None, *flown(Path(folder), chosen, live)))
        (_, alone, a99, _), (_, stalled, s99, dropped) = sorted(pair)
        found.append((alone, stalled))
        print(
            f"alone {alone:.1f} ms (p99 {a99:.1f}), viewer stalled {stalled:.1f} ms (p99 {s99:.1f})"
            f"; the view dropped {dropped}",
            flush=True,
        )
    alone, stalled = np.median(found, axis=0)
    print(f"median of the pairs: {alone:.1f} and {stalled:.1f} ms, {stalled - alone:+.1f} ms")


def with_view(plain: object, port: int | None) -> object:
    """`write_config` of the soak, with a live view at a port."""

    def write(folder: Path, link: int, **more: object) -> Path:
        path = plain(folder, link, **more)  # type: ignore[operator]
        if port is not None:
            data = yaml.safe_load(path.read_text())
            data["daemon"]["live"] = {"port": port}
            path.write_text(yaml.safe_dump(data))
        return Path(path)

    return write


def flown(folder: Path, chosen: argparse.Namespace, port: int | None) -> tuple[float, float, int]:
    """Median and p99 of the latency [ms] of one flight, and what its view has dropped."""
    clients = []

    def each(k: int, daemon: object) -> None:
        if k == 1 and port is not None:
            client = Client(port)
            client.subscribe()
            clients.append(client)  # and reads no more

    done = soak_flight.soak(folder, chosen.seconds, rate_hz=chosen.rate, each_second=each)
    for client in clients:
        client.socket.close()
    ages = done.ages_ms[len(done.ages_ms) // 5 :]
    dropped = sum(n for k, n in done.status["counters"].items() if k.startswith("live_") and
                  k.endswith("_dropped"))  # fmt: skip
    return (*(float(x) for x in np.percentile(ages, [50, 99])), dropped)


if __name__ == "__main__":
    main()
