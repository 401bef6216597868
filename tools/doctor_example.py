"""Runs the doctor on an in-test ArduCopter that is set up badly: the example of docs/flying.md.

python tools/doctor_example.py [words for `tagvio doctor`, such as --fix --yes]
"""

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests/vio")]

from fc_ardupilot import ArduPilot
from fc_live import Live, free_port, udp_to
from pymavlink.dialects.v20 import ardupilotmega as m

from vio.cli import main

BAD = {"EK3_SRC1_YAW": 1, "VISO_POS_M_NSE": 0.2, "INS_GYRO_FILTER": 20, "VISO_DELAY_MS": 10}
AGE_NS = 62_000_000


class Visited(ArduPilot):
    """Another companion's poses, 62 ms old, are on the same link."""

    def loop(self, t_ns):
        super().loop(t_ns)
        if not hasattr(self, "other"):
            self.other, self.last_ns_ = m.MAVLink(None, srcSystem=1, srcComponent=191), 0
        if t_ns - self.last_ns_ >= 33_000_000:
            self.last_ns_ = t_ns
            stamp = (LIVE[0].start_ns + t_ns - AGE_NS) // 1000
            pose = m.MAVLink_vision_position_estimate_message(
                stamp, 0, 0, -1, 0, 0, 0, [0.01] * 21, 0
            )
            self.out.append(bytes(pose.pack(self.other)))


LIVE = []


def run() -> None:
    """Start both and let the command speak."""
    port = free_port()
    LIVE.append(Live(udp_to(port), kind=Visited))
    params = LIVE[0].fc.params
    for name, value in BAD.items():
        params[name] = (value, params[name][1])
    with LIVE[0], tempfile.TemporaryDirectory() as folder:
        state = f"mavlink.state_file={folder}/state.json"
        url = f"udpin:127.0.0.1:{port}"
        sys.argv = ["tagvio", "doctor", "--connect", url, "--set", state, *sys.argv[1:]]
        main()


if __name__ == "__main__":
    run()
