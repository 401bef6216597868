"""An in-test PX4: TIMESYNC with its convergence, intervals, gates, frames, arming as EKF2 does."""

import struct

import numpy as np
from fc_autopilot import Autopilot
from fc_params import PX4
from pymavlink.dialects.v20 import ardupilotmega as m

GOOD, MAX_RTT_NS, MAX_DEVIATION_NS, BAD_IN_A_ROW = 500, 10_000_000, 100_000_000, 10


class Timesync:
    """The offset of the companion's clock, believed after 500 good round trips."""

    def __init__(self):
        self.offset, self.good, self.bad = None, 0, 0
        self.rtts = []

    @property
    def converged(self):
        return self.good >= GOOD

    def answered(self, ts1, tc1, now):
        rtt = now - ts1
        self.rtts.append(rtt)
        offset = (ts1 + now) // 2 - tc1  # companion's plus this is ours
        deviates = self.offset is not None and abs(offset - self.offset) > MAX_DEVIATION_NS
        if rtt > MAX_RTT_NS or deviates:
            self.bad += 1
            if self.bad >= BAD_IN_A_ROW:
                self.__init__()
            return
        self.bad = 0
        self.good += 1
        gain = 0.003 if self.converged else 0.05
        self.offset = offset if self.offset is None else self.offset + gain * (offset - self.offset)

    def sync(self, stamp_ns, now):
        return stamp_ns + round(self.offset) if self.converged else now


