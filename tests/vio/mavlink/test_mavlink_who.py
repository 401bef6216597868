"""Who is the vehicle: types, claimants at other addresses, moved routers, and links without one."""

import contextlib
import socket
import time
from pathlib import Path

import numpy as np
import pytest
from fc_live import free_port, until
from fc_world import health
from pymavlink.dialects.v20 import ardupilotmega as m

import tagvo
from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError
from vio.mavlink.bridge import Bridge, now_ns
from vio.mavlink.codec import Codec, mavlink
from vio.mavlink.traffic import Traffic
from vio.mavlink.vehicle import Binding, Claim, Vehicle
from vio.records import Moment, NavState

S, MS = 10**9, 10**6
HERE, THERE, ELSEWHERE = ("127.0.0.1", 1001), ("127.0.0.1", 1002), ("127.0.0.1", 1003)


def raw(message, system=1, component=1, key=None):
    mav = m.MAVLink(None, srcSystem=system, srcComponent=component)
    if key is not None:
        mav.signing.secret_key, mav.signing.sign_outgoing = key, True
        mav.signing.timestamp = int((time.time() - 1420070400) * 1e5)
    return bytes(message.pack(mav))


def beat(kind=2, autopilot=3):
    return m.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)


def heard(message, system=1, component=1):
    return Codec(1, 197).decode(raw(message, system, component))[0]


# what a heartbeat must be


@pytest.mark.parametrize("kind", range(46))
def test_the_type_of_a_heartbeat_tells_whether_it_flies(kind):
    never = {5, 6, 18, 26, 27, *range(30, 35), *range(36, 43)}
    for autopilot in (3, 12, 8):
        vehicle = Vehicle(MavlinkConfig())
        flies = kind not in never and autopilot != 8
        assert vehicle.heartbeat(heard(beat(kind, autopilot)), 0) is flies


@pytest.mark.parametrize("named", ["auto", "ardupilot"])
def test_a_router_that_speaks_first_does_not_keep_the_autopilot_away(named):
    vehicle = Vehicle(MavlinkConfig(autopilot=named))
    vehicle.heartbeat(heard(beat(6, 0), 125), 0)
    assert vehicle.fault is None
    vehicle.heartbeat(heard(beat(2, 3), 11), 0)
    assert vehicle.system == 11


def test_of_several_autopilots_a_known_one_is_waited_for(caplog):
    vehicle = Vehicle(MavlinkConfig())
    for _ in range(3):
        assert not vehicle.heartbeat(heard(beat(2, 0), 5), 0)
    assert "mavlink.system_id" in str(vehicle.fault)
    assert len(caplog.records) == 1
    assert vehicle.heartbeat(heard(beat(2, 12), 6), 0)
    assert (vehicle.system, vehicle.fault) == (6, None)


# claims


def bound():
    one = Binding()
    one.bind(HERE, 0)
    return one


def test_a_claimant_is_refused_while_the_bound_address_talks(caplog):
    one = bound()
    for k in range(1, 100):
        assert one.judge(HERE, False, 10 * k * MS) is Claim.HEARD  # any frame of it counts
        assert one.judge(THERE, True, 10 * k * MS + MS) is Claim.REFUSED
    assert one.counters["refused"] == 99
    assert [r.message for r in caplog.records] == [
        "127.0.0.1:1002 claims to be the vehicle, which speaks from 127.0.0.1:1001: refused"
    ]


def test_after_half_a_second_of_silence_the_same_ids_are_adopted_at_once(caplog):
    one = bound()
    assert one.judge(THERE, True, 500 * MS) is Claim.REFUSED
    assert one.judge(THERE, False, 501 * MS) is Claim.HEARD  # another sender's: no claim
    assert one.judge(THERE, True, 501 * MS) is Claim.ADOPTED
    assert one.address == THERE
    assert one.judge(HERE, True, 502 * MS) is Claim.REFUSED
    assert "now speaks from 127.0.0.1:1002" in caplog.text


def test_a_flood_of_claimants_is_a_line_a_second(caplog):
    one = bound()
    for k in range(3000):
        one.judge(HERE, False, k * MS)
        one.judge(("10.0.0.1", 2000 + k), True, k * MS)
    assert one.counters["refused"] == 3000
    assert len(caplog.records) == 3


def test_without_addresses_ids_decide():
    one = Binding()
    assert one.judge(None, True, 0) is Claim.HEARD
    assert one.address is None


# the same on real sockets


@pytest.fixture
def flying(tmp_path):
    """A bridge that listens, and sockets that call it; all are closed whatever happens."""
    port, ends = free_port(), []

    def call(data, end=None):
        if end is None:
            ends.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            ends[-1].setblocking(False)
            end = ends[-1]
        end.sendto(data, ("127.0.0.1", port))
        return end

    def make(**config):
        settings = {"url": f"udpin:127.0.0.1:{port}", "state_file": str(tmp_path / "s.json"),
                    "imu": {"message": "none"}, "origin": None, **config}  # fmt: skip
        made = Bridge(MavlinkConfig.model_validate(settings), np.eye(3), np.zeros(3))
        ends.append(made)
        made.start()
        return made

    yield make, call
    for one in ends:
        one.stop() if isinstance(one, Bridge) else one.close()


