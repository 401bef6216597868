"""Each of the doctor's rules once broken and once right; the sets that are shipped pass."""

from dataclasses import replace

import pytest
from fc_params import ARDUPILOT, PX4

from vio.config.mavlink import MavlinkConfig
from vio.doctor import checks as doctor
from vio.doctor.parameter_sets import shipped
from vio.doctor.records import Facts, Severity, VisionSeen
from vio.doctor.rules.delay import delay, words

AP, PX = 3, 12
GOOD = {AP: {n: v for n, (v, _) in ARDUPILOT.items()}, PX: {n: v for n, (v, _) in PX4.items()}}
SEEN = VisionSeen("VISION_POSITION_ESTIMATE", 30.0, (59.0, 60.0, 62.0))


def config(**keys):
    return MavlinkConfig.model_validate({"url": "udpin:127.0.0.1:14540", **keys})


def facts(autopilot, **keys):
    """A vehicle at which nothing is wrong, but for what is said."""
    good = {
        "config": config(), "seconds": 60.0, "params": GOOD[autopilot], "timesync_asked": 600,
        "rtts_ms": (2.0, 3.0, 2.5), "imu_hz": 200.0, "ekf_flags": 0b1100111111, "origin": True,
        "home": True, "vision": replace(SEEN, ages_ms=(1.0,)) if autopilot == PX else SEEN,
    }  # fmt: skip
    return Facts(**{"autopilot": autopilot, **good, **keys})


def found(f):
    return {finding.code: finding for finding in doctor.check(f)}


def bad(f):
    return {code: one for code, one in found(f).items() if one.severity is not Severity.INFO}


@pytest.mark.parametrize("autopilot", [AP, PX])
def test_nothing_is_wrong_where_nothing_is(autopilot):
    assert bad(facts(autopilot)) == {}
    assert not doctor.failed(doctor.check(facts(autopilot)))


@pytest.mark.parametrize("autopilot", [AP, PX])
def test_the_shipped_sets_pass_and_every_name_in_them_is_looked_at(autopilot):
    delay_name = "VISO_DELAY_MS" if autopilot == AP else "EKF2_EV_DELAY"
    values = {**GOOD[autopilot], **shipped(autopilot)}
    assert bad(facts(autopilot, params=values)) == {}
    read = {name for group in doctor.names(autopilot) for name in group}
    ports = {n for n in shipped(autopilot) if n.startswith("SERIAL2_OPT")}
    assert set(shipped(autopilot)) - read <= ports
    assert delay_name in read


PARAMETERS = [
    (AP, "AHRS_EKF_TYPE", 2, "error"), (AP, "EK3_ENABLE", 0, "error"),
    (AP, "EK2_ENABLE", 1, "warning"), (AP, "GPS1_TYPE", 1, "warning"),
    (AP, "COMPASS_ENABLE", 1, "warning"), (AP, "FS_EKF_ACTION", 0, "warning"),
    (AP, "FS_EKF_THRESH", 0, "warning"), (AP, "FS_EKF_THRESH", 1.0, "warning"),
    (AP, "VISO_TYPE", 0, "error"), (AP, "VISO_TYPE", 2, "warning"),
    (AP, "VISO_POS_M_NSE", 0.2, "warning"), (AP, "VISO_YAW_M_NSE", 0.2, "warning"),
    (AP, "VISO_QUAL_MIN", 1, "error"), (AP, "VISO_POS_X", 0.1, "warning"),
    (AP, "VISO_POS_Y", 0.1, "warning"), (AP, "VISO_POS_Z", -0.1, "warning"),
    (AP, "VISO_SCALE", 1.1, "error"), (AP, "EK3_SRC1_POSXY", 3, "error"),
    (AP, "EK3_SRC1_POSZ", 1, "warning"), (AP, "EK3_SRC1_YAW", 1, "error"),
    (AP, "EK3_SRC1_VELXY", 6, "warning"), (AP, "EK3_SRC1_VELZ", 6, "warning"),
    (AP, "INS_GYRO_FILTER", 20, "warning"), (AP, "INS_ACCEL_FILTER", 20, "warning"),
    (AP, "ARMING_CHECK", 0, "warning"), (AP, "FENCE_ENABLE", 0, "info"),
    (AP, "VISO_DELAY_MS", 10, "warning"),
    (PX, "EKF2_EN", 0, "error"), (PX, "EKF2_EV_CTRL", 9, "error"), (PX, "EKF2_EV_CTRL", 3, "error"),
    (PX, "EKF2_HGT_REF", 0, "warning"), (PX, "EKF2_EV_QMIN", 50, "error"),
    (PX, "EKF2_RNG_CTRL", 1, "warning"), (PX, "EKF2_GPS_CTRL", 7, "warning"),
    (PX, "EKF2_BARO_CTRL", 2, "warning"), (PX, "EKF2_MAG_TYPE", 0, "warning"),
    (PX, "SYS_HAS_MAG", 1, "warning"), (PX, "SYS_HAS_GPS", 1, "warning"),
    (PX, "COM_ARM_WO_GPS", 0, "error"), (PX, "EKF2_EV_NOISE_MD", 1, "warning"),
    (PX, "EKF2_EVP_NOISE", 0.1, "warning"), (PX, "EKF2_EVA_NOISE", 0.1, "warning"),
    (PX, "EKF2_EVP_GATE", 1.0, "warning"), (PX, "EKF2_EV_POS_X", 0.1, "warning"),
    (PX, "EKF2_EV_POS_Y", 0.1, "warning"), (PX, "EKF2_EV_POS_Z", 0.1, "warning"),
    (PX, "MAV_PROTO_VER", 1, "error"), (PX, "EKF2_EV_DELAY", 100, "warning"),
]  # fmt: skip


