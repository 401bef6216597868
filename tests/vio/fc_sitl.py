"""In-test SITLs of both kinds: an estimator that runs on what the simulator's end sends, in step.

Written from ArduPilot's JSON readme and PX4's user guide. Their filter is a strapdown with fixed
gains: it follows only where the IMU, its axes, its times and the poses belong together.
"""

import json
import socket
import struct
import threading

import numpy as np
from fc_ardupilot import ArduPilot
from fc_autopilot import SYSTEM
from fc_px4 import Px4
from fc_vehicle import Vehicle
from pymavlink.dialects.v20 import ardupilotmega as m

from tagvo import geometry as geo

G_N = np.array([0.0, 0.0, 9.81])


class Strapdown:
    """Position, velocity and attitude in NED by the IMU; poses correct them where they were."""

    def __init__(self):
        self.p, self.v, self.R = np.zeros(3), np.zeros(3), None
        self.moved, self.past, self.times = np.zeros(3), [], []
        self.yawed, self.n, self.bias, self.up = False, 0, np.zeros(3), np.zeros(3)

    def predict(self, t_ns, gyro, accel, dt):
        if not self.yawed:  # at rest: level by gravity, the gyro's mean is its bias
            self.n += 1
            self.bias = self.bias + (gyro - self.bias) / self.n
            self.up = self.up + (accel - self.up) / self.n
            up = self.up / np.linalg.norm(self.up)
            roll, pitch = np.arctan2(-up[1], -up[2]), np.arctan2(up[0], np.hypot(up[1], up[2]))
            self.R = geo.matrix_from_rpy(roll, pitch, 0.0)
            return
        self.R = self.R @ geo.exp((gyro - self.bias) * dt)
        a = self.R @ accel + G_N
        self.p = self.p + self.v * dt + 0.5 * a * dt * dt
        self.v = self.v + a * dt
        self.times.append(t_ns)
        self.past.append(self.p - self.moved)
        if len(self.times) > 2000:
            del self.times[:1000], self.past[:1000]

    @property
    def yaw(self):
        return float(np.arctan2(self.R[1, 0], self.R[0, 0]))

    def correct(self, t_ns, p, yaw):
        if self.R is None:
            return
        misfit = (yaw - self.yaw + np.pi) % (2 * np.pi) - np.pi
        if not self.yawed:
            self.R = geo.exp(np.array([0.0, 0.0, misfit])) @ self.R
            self.p, self.yawed = np.array(p), True
            return
        if not self.times:
            return
        i = min(int(np.searchsorted(self.times, t_ns)), len(self.times) - 1)
        wrong = p - self.past[i] - self.moved
        self.p, self.moved = self.p + 0.25 * wrong, self.moved + 0.25 * wrong
        self.v = self.v + 0.6 * wrong
        lean = np.cross([0.0, 0.0, 1.0], 0.012 * wrong)  # a tilt accelerates sideways
        self.R = geo.exp(np.array([-lean[0], -lean[1], 0.1 * misfit])) @ self.R


