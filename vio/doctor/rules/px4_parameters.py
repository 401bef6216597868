"""What PX4's parameters must be for flying on our poses, from its sources and flights."""

from vio.doctor.parameter_sets import shipped
from vio.doctor.records import Facts, Severity
from vio.doctor.rules.base import ParamRule, at_most, bits, lets_coasting_pass, one_of
from vio.mavlink.messages import PX4

E, W, I = Severity.ERROR, Severity.WARNING, Severity.INFO  # noqa: E741
_OLD_MASK = 24  # EKF2_AID_MASK before 1.14: position and yaw by vision


def _modern(facts: Facts) -> bool:
    return "EKF2_AID_MASK" not in facts.params


def _old(facts: Facts) -> bool:
    return "EKF2_AID_MASK" in facts.params


def _range_seen(facts: Facts) -> bool:
    return facts.range_finder


def _no_range(facts: Facts) -> bool:
    return not facts.range_finder


def rules() -> list[ParamRule]:
    """Every rule on a single parameter."""
    return [*_fusion(), *_aiding(), *_noise(), *_link()]


def _rule(name: str, severity: Severity, why: str, **more: object) -> ParamRule:
    """A rule whose wanted value is the shipped one."""
    return ParamRule((name,), severity, why, shipped(PX4)[name], **more)  # type: ignore[arg-type]


def _fusion() -> list[ParamRule]:
    mask = int(shipped(PX4)["EKF2_EV_CTRL"])
    return [
        ParamRule(("EKF2_EN",), E, "EKF2 does not run, and nothing else takes vision", 1.0),
        _rule("EKF2_EV_CTRL", E, "horizontal position (1), height (2) and yaw (8) of our poses must"
              " all be fused", right=bits(mask), when=_modern, missing=E,
              missing_do="take PX4 1.12 or newer with EKF2"),
        ParamRule(("EKF2_AID_MASK",), E, "before 1.14 this must hold 8 (vision position) and 16"
                  " (vision yaw)", _OLD_MASK, right=bits(_OLD_MASK), when=_old),
        ParamRule(("EKF2_HGT_MODE",), W, "height comes from elsewhere than vision", 3.0, when=_old),
        _rule("EKF2_HGT_REF", W, "height is referred to another sensor than vision: it snaps when"
              " one of the two is lost", when=_modern),
        _rule("EKF2_EV_QMIN", E, "VISION_POSITION_ESTIMATE has no quality, so it is never fused and"
              " arming is denied; ODOMETRY says 30 while it coasts", right=lets_coasting_pass),
    ]  # fmt: skip


def _aiding() -> list[ParamRule]:
    pulled = "the range finder pulls the height off vision: by 0.3 to 0.7 m in recorded flights"
    no_mag = "indoors the compass is bent by steel and currents and spoils the yaw of our poses"
    return [
        _rule("EKF2_RNG_CTRL", E, pulled, when=_range_seen),
        _rule("EKF2_RNG_CTRL", W, f"{pulled}; none is heard here now", when=_no_range),
        _rule("EKF2_GPS_CTRL", W, "indoors a false fix pulls the position away", when=_modern),
        _rule("EKF2_BARO_CTRL", W, "0 or 1: more than that is unknown here", right=one_of(0, 1)),
        _rule("EKF2_MAG_TYPE", W, no_mag),
        _rule("SYS_HAS_MAG", W, "arming waits for a compass that is not used"),
        _rule("SYS_HAS_GPS", W, "arming waits for a GPS that is not used"),
        _rule("COM_ARM_WO_GPS", E, "arming is denied without GPS", right=one_of(1, 2)),
    ]  # fmt: skip


def _noise() -> list[ParamRule]:
    floor = ("this floor hides our covariance: EKF2 never believes a pose more than that, however"
             " good it is")  # fmt: skip
    twice = "our poses are those of the body already (vehicle.T_BI): the offset counts twice"
    return [
        _rule("EKF2_EV_NOISE_MD", W, "1 ignores our covariance, so a coasting pose is believed like"
              " a good one"),
        _rule("EKF2_EVP_NOISE", W, floor, right=at_most(shipped(PX4)["EKF2_EVP_NOISE"])),
        _rule("EKF2_EVA_NOISE", W, floor, right=at_most(shipped(PX4)["EKF2_EVA_NOISE"])),
        _rule("EKF2_EVP_GATE", W, "a gate below 3 rejects good poses, one above 10 lets jumps in",
              right=lambda v, f: 3.0 <= v <= 10.0),
        *(_rule(f"EKF2_EV_POS_{axis}", W, twice) for axis in "XYZ"),
    ]  # fmt: skip


def _link() -> list[ParamRule]:
    return [
        ParamRule(("MAV_PROTO_VER",), E, "1 forces MAVLink 1: covariance and reset counter of our"
                  " poses read 0", 2.0, right=one_of(0, 2)),
    ]  # fmt: skip


INSTANCES = range(3)
DEVICES = {101: "SER_TEL1_BAUD", 102: "SER_TEL2_BAUD", 103: "SER_TEL3_BAUD", 104: "SER_TEL4_BAUD"}
NEEDED = ("EKF2_EV_QMIN", "EKF2_EV_DELAY")
OPTIONAL = (
    *DEVICES.values(),
    *(f"MAV_{n}_{what}" for n in INSTANCES for what in ("CONFIG", "MODE", "RATE")),
)
