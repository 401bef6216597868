"""The autopilot's IMU over MAVLink as samples of I in our clock; its traps are named."""

import logging
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from tagvo.geometry import Array
from vio.frames import FLIP
from vio.mavlink.clock import Stamped, stamp, to_theirs
from vio.mavlink.messages import ARDUPILOT, PX4
from vio.mavlink.protocol import Companion
from vio.records import ImuSample

LOG = logging.getLogger("vio.sources.live_imu")
_MILLI_G = 9.80665e-3  # [m/s^2]
_MILLI_RAD = 1e-3
_AGE_NS, _AHEAD_NS = 1_000_000_000, 100_000_000  # of a stamp against its arrival
_BOOT_WRAP_NS = (1 << 32) * 1_000_000  # time_boot_ms has 32 bits
_QUIET_NS = 5_000_000_000
_TRAPS = {
    (ARDUPILOT, "HIGHRES_IMU"): "ArduPilot stamps HIGHRES_IMU when it sends, not when it samples,"
    " after a low-pass (INS_GYRO_FILTER, INS_ACCEL_FILTER: about 11.5 ms at 20 Hz, 3 ms at 80 Hz):"
    " set both to 80 Hz or more; the filter's time offset takes up the rest",
    (ARDUPILOT, "RAW_IMU"): "ArduPilot's RAW_IMU is raw by name only: low-passed, in whole mG and"
    " mrad/s, stamped when sent; HIGHRES_IMU has the same without the rounding",
    (PX4, "HIGHRES_IMU"): "PX4 subtracts its own EKF2's bias estimates from HIGHRES_IMU: they move"
    " with our vision, and our biases follow them",
    (PX4, "SCALED_IMU"): "PX4's SCALED_IMU is cut to whole mG and mrad/s and stamped in"
    " milliseconds; it has no bias removed",
    (PX4, "RAW_IMU"): "PX4 does not send RAW_IMU: use HIGHRES_IMU",
    (PX4, "SCALED_IMU2"): "PX4 accepts SCALED_IMU2 and does not send it: use HIGHRES_IMU",
}
_COARSE = "{} is in whole mG and mrad/s and stamped in milliseconds: HIGHRES_IMU is finer"


def trap(autopilot: int | None, message: str) -> str | None:
    """What is wrong with this message of this autopilot, in words; None: nothing known."""
    known = _TRAPS.get((autopilot or 0, message))
    if known is None and message.startswith("SCALED_IMU"):
        return _COARSE.format(message)
    return known


def body_frd(message: Any) -> tuple[Array, Array, int]:
    """Gyro (3,) [rad/s], specific force (3,) [m/s^2] in body FRD, stamp [ns] in the FC's clock."""
    gyro = np.array([message.xgyro, message.ygyro, message.zgyro], dtype=float)
    accel = np.array([message.xacc, message.yacc, message.zacc], dtype=float)
    name = message.get_type()
    if name == "HIGHRES_IMU":
        return gyro, accel, message.time_usec * 1000
    ns = message.time_usec * 1000 if name == "RAW_IMU" else message.time_boot_ms * 1_000_000
    return gyro * _MILLI_RAD, accel * _MILLI_G, ns


def unwrapped(stamp_ns: int, near_ns: int) -> int:
    """A stamp of time_boot_ms, which wraps after 49.7 days, near a time of the same clock [ns]."""
    return stamp_ns + round((near_ns - stamp_ns) / _BOOT_WRAP_NS) * _BOOT_WRAP_NS


class MavlinkImu:
    """Listens to a link and hands on samples; `counters` says what became of the others.

    A sample waits for the clocks to be compared (some tenths of a second); one whose stamp lies far
    from its arrival is dropped: the clock has stepped, and its track will follow soon.
    """

    def __init__(
        self, companion: Companion, R_BI: Array, hand_on: Callable[[ImuSample], None]
    ) -> None:
        """R_BI (3, 3): I in the body (forward, left, up); hand_on is called for each sample."""
        self._companion, self._R_FI = companion, FLIP[:, None] * R_BI
        self._hand_on = hand_on
        self._name = companion.config.imu.message
        self._before: Stamped | None = None
        self._named = False
        self._said_ns: int | None = None
        self.counters: Counter[str] = Counter()

    def heard(self, message: Any, arrival_ns: int) -> None:
        """Take any message of the link."""
        if message.get_type() != self._name or not self._companion.vehicle.is_mine(message):
            return
        self._name_trap()
        track = self._companion.clock
        if track is None:
            self.counters["imu_clock_unknown"] += 1
            return
        gyro_F, accel_F, their_ns = body_frd(message)
        if self._name.startswith("SCALED_IMU"):
            their_ns = unwrapped(their_ns, to_theirs(track, arrival_ns))
        stamped = stamp(self._before, track, their_ns)
        if not -_AHEAD_NS <= arrival_ns - stamped.our_ns <= _AGE_NS:
            self._off_clock(arrival_ns - stamped.our_ns, arrival_ns)
            return
        if self._before is not None and stamped.our_ns <= self._before.our_ns:
            self.counters["imu_repeated"] += 1
            return
        self._before = stamped
        mean = self._name == "HIGHRES_IMU" and self._companion.vehicle.autopilot == PX4
        sample = ImuSample(
            stamped.our_ns, gyro_F @ self._R_FI, accel_F @ self._R_FI, arrival_ns, mean
        )
        self.counters["imu"] += 1
        self._hand_on(sample)

    def _name_trap(self) -> None:
        vehicle = self._companion.vehicle
        if self._named or vehicle.autopilot is None:
            return
        self._named = True
        text = trap(vehicle.autopilot, self._name)
        if text is not None:
            LOG.warning("%s", text)

    def _off_clock(self, age_ns: int, now_ns: int) -> None:
        self.counters["imu_off_clock"] += 1
        if self._said_ns is None or now_ns - self._said_ns > _QUIET_NS:
            self._said_ns = now_ns
            LOG.warning(
                "%s arrives %.3f s after its stamp: dropped until the clocks agree again;"
                " if this stays, its stamps are in no clock that TIMESYNC knows",
                self._name,
                age_ns * 1e-9,
            )
