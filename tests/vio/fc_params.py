"""Parameters of the in-test autopilots, set up well, with neighbours that nobody asks about."""

FLOAT, INT8, INT16, INT32 = 9, 2, 4, 6

_ARDUPILOT = {
    "AHRS_EKF_TYPE": 3, "EK3_ENABLE": 1, "EK2_ENABLE": 0, "GPS1_TYPE": 0, "COMPASS_ENABLE": 0,
    "VISO_TYPE": 1, "VISO_DELAY_MS": 60, "VISO_QUAL_MIN": 0, "EK3_SRC1_POSXY": 6,
    "EK3_SRC1_POSZ": 6, "EK3_SRC1_VELXY": 0, "EK3_SRC1_VELZ": 0, "EK3_SRC1_YAW": 6,
    "SERIAL1_PROTOCOL": 2, "SERIAL1_BAUD": 57, "SERIAL2_PROTOCOL": 2, "SERIAL2_BAUD": 921,
    "FS_EKF_ACTION": 1, "INS_GYRO_FILTER": 80, "INS_ACCEL_FILTER": 80, "ARMING_CHECK": 1,
    "FENCE_ENABLE": 1,
}  # fmt: skip
_ARDUPILOT_FLOAT = {
    "VISO_POS_M_NSE": 0.1, "VISO_YAW_M_NSE": 0.1, "VISO_POS_X": 0.0, "VISO_POS_Y": 0.0,
    "VISO_POS_Z": 0.0, "VISO_SCALE": 1.0, "FS_EKF_THRESH": 0.8,
}  # fmt: skip
ARDUPILOT = {
    **{name: (value, INT16) for name, value in _ARDUPILOT.items()},
    **{name: (value, FLOAT) for name, value in _ARDUPILOT_FLOAT.items()},
    **{f"RC{n}_TRIM": (1500 + n, INT16) for n in range(1, 17)},
}

_PX4 = {
    "EKF2_EN": 1, "EKF2_EV_CTRL": 11, "EKF2_HGT_REF": 3, "EKF2_GPS_CTRL": 0, "EKF2_BARO_CTRL": 1,
    "EKF2_RNG_CTRL": 0, "EKF2_MAG_TYPE": 5, "SYS_HAS_MAG": 0, "SYS_HAS_GPS": 0,
    "COM_ARM_WO_GPS": 1, "EKF2_EV_NOISE_MD": 0, "EKF2_EV_QMIN": 0, "MAV_0_CONFIG": 101,
    "MAV_0_MODE": 0, "MAV_0_RATE": 1200, "MAV_1_CONFIG": 102, "MAV_1_MODE": 2,
    "MAV_1_RATE": 80000, "SER_TEL1_BAUD": 57600, "SER_TEL2_BAUD": 921600, "MAV_PROTO_VER": 0,
}  # fmt: skip
_PX4_FLOAT = {
    "EKF2_EV_DELAY": 0.0, "EKF2_EVP_NOISE": 0.05, "EKF2_EVA_NOISE": 0.05, "EKF2_EVP_GATE": 5.0,
    "EKF2_EV_POS_X": 0.0, "EKF2_EV_POS_Y": 0.0, "EKF2_EV_POS_Z": 0.0,
}  # fmt: skip
PX4 = {
    **{name: (value, INT32) for name, value in _PX4.items()},
    **{name: (value, FLOAT) for name, value in _PX4_FLOAT.items()},
    **{f"RC{n}_TRIM": (1500.0 + n, FLOAT) for n in range(1, 17)},
    "RC_OF_A_NEGATIVE": (-7, INT32),
}
