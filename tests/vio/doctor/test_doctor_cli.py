"""`tagvio doctor` over real sockets: what a person sees, exit codes, --fix, --json, bad input."""

import json
import sys
import threading
import time

import numpy as np
import pytest
from cli_calls import tagvio
from fc_ardupilot import ArduPilot
from fc_live import Live, free_port, udp_to
from fc_px4 import Px4
from fc_vehicle import Vehicle
from pymavlink.dialects.v20 import ardupilotmega as m

SETTINGS = ("--set", "mavlink.imu={message: none}", "--seconds", "2.5")


@pytest.fixture
def call(tmp_path):
    """Runs the doctor on a live in-test autopilot; prepare(fc) before it starts."""

    def run(kind, *words, prepare=lambda fc: None, stdin=None):
        port = free_port()
        live = Live(udp_to(port), kind=kind)
        prepare(live.fc)
        before = sys.stdin
        if stdin is not None:
            sys.stdin = stdin
        state = f"mavlink.state_file={tmp_path / 'state.json'}"
        try:
            with live:
                done = tagvio("doctor", "--connect", f"udpin:127.0.0.1:{port}", "--set", state,
                              *SETTINGS, *words)  # fmt: skip
        finally:
            sys.stdin = before
        return done, live.fc

    return run


def broken(fc):
    for name, value in (("VISO_TYPE", 0), ("EK3_SRC1_YAW", 1), ("INS_GYRO_FILTER", 20)):
        fc.params[name] = (value, fc.params[name][1])


def test_a_good_vehicle_is_exit_0_and_nothing_is_changed(call):
    done, fc = call(Px4)
    assert done.code == 0, done.err
    assert "PX4, system 1, disarmed: 0 errors, 0 warnings" in done.out
    assert "round trip least" in done.out
    assert not {"PARAM_SET", "SET_GPS_GLOBAL_ORIGIN", "VISION_POSITION_ESTIMATE"} & set(fc.heard)
    assert "STATUSTEXT" not in fc.heard or not any(
        "no more poses" in t.text for _, t in fc.heard["STATUSTEXT"]
    )


def test_errors_are_exit_1_with_what_to_set(call, tmp_path):
    file = tmp_path / "found.json"
    done, _ = call(ArduPilot, "--json", file, prepare=broken)
    assert done.code == 1
    assert "-> set VISO_TYPE 1" in done.out
    assert "2 errors" in done.out
    content = json.loads(file.read_text())
    codes = {f["code"]: f for f in content["findings"]}
    assert codes["EK3_SRC1_YAW"]["change"] == {"name": "EK3_SRC1_YAW", "old": 1.0, "new": 6.0}
    assert content["parameters"]["VISO_TYPE"] == 0
    assert content["autopilot"] == "ardupilot"
    assert content["latency"]["advised"] is None


def test_fix_shows_asks_writes_and_reads_back(call):
    done, fc = call(ArduPilot, "--fix", "--yes", prepare=broken)
    assert done.code == 0, done.out
    assert "VISO_TYPE: 0 -> 1" in done.out
    assert "VISO_TYPE 1: written" in done.out
    assert fc.params["VISO_TYPE"][0] == 1
    assert fc.params["EK3_SRC1_YAW"][0] == 6
    assert fc.params["INS_GYRO_FILTER"][0] == 20, "what belongs to the tuning is left to a person"


class Lines:
    """A stdin that answers."""

    def __init__(self, *lines, each=lambda n: None):
        self.lines, self.each, self.n = list(lines), each, 0

    def readline(self, *_):
        self.each(self.n)
        self.n += 1
        return self.lines.pop(0) if self.lines else ""

    def isatty(self):
        return False


def test_fix_writes_nothing_without_a_yes(call):
    done, fc = call(ArduPilot, "--fix", prepare=broken, stdin=Lines("n\n"))
    assert done.code == 1
    assert "VISO_TYPE: 0 -> 1" in done.out
    assert "PARAM_SET" not in fc.heard


def test_fix_refuses_an_armed_vehicle(call):
    def armed(fc):
        broken(fc)
        fc.armed = True

    done, fc = call(ArduPilot, "--fix", "--yes", prepare=armed)
    assert done.code == 1
    assert "armed: nothing is written" in done.err
    assert len(done.err.strip().splitlines()) == 1
    assert "PARAM_SET" not in fc.heard


def test_px4s_whole_numbers_are_written_as_bits(call):
    def wrong(fc):
        fc.params["EKF2_EV_CTRL"] = (0, 6)

    done, fc = call(Px4, "--fix", "--yes", prepare=wrong)
    assert done.code == 0, done.out
    assert fc.params["EKF2_EV_CTRL"] == (11, 6)


def test_an_unknown_autopilot_is_one_line(call):
    def unknown(fc):
        fc.kind = m.MAV_AUTOPILOT_OPENPILOT

    done, _ = call(ArduPilot, prepare=unknown)
    assert done.code == 1
    assert "neither ArduPilot" in done.err
    assert len(done.err.strip().splitlines()) == 1


@pytest.mark.parametrize(("url", "says"), [
    ("nonsense", "is needed"), ("udpin:127.0.0.1:99999", "65535"),
    ("serial:/dev/does_not_exist:921600", "no such device"),
])  # fmt: skip
def test_a_wrong_url_is_one_line(url, says, tmp_path):
    state = f"mavlink.state_file={tmp_path / 'state.json'}"
    done = tagvio("doctor", "--connect", url, "--set", state)
    assert done.code == 1
    assert says in done.err
    assert len(done.err.strip().splitlines()) == 1


def test_wiggle_names_a_wrong_yaw(call):
    """A hand carries the in-test vehicle at 60 degrees; what it reports of its yaw is negated."""

    class Reporting(Px4):
        def local(self):
            return self.vehicle.p

        def compass(self):
            return -self.vehicle.yaw

    vehicle = Vehicle(yaw=np.radians(60.0))

    def move(n):
        ahead = 0.5 * np.array([np.cos(vehicle.yaw), np.sin(vehicle.yaw), 0.0])
        if n == 1:
            vehicle.p = vehicle.p + np.array([0.0, 0.0, -0.4])
        elif n in (2, 4):
            vehicle.p = vehicle.p + ahead
        elif n == 3:
            vehicle.yaw += np.radians(85.0)

    def prepare(fc):
        fc.vehicle = vehicle

    done, _ = call(Reporting, "--wiggle", prepare=prepare, stdin=Lines(*["\n"] * 5, each=move))
    assert done.code == 1
    assert "negate yaw" in done.out, done.out
    assert "axis_z" not in done.out


def test_it_gives_the_link_back_and_leaves_no_thread(call):
    before = {t.name for t in threading.enumerate()}
    begin = time.monotonic()
    call(Px4)
    assert time.monotonic() - begin < 9.0
    assert "mavlink" not in {t.name for t in threading.enumerate()} - before