class SitlMixin:
    """What both have: the simulated clock, the strapdown, and telling of it."""

    def boot(self, t_ns):
        super().boot(t_ns)
        self.strapdown = Strapdown()
        self.used = []

    def clock(self, t_ns):
        return t_ns

    def fly(self, t_ns, dt):
        pass

    def interval(self, message_id, interval_us):
        if message_id in (30, 32):
            self.streams[message_id] = round(interval_us * 1000)
            return 0
        return super().interval(message_id, interval_us)

    def tell(self, t_ns):
        s = self.strapdown
        if s.R is None or not s.yawed:
            return
        if self.due(32, t_ns):
            ms = t_ns // 10**6
            p = s.p - self.ekf.p + self.local()  # as its origin has it
            self.send(m.MAVLink_local_position_ned_message(ms, *p, *s.v))
        if self.due(30, t_ns):
            rpy = geo.rpy_from_matrix(s.R)
            self.send(m.MAVLink_attitude_message(t_ns // 10**6, *rpy, 0, 0, 0))


class SitlArduPilot(SitlMixin, ArduPilot):
    def loop(self, t_ns):
        streams, self.streams = self.streams, {}
        super().loop(t_ns)
        self.streams = streams
        self.tell(t_ns)

    def vision(self, t_ns, usec, p, yaw, cov, counter):
        stamp = self.jitter.correct(usec * 1000, t_ns) - self.VISO_DELAY_MS * 1_000_000
        self.strapdown.correct(stamp, p, yaw)
        self.used.append((t_ns, usec))


class SitlPx4(SitlMixin, Px4):
    def loop(self, t_ns):
        streams, self.streams = self.streams, {}
        super().loop(t_ns)
        self.streams = streams
        self.tell(t_ns)

    def vision(self, t_ns, usec, p, yaw, cov, counter, quality, frame):
        stamp = self.timesync.sync(usec * 1000, t_ns)
        self.strapdown.correct(stamp, p, yaw)
        self.used.append((t_ns, usec))


class _Running:
    """A SITL in a thread of its own: physics by `step`, MAVLink by UDP to a port of ours."""

    kind = None

    def __init__(self, mavlink_port, seed=0):
        self.fc = self.kind(Vehicle(), np.random.default_rng(seed), system=SYSTEM)
        self.mavlink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.mavlink.bind(("127.0.0.1", 0))
        self.mavlink.setblocking(False)
        self.to = ("127.0.0.1", mavlink_port)
        self.stopped, self.fault = threading.Event(), None
        self.thread = threading.Thread(target=self._live, daemon=True)
        self.last_s = None
        self.seen = []

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *_):
        self.stopped.set()
        self.thread.join(5.0)
        self.mavlink.close()
        assert self.fault is None, self.fault

    def _live(self):
        try:
            self.live()
        except (OSError, ValueError, KeyError, AssertionError) as err:
            if not self.stopped.is_set():
                self.fault = err

    def turn(self, t_ns, gyro, accel):
        """One frame of the autopilot at its time."""
        dt = 0.0 if self.last_s is None else (t_ns - self.last_s) * 1e-9
        self.last_s = t_ns
        self.fc.strapdown.predict(t_ns, gyro, accel, dt)
        while True:
            try:
                self.fc.receive(self.mavlink.recv(65536), t_ns)
            except (BlockingIOError, ConnectionRefusedError):
                break
        for data in self.fc.poll(t_ns):
            try:
                self.mavlink.sendto(data, self.to)
            except ConnectionRefusedError:
                continue


class RunningArduPilot(_Running):
    """Sends servo packets, waits for a line each; `lose(count)`: whether its answer gets lost."""

    kind = SitlArduPilot

    def __init__(self, port, mavlink_port, rate=400, magic=18458, lose=lambda count: False,
                 skip=lambda count: False, restart_at=None, again_s=1.0, end_at=None):  # fmt: skip
        super().__init__(mavlink_port)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(again_s)
        self.port, self.rate, self.magic = port, rate, magic
        self.lose, self.skip, self.restart_at, self.end_at = lose, skip, restart_at, end_at
        self.count, self.base_ns = 0, 0

    def packet(self):
        n = 16 if self.magic == 18458 else 32
        return struct.pack(f"<HHI{n}H", self.magic, self.rate, self.count, *[1500] * n)

    def live(self):
        lost = set()
        with self.socket:
            while not self.stopped.is_set():
                if self.count == self.end_at:
                    return
                self.socket.sendto(self.packet(), ("127.0.0.1", self.port))
                try:
                    line = self.socket.recv(65536)
                except TimeoutError:
                    continue  # the same count once more
                except ConnectionRefusedError:  # the simulator is not there yet
                    self.stopped.wait(0.2)
                    continue
                if self.lose(self.count) and self.count not in lost:
                    lost.add(self.count)
                    continue
                self.take(line)
                self.count += 2 if self.skip(self.count) else 1
                if self.count == self.restart_at:
                    self.restart_at, self.count, self.last_s = None, 0, None
                    self.base_ns = 0
                    self.fc.boot(0)

    def take(self, line):
        assert line.startswith(b"\n")
        assert line.endswith(b"}\n")
        said = json.loads(line)
        now = round(said["timestamp"] * 1e9)
        if self.base_ns == 0:
            self.base_ns = now  # it counts its own time from its start
        t_ns = now - self.base_ns + 10**9
        gyro, accel = np.array(said["imu"]["gyro"]), np.array(said["imu"]["accel_body"])
        self.seen.append((now, gyro, accel, said["position"], said["quaternion"], said["velocity"]))
        self.turn(t_ns, gyro, accel)


class RunningPx4(_Running):
    """Connects to the simulator; runs free for some steps, then answers each HIL_SENSOR."""

    kind = SitlPx4

    def __init__(self, port, mavlink_port, free=50, mute=lambda n: False, restart_at=None):
        super().__init__(mavlink_port)
        self.port, self.free, self.mute, self.restart_at = port, free, mute, restart_at
        self.messages = {}

    def live(self):
        n = 0
        while not self.stopped.is_set():
            try:
                s = socket.create_connection(("127.0.0.1", self.port), 5.0)
            except ConnectionRefusedError:  # the simulator is not there yet
                self.stopped.wait(0.2)
                continue
            with s:
                s.settimeout(0.1)
                n = self.talk(s, n)

    def talk(self, s, n):
        mav, own = m.MAVLink(None), m.MAVLink(None, srcSystem=1, srcComponent=1)
        while not self.stopped.is_set():
            try:
                data = s.recv(65536)
            except TimeoutError:
                continue
            if not data:
                self.stopped.set()
                return n
            for message in mav.parse_buffer(data) or ():
                self.messages.setdefault(message.get_type(), []).append(message)
                if message.get_type() != "HIL_SENSOR":
                    continue
                n += 1
                t_ns = message.time_usec * 1000
                gyro = np.array([message.xgyro, message.ygyro, message.zgyro])
                accel = np.array([message.xacc, message.yacc, message.zacc])
                self.seen.append((t_ns, gyro, accel))
                self.turn(t_ns, gyro, accel)
                if n == self.restart_at:
                    self.fc.boot(t_ns)
                    self.last_s = None
                    return n
                if n > self.free and not self.mute(n):
                    out = m.MAVLink_hil_actuator_controls_message(
                        message.time_usec, [0.1] * 16, 0, 1)  # fmt: skip
                    s.sendall(bytes(out.pack(own)))
        return n
