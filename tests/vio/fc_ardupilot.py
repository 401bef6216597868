"""An in-test ArduCopter: jitter correction, gates, resets, origin, arming as EKF3 was seen."""

import numpy as np
from fc_autopilot import Autopilot
from fc_params import ARDUPILOT
from pymavlink.dialects.v20 import ardupilotmega as m

MAX_LAG_NS, LOOPS = 500_000_000, 100


class JitterCorrection:
    """The smallest arrival minus stamp is the offset; a window's smallest replaces it (drift)."""

    def __init__(self):
        self.offset = self.window = None
        self.count = 0

    def correct(self, stamp_ns, arrival_ns):
        difference = arrival_ns - stamp_ns
        if self.offset is None or difference < self.offset:
            self.offset = difference
        estimate = stamp_ns + self.offset
        if arrival_ns - estimate > MAX_LAG_NS:
            estimate = arrival_ns - MAX_LAG_NS
        self.window = difference if self.window is None else min(self.window, difference)
        self.count += 1
        if self.count == LOOPS:
            self.offset, self.window, self.count = self.window, None, 0
        return estimate


class ArduPilot(Autopilot):
    kind = 3
    PARAMS = ARDUPILOT
    LOOP_US = 2500  # 400 Hz
    VISO_DELAY_MS, VISO_POS_M_NSE, VISO_YAW_M_NSE, VISO_QUAL_MIN = 60, 0.1, 0.1, 0
    GATE = 5.0

    def boot(self, t_ns):
        super().boot(t_ns)
        self.jitter = JitterCorrection()
        self.reset_counter = 0
        self.taken_ns = self.healthy_ns = self.fused_ns = None
        self.answers = []  # TIMESYNC waits for its task
        self.asked_ns = t_ns

    # clocks

    def on_timesync(self, message, t_ns):
        if message.tc1 == 0:
            self.answers.append((t_ns + int(self.rng.uniform(0.0, 6e6)), message.ts1))

    def loop(self, t_ns):
        while self.answers and self.answers[0][0] <= t_ns:
            _, ts1 = self.answers.pop(0)
            self.send(m.MAVLink_timesync_message(self.clock(t_ns), ts1))
        if t_ns - self.asked_ns >= 10**10:
            self.asked_ns = t_ns
            self.send(m.MAVLink_timesync_message(0, self.clock(t_ns) + self.system))
        if self.due(30, t_ns):
            self.attitude(t_ns)
        self.tell_position(t_ns)
        if not any(self.due(number, t_ns) for number in (27, 105, 116)):
            return
        gyro, accel = self.imu()
        us = self.clock(t_ns) // 1000
        milli = [round(x) for x in [*(accel / 9.80665e-3), *(gyro * 1e3)]]
        if 105 in self.streams:
            self.send(m.MAVLink_highres_imu_message(us, *accel, *gyro, *[0] * 7, 63))
        elif 27 in self.streams:
            self.send(m.MAVLink_raw_imu_message(us, *milli, 0, 0, 0))
        else:
            self.send(m.MAVLink_scaled_imu2_message(us // 1000, *milli, 0, 0, 0))

    def interval(self, message_id, interval_us):
        if message_id not in (27, 30, 32, 105, 116):
            return 3
        if int(interval_us / 1000) * 800 < self.LOOP_US:
            return 2
        self.streams[message_id] = round(interval_us * 1000)
        return 0

    def requested(self, message_id, t_ns):
        if message_id == 193:
            self.send(m.MAVLink_ekf_status_report_message(self.flags(t_ns), 0, 0, 0, 0, 0))
            return 0
        return super().requested(message_id, t_ns)

    def flags(self, t_ns):
        """ATT, and with vision VELH VELV POSREL POSABS POSVABS PRED*; else CONST_POS."""
        fresh = self.aiding and t_ns - self.fused_ns < 7 * 10**9
        return 1 + 2 + 4 + 8 + 16 + 32 + 256 + 512 if fresh else 1 + 128

    # vision

    def on_vision_position_estimate(self, message, t_ns):
        v1 = message.get_msgbuf()[0] == 254
        cov = [0.0] * 21 if v1 else message.covariance
        counter = 0 if v1 else message.reset_counter
        self.vision(
            t_ns, message.usec, [message.x, message.y, message.z], message.yaw, cov, counter
        )

    def on_odometry(self, message, t_ns):
        if message.frame_id != 20 or message.child_frame_id != 12:
            return  # silently
        w, x, y, z = message.q
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        p = [message.x, message.y, message.z]
        self.healthy_ns = t_ns  # even where the quality drops it
        if message.quality >= self.VISO_QUAL_MIN:
            self.vision(t_ns, message.time_usec, p, yaw, message.pose_covariance,
                        message.reset_counter)  # fmt: skip

    def vision(self, t_ns, usec, p, yaw, cov, counter):
        arrival = self.clock(t_ns)
        stamp = self.jitter.correct(usec * 1000, arrival)
        if self.taken_ns is not None and t_ns - self.taken_ns < 20_000_000:
            self.rejected.append((t_ns, "rate"))
            return
        self.taken_ns = self.healthy_ns = t_ns
        when = stamp - self.VISO_DELAY_MS * 1_000_000
        sigma, _ = self.errors(cov)
        innovation = self.ekf.innovation(when, np.array(p))
        if not np.isnan(yaw):
            self.ekf.correct_yaw(yaw)
        if not self.aiding or counter != self.reset_counter:
            self.ekf.reset(innovation, sigma)
            self.resets.append((t_ns, counter))
            self.aiding, self.reset_counter = True, counter
        elif self.ekf.gate(innovation, sigma, self.GATE):
            self.ekf.correct(innovation, sigma)
        elif t_ns - self.fused_ns > 7 * 10**9:
            self.ekf.reset(innovation, sigma)
            self.resets.append((t_ns, "timeout"))
        else:
            self.rejected.append((t_ns, "gate"))
            return
        self.fused_ns = t_ns
        self.fused.append((t_ns, when, sigma))

    def errors(self, cov):
        """posErr and angErr as EKF3 takes them: cube roots of sums of squared variances."""
        if np.isnan(cov[0]):
            position, angle = 0.0, 0.0
        else:
            position = np.cbrt(cov[0] ** 2 + cov[6] ** 2 + cov[11] ** 2)
            angle = np.cbrt(cov[15] ** 2 + cov[18] ** 2 + cov[20] ** 2)
        return (
            float(np.clip(position, self.VISO_POS_M_NSE, 100.0)),
            float(np.clip(angle, self.VISO_YAW_M_NSE, 1.5)),
        )

    def healthy(self, t_ns):
        return self.healthy_ns is not None and t_ns - self.healthy_ns < 300_000_000

    # origin, home, arming

    def on_set_gps_global_origin(self, message, t_ns):
        if message.target_system != self.system or self.origin is not None:
            return  # a second one is refused
        if message.latitude == 0 and message.longitude == 0:
            return  # silently
        self.origin = (message.latitude, message.longitude, message.altitude)
        self.origin_ns = t_ns
        self.echo_origin()

    def arm(self, t_ns):
        """Whether it arms; else the word that a pilot reads."""
        if self.origin is None:
            return "Arm: AHRS: waiting for home"
        if not self.healthy(t_ns):
            return "Arm: VisOdom: not healthy"
        if not self.aiding or t_ns - self.fused_ns > 7 * 10**9:
            return "Arm: Need Position Estimate"
        self.armed = True
        return True