def offer(bridge):
    nav = NavState(0, np.zeros(3), np.eye(3), np.zeros(3), np.eye(9) * 1e-4)
    bridge.offer(Moment(now_ns() - 30 * MS, nav, np.zeros(3), np.array([0, 0, -1.0])), health(),
                 True)  # fmt: skip


def got_pose(end):
    codec = Codec(1, 1)
    with contextlib.suppress(BlockingIOError):
        while True:
            for message in codec.decode(end.recv(65536)):
                if message.get_type() == "VISION_POSITION_ESTIMATE":
                    return True
    return False


def test_a_claimant_gets_no_poses_and_a_moved_router_does_within_a_second(flying):
    make, call = flying
    bridge = make()
    fc = call(raw(beat()))
    bridge.wait_for_vehicle(3.0)
    attitude = raw(m.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0))
    thief = call(raw(beat()))
    until(lambda: bridge.counters["refused"] == 1, 2.0, "the refusal")

    def flies(at, *others):
        call(attitude, at)
        for one in others:
            call(raw(beat()), one)
        offer(bridge)
        time.sleep(0.02)
        return got_pose(at)

    until(lambda: flies(fc, thief), 3.0, "a pose")
    assert not got_pose(thief)
    moved = call(attitude)
    began = time.monotonic()
    until(lambda: flies(moved), 3.0, "a pose at the new port")
    assert time.monotonic() - began < 1.0
    assert bridge.counters["address_moved"] == 1


@pytest.mark.parametrize("accept", [False, True])
def test_with_signing_an_unsigned_vehicle_never_counts(flying, tmp_path, accept):
    make, call = flying
    (tmp_path / "key").write_text("k" * 10)
    signing = {"key_file": str(tmp_path / "key"), "accept_unsigned": accept}
    bridge = make(signing=signing)
    call(raw(beat()))
    with pytest.raises(LinkError, match="no heartbeat"):
        bridge.wait_for_vehicle(0.2)
    assert bridge.binding.address is None


# a link without an autopilot: four different words


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "nothing came at all"),
        (bytes(range(1, 200)) * 5, r"995 bytes came and no MAVLink in them.*baud"),
        (raw(beat(18, 8), 1, 191), r"system 1 component 191 \(onboard computer\) alone"),
        (raw(beat(6, 0), 255, 190), r"component 190 \(ground station\) alone"),
        (raw(beat(2, 5)), r"neither ArduPilot \(3\) nor PX4 \(12\).*mavlink.system_id"),
    ],
)
def test_silence_noise_and_others_are_different_words(flying, data, says):
    make, call = flying
    bridge = make()
    if data:
        call(data)
    with pytest.raises(LinkError, match=says) as caught:
        bridge.wait_for_vehicle(0.15)
    assert "\n" not in str(caught.value)


def test_frames_signed_with_another_key_are_told_from_noise(flying, tmp_path):
    make, call = flying
    (tmp_path / "key").write_text("ours")
    bridge = make(signing={"key_file": str(tmp_path / "key")})
    call(raw(beat(), key=b"x" * 32))
    with pytest.raises(LinkError, match=r"not signed with our key.*key_file"):
        bridge.wait_for_vehicle(0.15)


def test_broken_frames_are_logged_once_a_second(caplog):
    traffic = Traffic()
    for k in range(3500):
        traffic.complain(k + 1, k * MS)
    assert len(caplog.records) == 4


def test_an_autopilot_that_signs_and_answers_nothing_is_named_by_the_daemon(flying):
    make, call = flying
    bridge = make()
    frame = raw(beat(), key=b"k" * 32)
    call(frame)
    bridge.wait_for_vehicle(3.0)
    companion = bridge.companion
    start = now_ns()
    signed = Codec(1, 1).decode(frame)[0]
    companion.heard(signed, start)
    companion.due(start + 2 * S)
    assert companion.alarms == {}
    companion.due(start + 3 * S + 200 * MS)
    assert "mavlink.signing.key_file" in companion.alarms["signing"]
    assert mavlink.MAVLINK_IFLAG_SIGNED == 1


# the unit that restarts the daemon in the air


def test_a_crash_loop_is_never_given_up_and_waits_for_no_compiler():
    unit = (Path(__file__).parents[3] / "tools/tagvio.service").read_text()
    lines = unit.splitlines()
    assert {"RestartSec=0.2", "StartLimitIntervalSec=0", "Restart=always"} <= set(lines)
    assert not [line for line in lines if line.startswith("ExecStartPre")]


def test_cameras_and_maps_load_by_a_name_as_by_a_path():
    configs = Path(__file__).parents[3] / "configs"
    assert tagvo.load_camera(str(configs / "cameras/arena.yaml")).resolution == (640, 480)
    assert len(tagvo.load_map(str(configs / "maps/arena.yaml")).tag_id) > 0


def test_noise_of_a_wrong_baud_rate_is_no_mavlink_from_anybody():
    """Random bytes often are a frame of a message that no dialect has: its checksum is unknown."""
    codec, noise = Codec(1, 197), np.random.default_rng(60).bytes(200_000)
    messages = [m for k in range(0, len(noise), 400) for m in codec.decode(noise[k : k + 400])]
    assert messages == []
    assert codec.unknown > 10
    assert codec.bad > 100