@pytest.mark.parametrize(("autopilot", "name", "value", "severity"), PARAMETERS)
def test_a_wrong_parameter_is_named_and_its_change_mends_it(autopilot, name, value, severity):
    f = facts(autopilot, params={**GOOD[autopilot], name: value})
    one = found(f)[name]
    assert one.severity == severity
    assert name in one.what + one.do
    assert len(one.why) > 20
    assert doctor.failed(doctor.check(f)) == (severity == "error")
    by_hand = name in ("INS_GYRO_FILTER", "INS_ACCEL_FILTER", "FENCE_ENABLE")
    assert (one.change is None) == by_hand
    mended = float(one.do.split()[-1]) if by_hand else one.change.new
    assert name not in found(replace(f, params={**f.params, name: mended}))


def test_every_parameter_rule_has_a_broken_case():
    tried = {name for _, name, _, _ in PARAMETERS}
    for autopilot in (AP, PX):
        names = [r.names for r in doctor.param_rules(autopilot)]
        old = {"EKF2_AID_MASK", "EKF2_HGT_MODE"}  # has a test of its own
        assert [n for n in names if not set(n) & (tried | old)] == []


def test_older_firmware():
    old = {n: v for n, v in GOOD[PX].items() if n not in ("EKF2_EV_CTRL", "EKF2_HGT_REF")}
    f = facts(PX, params={**old, "EKF2_AID_MASK": 24, "EKF2_HGT_MODE": 3})
    assert bad(f) == {}
    broken = bad(replace(f, params={**f.params, "EKF2_AID_MASK": 1, "EKF2_HGT_MODE": 0}))
    assert broken["EKF2_AID_MASK"].change.new == 24
    assert broken["EKF2_HGT_MODE"].change.new == 3
    gps = {n: v for n, v in GOOD[AP].items() if n != "GPS1_TYPE"}
    assert set(bad(facts(AP, params={**gps, "GPS_TYPE": 1}))) == {"GPS_TYPE"}


def test_what_does_not_exist():
    small_board = {n: v for n, v in GOOD[AP].items() if not n.startswith("VISO")}
    one = found(facts(AP, params=small_board))["VISO_TYPE"]
    assert one.severity == "error"
    assert "1 MB" in one.do
    assert "VISO_TYPE" not in found(facts(AP, params=small_board, complete=False))
    switched = {n: v for n, v in small_board.items()} | {"VISO_TYPE": 1}
    assert "restart" in found(facts(AP, params=switched))["VISO_POS_M_NSE"].do
    assert found(facts(AP, params={}))["parameters"].severity == "error"
    assert found(facts(AP, complete=False))["parameters"].severity == "warning"


def test_quality_and_velocity_go_with_the_message_that_is_sent():
    odometry = config(message="ODOMETRY")
    ap = {**GOOD[AP], "VISO_QUAL_MIN": 30, "EK3_SRC1_VELXY": 6, "EK3_SRC1_VELZ": 6}
    f = facts(AP, config=odometry, params=ap, vision=None)
    assert bad(f) == {}
    assert "VISO_QUAL_MIN" in bad(replace(f, params={**ap, "VISO_QUAL_MIN": 31}))
    assert {"VISO_QUAL_MIN", "EK3_SRC1_VELXY", "EK3_SRC1_VELZ"} == set(bad(facts(AP, params=ap)))
    assert "EK3_SRC1_VELXY" not in bad(facts(AP, params=ap, config=config(speed=True)))
    px = {**GOOD[PX], "EKF2_EV_QMIN": 30}
    assert bad(facts(PX, config=odometry, params=px, vision=None)) == {}
    assert found(facts(PX, params=px))["EKF2_EV_QMIN"].severity == "error"


