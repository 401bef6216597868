"""Simulated time between a Companion and an in-test autopilot: wires, cameras, no clock."""

import heapq
import itertools

import numpy as np
from fc_vehicle import turn
from numpy import eye, zeros

from vio.config.mavlink import MavlinkConfig
from vio.filter.health import Health, Signs, State
from vio.frames import FLIP
from vio.mavlink.codec import MESSAGE_IDS, Codec
from vio.mavlink.protocol import Companion
from vio.records import Moment, NavState
from vio.sources.live.imu import MavlinkImu

MS = 1_000_000
S = 1_000_000_000
EPOCH = 777 * S  # of the companion's clock: not the autopilot's
TRACKING = Health(State.TRACKING, (), Signs(0.0, 0, 1.0, 0.01, 0.3, False), 0)


def health(state=State.TRACKING, resets=0):
    return Health(state, (), TRACKING.signs, resets)


class World:
    """Runs both ends in true time [ns]; the companion's clock is true time plus EPOCH.

    sabotage: what a worse bridge would make of each message, (message, now_ns) -> message or None.
    """

    def __init__(self, autopilot, rng, config=None, sabotage=None, delay=(0.2, 1.5), counter=7,
                 tick_ns=2 * MS, with_imu=False):  # fmt: skip
        none = {} if with_imu else {"imu": {"message": "none"}}
        self.fc, self.rng = autopilot, rng
        self.config = MavlinkConfig.model_validate({**none, **(config or {})})
        self.companion = Companion(self.config, eye(3), zeros(3), counter, MESSAGE_IDS)
        self.codec = Codec(1, 197)
        self.sabotage = sabotage or (lambda message, now: message)
        self.delay, self.tick_ns = delay, tick_ns
        self.t, self.queue, self.number = 0, [], itertools.count()
        self.up = True
        self.sent, self.samples = [], []
        self.imu = MavlinkImu(self.companion, eye(3), self.samples.append)
        self.at(0, self._poll)
        self.due_t = 0
        self.at(0, self._due)

    # time

    def at(self, t_ns, what):
        heapq.heappush(self.queue, (t_ns, next(self.number), what))

    def run(self, until_s):
        while self.queue and self.queue[0][0] <= until_s * S:
            self.t, _, what = heapq.heappop(self.queue)
            what()
        self.t = round(until_s * S)

    @property
    def now(self):
        """The companion's clock."""
        return self.t + EPOCH

    # wires

    def _way(self):
        return round(self.rng.uniform(*self.delay) * MS)

    def _poll(self):
        for data in self.fc.poll(self.t):
            if self.up:
                self.at(self.t + self._way(), lambda data=data: self._to_companion(data))
        self.at(self.t + self.tick_ns, self._poll)

    def _to_companion(self, data):
        for message in self.codec.decode(data):
            self.send(self.companion.heard(message, self.now))
            self.imu.heard(message, self.now)

    def _due(self):
        """The reader's thread: it wakes when something is due, and is woken by what is offered."""
        if self.t >= self.due_t:
            self.send(self.companion.due(self.now))
            self.due_t = 1 << 62
        self._wake()

    def _wake(self):
        due_t = max(self.companion.due_ns - EPOCH, self.t)
        if due_t < self.due_t:
            self.due_t = due_t
            self.at(due_t, self._due)

    def send(self, messages):
        self.companion.resets.saved(self.companion.resets.value)  # a disk that is never slow
        for message in messages:
            made = self.sabotage(message, self.now)
            if made is None:
                continue
            self.sent.append((self.t, made))
            self.companion.wrote(message)
            if self.up:
                frame = self.codec.encode(made)
                self.at(self.t + self._way(), lambda frame=frame: self._to_fc(frame))

    def _to_fc(self, frame):
        self.fc.receive(frame, self.t)

    # what the filter would say

    def see(self, moment_at, rate_hz=30.0, latency_ms=(60.0, 60.0), first_s=0.0, last_s=1e9):
        """A camera: every frame's state is offered after a latency, in order of arrival.

        moment_at(t_ns): state of the body at a true time and its health; None: nothing to offer.
        """
        period = round(S / rate_hz)
        known = 0

        def capture(k=0):
            nonlocal known
            t = round(first_s * S) + k * period
            if t > last_s * S:
                return
            known = max(known + MS, t + round(self.rng.uniform(*latency_ms) * MS))
            made = moment_at(t)
            if made is not None:
                self.at(known, lambda: self._offer(*made, True))
            self.at(t + period, lambda: capture(k + 1))

        self.at(round(first_s * S), capture)

    def feel(self, moment_at, rate_hz=200.0, first_s=0.0):
        """The IMU's ticks: a state besides those at captures, where the companion wants one."""
        period = round(S / rate_hz)

        def tick():
            wanted = self.companion.wanted(self.now)
            if wanted is not None:
                made = moment_at(wanted - EPOCH)
                if made is not None:
                    self._offer(*made, False)
            self.at(self.t + period, tick)

        self.at(round(first_s * S), tick)

    def _offer(self, moment, health, captured):
        self.send(self.companion.offer(moment, health, captured, self.now))
        self._wake()

    def poses(self, name="VISION_POSITION_ESTIMATE"):
        """True times and fields of the poses that left."""
        return [(t, m.fields) for t, m in self.sent if m.name == name]


def moments(vehicle, rng, heading=0.0, noise=0.005, shift=lambda t: zeros(3), say=None, sigma=0.05):
    """states of the vehicle in a level map whose x has this heading, for `see` and `feel`.

    shift(t_ns): by how much the map's pose is off [m, NED]; say(t_ns): the health then.
    """
    R_NW = turn(heading) @ np.diag(FLIP)

    def at(t_ns):
        p_N, v_N, yaw = vehicle.at(t_ns)
        p_N = p_N + shift(t_ns) + noise * rng.normal(size=3)
        R_WI = R_NW.T @ turn(yaw) @ np.diag(FLIP)
        cov = np.diag([sigma**2] * 3 + [0.02**2] * 3 + [0.03**2] * 3)
        nav = NavState(t_ns + EPOCH, R_NW.T @ p_N, R_WI, R_NW.T @ v_N, cov)
        moment = Moment(t_ns + EPOCH, nav, zeros(3), np.array([0.0, 0.0, -1.0]))
        return moment, TRACKING if say is None else say(t_ns)

    return at
