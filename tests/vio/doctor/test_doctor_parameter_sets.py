"""The parameter sets that are shipped: readable by others' readers, complete, and without traps."""

from pathlib import Path

import pytest
from pymavlink import mavparm

SETS = Path(__file__).parents[3] / "configs" / "autopilot"
ARDUPILOT = {
    "AHRS_EKF_TYPE": 3, "EK3_ENABLE": 1, "EK2_ENABLE": 0, "GPS1_TYPE": 0, "COMPASS_ENABLE": 0,
    "VISO_TYPE": 1, "VISO_POS_M_NSE": 0.1, "VISO_YAW_M_NSE": 0.1, "VISO_QUAL_MIN": 0,
    "VISO_POS_X": 0, "VISO_POS_Y": 0, "VISO_POS_Z": 0, "EK3_SRC1_POSXY": 6, "EK3_SRC1_POSZ": 6,
    "EK3_SRC1_VELXY": 0, "EK3_SRC1_VELZ": 0, "EK3_SRC1_YAW": 6, "SERIAL2_PROTOCOL": 2,
    "SERIAL2_BAUD": 921, "SERIAL2_OPTIONS": 0, "FS_EKF_ACTION": 1, "FS_EKF_THRESH": 0.8,
}  # fmt: skip
PX4 = {
    "EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0, "EKF2_BARO_CTRL": 1,
    "EKF2_MAG_TYPE": 5, "SYS_HAS_MAG": 0, "SYS_HAS_GPS": 0, "EKF2_RNG_CTRL": 0,
    "COM_ARM_WO_GPS": 1, "EKF2_EV_DELAY": 0, "EKF2_EV_NOISE_MD": 0, "EKF2_EVP_NOISE": 0.05,
    "EKF2_EVA_NOISE": 0.05, "EKF2_EVP_GATE": 5, "EKF2_EV_QMIN": 0, "EKF2_EV_POS_X": 0,
    "EKF2_EV_POS_Y": 0, "EKF2_EV_POS_Z": 0, "MAV_1_CONFIG": 102, "MAV_1_MODE": 2,
    "MAV_1_RATE": 80000, "SER_TEL2_BAUD": 921600,
}  # fmt: skip
OF_A_TEST_BENCH = {  # never to be shipped: they switch protections off
    "COM_RC_IN_MODE", "NAV_RCL_ACT", "NAV_DLL_ACT", "CBRK_SUPPLY_CHK", "COM_DISARM_PRFLT",
    "ARMING_CHECK", "EK3_POS_I_GATE", "EK3_GLITCH_RAD",
}  # fmt: skip


def test_ardupilots_set_by_pymavlinks_reader():
    read = mavparm.MAVParmDict()
    assert read.load(str(SETS / "ardupilot.parm"))
    delay = read.pop("VISO_DELAY_MS")
    assert 0 < delay <= 250
    assert dict(read) == pytest.approx(ARDUPILOT)


def test_px4s_set_as_qgroundcontrol_writes_it():
    rows = [line.split("\t") for line in (SETS / "px4.params").read_text().splitlines()
            if not line.startswith("#")]  # fmt: skip
    assert all(len(row) == 5 and row[:2] == ["1", "1"] for row in rows)
    assert {name: float(value) for _, _, name, value, _ in rows} == pytest.approx(PX4)
    for _, _, _, value, kind in rows:
        assert kind == ("9" if "." in value else "6"), "a float is type 9, a whole number 6"


def test_no_protection_is_switched_off():
    for path in SETS.iterdir():
        lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
        assert not [line for line in lines if OF_A_TEST_BENCH & set(line.split())]