def test_a_range_finder_makes_its_aiding_an_error():
    on = {**GOOD[PX], "EKF2_RNG_CTRL": 1}
    assert found(facts(PX, params=on, range_finder=True))["EKF2_RNG_CTRL"].severity == "error"
    assert bad(facts(PX, range_finder=True)) == {}


LINK = [
    (AP, {"alive": False}, "silent", "error"),
    (AP, {"version_1": True}, "mavlink_1", "error"),
    (PX, {"version_1": True}, "mavlink_1", "error"),
    (PX, {"timesync_asked": 0}, "timesync_not_asked", "error"),
    (PX, {"timesync_asked": 100}, "timesync_seldom", "warning"),
    (PX, {"timesync_asked": 100, "seconds": 10.0}, "timesync_converging", "info"),
    (AP, {"rtts_ms": ()}, "timesync_no_answer", "warning"),
    (PX, {"rtts_ms": (3.0, 12.0, 3.0, 3.0)}, "timesync_slow", "warning"),
    (PX, {"rtts_ms": (12.0, 13.0, 3.0)}, "timesync_slow", "error"),
    (AP, {"clock_steps": 1}, "clock_step", "warning"),
    (PX, {"drift": -0.004}, "clock_drift", "info"),
    (PX, {"responders": ("1/191",)}, "two_responders", "error"),
    (AP, {"responders": ("1/191",)}, "two_responders", "info"),
    (AP, {"others": ("1/191",)}, "others", "info"),
    (AP, {"imu_hz": 0.0}, "imu_missing", "error"), (PX, {"imu_hz": 123.0}, "imu_slow", "warning"),
    (AP, {"ekf_flags": None}, "ekf_unknown", "info"),
    (AP, {"ekf_flags": 129}, "ekf_no_vision", "error"),
    (PX, {"ekf_flags": 1}, "ekf_no_vision", "error"),
    (AP, {"ekf_flags": 129, "vision": None}, "ekf_waits", "info"),
    (AP, {"origin": False}, "no_origin", "warning"),
    (AP, {"origin": False, "config": config(origin=None)}, "no_origin", "error"),
    (PX, {"origin": False}, "no_origin", "info"),
    (AP, {"home": False}, "no_home", "info"),
    (AP, {"texts": ("PreArm: AHRS: waiting for home",)}, "says", "error"),
    (PX, {"texts": ("Preflight Fail: heading estimate not stable",)}, "says", "error"),
    (AP, {"vision": replace(SEEN, rate_hz=5.0)}, "vision_slow", "error"),
    (AP, {"vision": replace(SEEN, rate_hz=60.0)}, "vision_fast", "warning"),
    (AP, {"vision": replace(SEEN, repeats=3)}, "vision_repeats", "warning"),
    (PX, {"vision": replace(SEEN, ages_ms=())}, "vision_clock", "error"),
    (AP, {"vision": replace(SEEN, ages_ms=())}, "vision_clock", "info"),
    (AP, {"vision": replace(SEEN, frames=frozenset({(1, 12)}))}, "odometry_frame", "error"),
    (PX, {"vision": replace(SEEN, frames=frozenset({(20, 12)}))}, "odometry_frame", "error"),
    (AP, {"vision": replace(SEEN, ages_ms=(150.0, 230.0, 240.0))}, "vision_late", "error"),
]  # fmt: skip


@pytest.mark.parametrize(("autopilot", "wrong", "code", "severity"), LINK)
def test_what_is_wrong_with_link_and_state(autopilot, wrong, code, severity):
    assert found(facts(autopilot, **wrong))[code].severity == severity
    assert code not in found(facts(autopilot))


def test_frames_that_each_takes_are_right():
    for autopilot, pair in ((AP, (20, 12)), (PX, (1, 12))):
        seen = replace(SEEN, frames=frozenset({pair}))
        assert "odometry_frame" not in found(facts(autopilot, vision=seen))


