#!/usr/bin/env python3
"""Other people's MAVLink stacks at the other end of `tagvio replay`: do they get what we send?

    python tools/peers.py mavsdk            MAVSDK (C++), of the extra `test`, as the receiver
    python tools/peers.py mavproxy          MAVProxy in between, in an environment made for it
        [--env DIR]                         and kept there (default: ~/.cache/tagvio/mavproxy)
    python tools/peers.py autopilot         nobody in between: the in-test autopilot itself
        [--seconds 10]                      of flight
        [--log LOG]                         a flight log of one's own in place of that flight

MAVProxy brings another OpenCV, so it never enters our own environment.
"""

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import threading
import time
import venv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "vio")]

from fc_live import Live, free_port, udp_to
from flying_log import write_flying_log

VISION = "VISION_POSITION_ESTIMATE"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("peer", choices=("mavsdk", "mavproxy", "autopilot"))
    parser.add_argument("--env", type=Path, default=Path("~/.cache/tagvio/mavproxy"))
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--log", type=Path)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = chosen.log or write_flying_log(Path(folder), chosen.seconds)
        if chosen.peer == "mavsdk":
            through_mavsdk(log, Path(folder))
        elif chosen.peer == "autopilot":
            to_the_autopilot(log, Path(folder))
        else:
            through_mavproxy(log, Path(folder), chosen.env.expanduser())


def replay(log: Path, folder: Path, url: str, *words: str) -> int:
    """Run `tagvio replay`, show what it says; the number of poses that it sent."""
    call = ["-c", "from vio.cli import main; main()", "replay", str(log), "--connect", url]
    state = ["--set", f"mavlink.state_file={folder / 'state.json'}"]
    done = subprocess.run(
        [sys.executable, *call, *state, *words], capture_output=True, text=True, check=False
    )
    print(done.stdout, end="")
    if done.returncode:
        sys.exit(done.stderr)
    (line,) = [x for x in done.stdout.splitlines() if "poses sent" in x]
    return int(line.split()[0])


def report(sent: int, got: list[tuple[float, int]]) -> None:
    """got: arrival [s, monotonic] and stamp [us] of each pose."""
    ages = np.array([1e3 * t - 1e-3 * usec for t, usec in got])
    p50, p99 = np.percentile(ages, [50, 99])
    print(f"the peer got {len(got)} of {sent} poses, {p50:.1f} ms old (p99 {p99:.1f})")
    stamps = [usec for _, usec in got]
    if len(got) != sent or stamps != sorted(set(stamps)):
        sys.exit("poses were lost, repeated or out of order")


def through_mavsdk(log: Path, folder: Path) -> None:
    """MAVSDK reads the link; a thread of ours beats like a PX4, which MAVSDK cannot play."""
    from mavsdk.component_type import ComponentType
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.mavlink_direct import MavlinkDirect

    got: list[tuple[float, int]] = []
    fields: list[dict[str, object]] = []

    def take(message: object, _: object) -> None:
        found = json.loads(message.fields_json)  # type: ignore[attr-defined]
        fields.append(found)
        got.append((time.monotonic(), int(found["usec"])))

    ours, theirs = free_port(), free_port()
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    sdk.add_any_connection(f"udpin://127.0.0.1:{theirs}")
    with Live(teed(ours, theirs)):
        runner = threading.Thread(target=listen, args=(sdk, MavlinkDirect, take), daemon=True)
        runner.start()
        sent = replay(log, folder, f"udpin:127.0.0.1:{ours}")
        time.sleep(0.5)
    print(f"MAVSDK {sdk.version()} decodes: { {k: fields[-1][k] for k in ('x', 'y', 'z', 'yaw')} }")
    report(sent, got)


def listen(sdk: object, plugin: type, take: object) -> None:
    """Subscribe once MAVSDK has found the vehicle's system."""
    while not (systems := sdk.get_systems()):  # type: ignore[attr-defined]
        time.sleep(0.05)
    direct = plugin(systems[0])
    direct.subscribe_message(VISION, take)
    threading.Event().wait()  # for as long as the process lives


def teed(ours: int, theirs: int) -> object:
    """The in-test autopilot's line to us, every byte of both ways also to a listener."""
    import socket

    ends = udp_to(ours)
    tap = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    read, write = ends.read, ends.write

    def also(data: bytes) -> bytes:
        with contextlib.suppress(OSError):
            tap.sendto(data, ("127.0.0.1", theirs))
        return data

    ends.read = lambda: also(data) if (data := read()) else data
    ends.write = lambda data: write(also(data))
    return ends


def to_the_autopilot(log: Path, folder: Path) -> None:
    """The in-test autopilot at the other end of the line."""
    port = free_port()
    with Live(udp_to(port)) as live:
        sent = replay(log, folder, f"udpin:127.0.0.1:{port}")
        time.sleep(0.5)
        got = heard(live)
    report(sent, got)


def heard(live: Live) -> list[tuple[float, int]]:
    """The poses that the in-test autopilot got: arrival [s, monotonic], stamp [us]."""
    return [((live.start_ns + t) * 1e-9, m.usec) for t, m in live.fc.heard.get(VISION, [])]


def through_mavproxy(log: Path, folder: Path, env: Path) -> None:
    """autopilot <-> MAVProxy <-> tagvio."""
    program = env / "bin" / "mavproxy.py"
    if not program.exists():
        print(f"making {env} with MAVProxy")
        venv.create(env, with_pip=True)
        subprocess.run([env / "bin" / "pip", "install", "-q", "MAVProxy"], check=True)
    master, out = free_port(), free_port()
    with proxied(env, master, out, folder), Live(udp_to(master)) as live:
        sent = replay(log, folder, f"udpin:127.0.0.1:{out}")
        time.sleep(0.5)
        got = heard(live)
    report(sent, got)


@contextlib.contextmanager
def proxied(env: Path, master: int, out: int, folder: Path) -> Iterator[None]:
    words = [f"--master=udpin:127.0.0.1:{master}", f"--out=udpout:127.0.0.1:{out}", "--daemon",
             "--non-interactive", "--streamrate=-1", "--default-modules=link"]  # fmt: skip
    with (folder / "mavproxy.txt").open("w") as said:
        process = subprocess.Popen(
            [env / "bin" / "python", env / "bin" / "mavproxy.py", *words],
            cwd=folder, stdout=said, stderr=said, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        try:
            time.sleep(3.0)
            yield
        finally:
            process.terminate()
            process.wait(5.0)


if __name__ == "__main__":
    main()