class Px4(Autopilot):
    kind = 12
    PARAMS = PX4
    ASKS = True  # for TIMESYNC: not where the port is in mode normal
    IMU_NS = 4_000_000  # 250 Hz
    EV_DELAY_MS, EVP_NOISE, EVA_NOISE, EV_QMIN, EV_YAW = 0, 0.05, 0.05, 0, True
    GATE, RESETS_IN_AIR = 5.0, 5
    DELAY_MAX_NS, LATE_NS = 200_000_000, 100_000_000

    def boot(self, t_ns):
        super().boot(t_ns)
        self.timesync = Timesync()
        self.asked_ns = t_ns
        self.imu_ns = t_ns
        self.ev_ns = self.fused_ns = self.failing_ns = None
        self.frame = 1
        self.air_resets = 0

    # clocks and streams

    def on_timesync(self, message, t_ns):
        if message.tc1 == 0:
            self.send(m.MAVLink_timesync_message(self.clock(t_ns), message.ts1))
        else:
            self.timesync.answered(message.ts1, message.tc1, self.clock(t_ns))

    def loop(self, t_ns):
        if self.ASKS and t_ns - self.asked_ns >= 10**8:
            self.asked_ns = t_ns
            self.send(m.MAVLink_timesync_message(0, self.clock(t_ns)))
        if t_ns - self.imu_ns < self.IMU_NS:
            return
        self.imu_ns = t_ns
        if self.due(105, t_ns):
            gyro, accel = self.imu()
            us = self.clock(t_ns) // 1000
            self.send(m.MAVLink_highres_imu_message(us, *accel, *gyro, *[0] * 7, 63))
        if self.due(30, t_ns):
            self.attitude(t_ns)
        self.tell_position(t_ns)

    def local(self):
        """1.17-alpha: vision's height is an altitude; local z = -(altitude - origin's altitude)."""
        origin_m = 0.0 if self.origin is None else self.origin[2] * 1e-3
        return self.ekf.p + np.array([0.0, 0.0, origin_m])

    def interval(self, message_id, interval_us):
        if message_id == 27:
            return 4
        if message_id in (30, 32, 105):
            self.streams[message_id] = round(interval_us * 1000)
        return 0  # SCALED_IMU2 too, and nothing comes

    def requested(self, message_id, t_ns):
        if message_id == 230:
            self.send(m.MAVLink_estimator_status_message(0, self.flags(t_ns), *[0] * 8))
            return 0
        return super().requested(message_id, t_ns)

    def flags(self, t_ns):
        """VELH and POSREL with vision, POSABS with an origin too."""
        if not self.loop_aiding(t_ns):
            return 1
        return 1 + 2 + 4 + 8 + 32 + (0 if self.origin is None else 16)

    def to_wire(self, value, kind):
        """PX4 puts a whole number's bits into the place of the float."""
        return struct.unpack("<f", struct.pack("<i", value))[0] if kind == 6 else float(value)

    def from_wire(self, value, kind):
        return struct.unpack("<i", struct.pack("<f", value))[0] if kind == 6 else value

    # vision

    def on_vision_position_estimate(self, message, t_ns):
        p = [message.x, message.y, message.z]
        self.vision(t_ns, message.usec, p, message.yaw, message.covariance,
                    message.reset_counter, 0, 1)  # fmt: skip

    def on_odometry(self, message, t_ns):
        if message.frame_id not in (1, 4, 20, 21) or message.child_frame_id not in (
            1, 4, 20, 21, 8, 9, 12,
        ):  # fmt: skip
            return
        if abs(np.linalg.norm(np.float32(message.q)) - 1.0) > 1e-5:
            self.rejected.append((t_ns, "q"))
            return
        if message.estimator_type not in (0, 1, 2, 3):
            self.rejected.append((t_ns, "estimator_type"))
            return
        w, x, y, z = message.q
        yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        p = [message.x, message.y, message.z]
        self.vision(t_ns, message.time_usec, p, yaw, message.pose_covariance,
                    message.reset_counter, message.quality, message.frame_id)  # fmt: skip

    def vision(self, t_ns, usec, p, yaw, cov, counter, quality, frame):
        now = self.clock(t_ns)
        stamp = self.timesync.sync(usec * 1000, now) - self.EV_DELAY_MS * 1_000_000
        if stamp > now + self.LATE_NS or now - stamp > self.DELAY_MAX_NS + self.LATE_NS:
            self.rejected.append((t_ns, "time"))
            return
        if quality < self.EV_QMIN:
            self.rejected.append((t_ns, "quality"))
            return
        before, self.ev_ns = self.ev_ns, t_ns
        if before is None:
            return
        if t_ns - before < 10_500_000:
            self.rejected.append((t_ns, "too fast"))
            return
        if not self.aiding and t_ns - before >= 200_000_000:
            self.rejected.append((t_ns, "interval"))
            return
        self.frame = frame
        self.take(t_ns, stamp, np.array(p), yaw, self.sigma(cov), counter)

    def sigma(self, cov):
        variances = np.array([cov[0], cov[6], cov[11]])
        if not np.isfinite(variances).all():
            return self.EVP_NOISE
        return float(np.sqrt(max(variances.max(), self.EVP_NOISE**2)))

    def take(self, t_ns, stamp, p, yaw, sigma, counter):
        innovation = self.ekf.innovation(stamp, p)
        if not np.isnan(yaw):
            self.ekf.correct_yaw(yaw)
        if not self.aiding or counter != self.reset_counter:
            self.ekf.reset(innovation, sigma)
            self.resets.append((t_ns, counter))
            self.aiding, self.reset_counter, self.failing_ns = True, counter, None
        elif self.ekf.gate(innovation, sigma, self.GATE):
            self.ekf.correct(innovation, sigma)
            self.failing_ns = None
        else:
            self.rejected.append((t_ns, "gate"))
            self.failing_ns = self.failing_ns or t_ns
            if t_ns - self.failing_ns < 10**9 or self.air_resets >= self.RESETS_IN_AIR:
                return
            self.ekf.reset(innovation, sigma)
            self.air_resets += self.armed
            self.resets.append((t_ns, "fusion failing"))
            self.failing_ns = None
        self.fused_ns = t_ns
        self.fused.append((t_ns, stamp, sigma))

    def loop_aiding(self, t_ns):
        """Whether vision is being fused: it stops 400 ms after the last."""
        if self.aiding and (self.ev_ns is None or t_ns - self.ev_ns > 400_000_000):
            self.aiding = False
        return self.aiding and t_ns - self.fused_ns < 10**9

    # origin, arming

    def on_set_gps_global_origin(self, message, t_ns):
        if message.target_system == self.system:
            self.origin = (message.latitude, message.longitude, message.altitude)
            self.origin_ns = t_ns
            self.echo_origin()

    def arm(self, t_ns):
        """Whether it arms; else the word that a pilot reads."""
        if not self.loop_aiding(t_ns):
            return "Preflight Fail: no valid local position estimate"
        if self.frame in (20, 21) and self.EV_YAW:  # yaw_align is cleared
            return "Preflight Fail: heading estimate not stable"
        self.armed = True
        return True