def test_a_port_in_mode_normal_is_named_with_its_change():
    normal = {**GOOD[PX], "MAV_0_CONFIG": 0, "MAV_1_MODE": 0}
    one = found(facts(PX, params=normal, timesync_asked=0))["timesync_not_asked"]
    assert (one.change.name, one.change.new) == ("MAV_1_MODE", 2)
    both = {**GOOD[PX], "MAV_1_MODE": 0}  # which of the two is ours?
    assert found(facts(PX, params=both, timesync_asked=0))["timesync_not_asked"].change is None


def test_serial_ports():
    ours = config(url="serial:/dev/ttyAMA0:921600")
    assert bad(facts(AP, config=ours)) == {}
    assert bad(facts(PX, config=ours)) == {}
    old = {**GOOD[AP], "SERIAL2_PROTOCOL": 1}
    assert bad(facts(AP, config=ours, params=old))["SERIAL2_PROTOCOL"].change.new == 2
    slow = {**GOOD[PX], "MAV_1_RATE": 1200}
    assert bad(facts(PX, config=ours, params=slow))["MAV_1_RATE"].change.new == 80000
    thin = config(url="serial:/dev/ttyAMA0:57600")
    for autopilot in (AP, PX):
        assert bad(facts(autopilot, config=thin, imu_hz=None))["baud"].severity == "error"


def test_delay_is_capture_to_the_autopilot_where_it_must_be_told():
    f = facts(AP, rtts_ms=(4.0, 9.0), vision=replace(SEEN, ages_ms=(58.0, 61.0, 75.0)))
    d = delay(f)
    assert (d.name, d.advised, d.one_way_ms) == ("VISO_DELAY_MS", 60.0, 2.0)
    assert "VISO_DELAY_MS 60" in words(d)
    silent = replace(f, vision=None)
    assert delay(silent).advised is None
    assert "no poses are heard" in words(delay(silent))
    assert "2.0 ms one way" in words(delay(silent))
    synced = facts(PX, vision=replace(SEEN, ages_ms=(58.0, 60.0, 75.0)))
    assert delay(synced).advised == 0.0
    unsynced = replace(synced, timesync_asked=0, rtts_ms=(4.0,))
    assert delay(unsynced).advised == pytest.approx(62.0)
    assert "EKF2_EV_DELAY" in found(unsynced)


def test_the_worst_comes_first():
    params = {**GOOD[AP], "FENCE_ENABLE": 0, "VISO_TYPE": 0, "COMPASS_ENABLE": 1}
    order = [one.severity.value for one in doctor.check(facts(AP, params=params))]
    assert order == sorted(order, key=["error", "warning", "info"].index)
    assert set(order) == {"error", "warning", "info"}


def test_a_starved_doctor_is_told_from_old_poses():
    ages, slow = (60.0, 90.0, 251.0), tuple([6.0] * 18 + [196.0] * 2)
    starved = found(facts(AP, rtts_ms=slow, vision=replace(SEEN, ages_ms=ages)))
    assert "vision_late" not in starved
    assert starved["doctor_starved"].severity == "warning"
    old = found(facts(AP, rtts_ms=(6.0, 7.0, 6.5), vision=replace(SEEN, ages_ms=ages)))
    assert "vision_late" in old
    assert "doctor_starved" not in old


def test_an_autopilot_that_signs_is_one_word():
    deaf = found(facts(AP, signed=True, rtts_ms=(), params={}, complete=False))
    assert deaf["signing"].severity == "error"
    assert "mavlink.signing.key_file" in deaf["signing"].do
    assert not {"parameters", "timesync_no_answer"} & set(deaf)
    assert "signing" not in found(facts(AP, signed=True)), "it answers: all is well"


@pytest.mark.parametrize("autopilot", [AP, PX])
def test_what_the_autopilot_believes_otherwise_is_an_error(autopilot):
    said = "autopilot differs: yaw by 90 deg"
    one = found(facts(autopilot, belief=said))["belief"]
    assert one.severity == "error"
    assert "yaw by 90 deg" in one.what
    assert ("EK3_SRC1_YAW" in one.do) is (autopilot == AP)
    assert "belief" not in found(facts(autopilot))


def test_px4s_delay_is_0_once_timesync_is_answered_and_ardupilot_hears_nothing_of_px4():
    nothing = facts(PX, vision=None)
    assert "EKF2_EV_DELAY is 0 once TIMESYNC is answered" in words(delay(nothing))
    two = found(facts(AP, responders=("1/191",)))["two_responders"]
    assert "PX4" not in two.what + two.why + two.do
