"""What ArduPilot's parameters must be for flying on our poses, from its sources and flights."""

from vio.doctor.parameter_sets import shipped
from vio.doctor.records import Facts, Severity
from vio.doctor.rules.base import ParamRule, at_least, at_most, lets_coasting_pass, one_of
from vio.mavlink.messages import ARDUPILOT

E, W, I = Severity.ERROR, Severity.WARNING, Severity.INFO  # noqa: E741
LAG_HZ = 80.0  # low-passes from which on the IMU lags by 3 ms; 11.5 ms at the default of 20 Hz
_HIDDEN = "restart the flight controller: VISO_ and EK3_ parameters show once their switch is on"


def _viso(facts: Facts) -> bool:
    return facts.params.get("VISO_TYPE", 0.0) > 0


def _ek3(facts: Facts) -> bool:
    return facts.params.get("EK3_ENABLE", 0.0) > 0


def _imu(facts: Facts) -> bool:
    return facts.config.imu.message != "none"


def _velocity(value: float, facts: Facts) -> bool:
    return (value == 6.0) <= facts.velocity  # 6 only where velocity is sent


def rules() -> list[ParamRule]:
    """Every rule on a single parameter."""
    return [*_filter(), *_vision(), *_sources(), *_others()]


def _rule(name: str, severity: Severity, why: str, **more: object) -> ParamRule:
    """A rule whose wanted value is the shipped one."""
    return ParamRule((name,), severity, why, shipped(ARDUPILOT)[name], **more)  # type: ignore[arg-type]


def _filter() -> list[ParamRule]:
    return [
        _rule("AHRS_EKF_TYPE", E, "only EKF3 takes external vision"),
        _rule("EK3_ENABLE", E, "only EKF3 takes external vision"),
        _rule("EK2_ENABLE", W, "EKF2 knows no vision resets and takes memory and time from EKF3"),
        ParamRule(
            ("GPS1_TYPE", "GPS_TYPE"), W,
            "indoors there is no GPS: arming waits for it, or a false fix is used",
            shipped(ARDUPILOT)["GPS1_TYPE"],
        ),
        _rule(
            "COMPASS_ENABLE", W,
            "indoors the compass is bent by steel and currents, and arming checks wait for it",
        ),
        _rule("FS_EKF_ACTION", W, "nothing happens when the EKF fails in the air",
              right=at_least(1)),
        _rule("FS_EKF_THRESH", W, "the EKF failsafe is off or comes late",
              right=lambda v, f: 0.0 < v <= shipped(ARDUPILOT)["FS_EKF_THRESH"] + 1e-6),
    ]  # fmt: skip


def _vision() -> list[ParamRule]:
    floor = ("this floor hides our covariance: EKF3 never believes a pose more than that,"
             " however good it is")  # fmt: skip
    twice = "our poses are those of the body already (vehicle.T_BI): the offset counts twice"
    return [
        _rule("VISO_TYPE", E, "vision messages are dropped", right=at_least(1), missing=E,
              missing_do="take a firmware with VISO: boards with 1 MB of flash lack it"),
        _rule("VISO_TYPE", W, "types 2 and 3 treat resets as a T265 or a VOXL needs it",
              right=one_of(0, 1)),
        _rule("VISO_POS_M_NSE", W, floor, when=_viso,
              right=at_most(shipped(ARDUPILOT)["VISO_POS_M_NSE"]), missing=E, missing_do=_HIDDEN),
        _rule("VISO_YAW_M_NSE", W, floor, when=_viso,
              right=at_most(shipped(ARDUPILOT)["VISO_YAW_M_NSE"])),
        _rule("VISO_QUAL_MIN", E, "VISION_POSITION_ESTIMATE has no quality, so all of it is"
              " dropped; ODOMETRY says 30 while it coasts", when=_viso, right=lets_coasting_pass),
        *(_rule(f"VISO_POS_{axis}", W, twice, when=_viso) for axis in "XYZ"),
        ParamRule(("VISO_SCALE",), E, "positions are multiplied by it", 1.0, when=_viso),
    ]  # fmt: skip


def _sources() -> list[ParamRule]:
    none = "velocity is expected from vision, and none is sent (mavlink.speed, or ODOMETRY)"
    return [
        _rule("EK3_SRC1_POSXY", E, "the position of our poses is not used", when=_ek3, missing=E,
              missing_do=_HIDDEN),
        _rule("EK3_SRC1_POSZ", W, "height comes from elsewhere: 1, the barometer, drifts indoors;"
              " a range finder sees tables and boxes", when=_ek3),
        _rule("EK3_SRC1_YAW", E, "the yaw of our poses is not used: without it positions must lie"
              " in true north by compass, and at a wrong heading the vehicle flies away",
              when=_ek3),
        _rule("EK3_SRC1_VELXY", W, none, when=_ek3, right=_velocity),
        _rule("EK3_SRC1_VELZ", W, none, when=_ek3, right=_velocity),
    ]  # fmt: skip


def _others() -> list[ParamRule]:
    lag = (
        "the IMU that we get lags by this low-pass (11.5 ms at 20 Hz, 3 ms at 80 Hz) and is"
        " damped above 10 Hz; it also shapes the attitude controller: mind its tuning"
    )
    return [
        ParamRule(("INS_GYRO_FILTER",), W, lag, LAG_HZ, right=at_least(LAG_HZ), when=_imu,
                  by_hand=True),
        ParamRule(("INS_ACCEL_FILTER",), W, lag, LAG_HZ, right=at_least(LAG_HZ), when=_imu,
                  by_hand=True),
        ParamRule(("ARMING_CHECK",), W, "arming checks are off: nothing says that vision is missing"
                  " before take-off", 1.0, right=lambda v, f: v != 0),
        ParamRule(("FENCE_ENABLE",), I, "no fence: set one by the size of the map", 1.0,
                  right=lambda v, f: v != 0, by_hand=True),
    ]  # fmt: skip


PORTS = range(10)
BAUDS = {1: 1200, 2: 2400, 4: 4800, 9: 9600, 19: 19200, 38: 38400, 57: 57600, 111: 111100,
         115: 115200, 230: 230400, 256: 256000, 460: 460800, 500: 500000, 921: 921600,
         1500: 1500000}  # fmt: skip
NEEDED = ("AHRS_EKF_TYPE", "EK3_ENABLE", "VISO_TYPE")  # these exist wherever vision can be flown
OPTIONAL = (
    "VISO_DELAY_MS",
    *(f"SERIAL{n}_{what}" for n in PORTS for what in ("PROTOCOL", "BAUD")),
)


def baud(code: float) -> int:
    """Bits a second of a SERIALn_BAUD: a code, or the number itself."""
    return BAUDS.get(round(code), round(code))
