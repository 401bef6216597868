"""Drives a simulated autopilot through a logged flight: IMU, time and poses, in lock step."""

import logging
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array
from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError, LogError
from vio.evaluate.records import Trajectory
from vio.evaluate.truth import clean_truth
from vio.filter.health import Health
from vio.frames import ned_from_level
from vio.records import Moment, Truth
from vio.sitl.estimate import fc_trajectory
from vio.sitl.link import SimLink
from vio.sitl.motion import Motion, placed
from vio.sitl.records import SitlEnd
from vio.sources.flight_log.log import FlightLog

LOG = logging.getLogger("vio.sitl")
_BLOCK = 256  # steps that are computed at once
_MOST_RESTARTS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Offer:
    """A state of the filter that is known now; moment: None where there is none; captured: at a
    frame's capture, else one that was wanted."""

    moment: Moment | None
    health: Health
    captured: bool


Vision = Callable[[int, Callable[[], int | None]], Iterable[Offer]]


@dataclass(frozen=True, slots=True)
class Played:
    """What a run left: the autopilot's estimate, and counts by cause."""

    fc: Trajectory
    counters: Counter[str]
    seconds: float


def play(
    log: FlightLog,
    end: SitlEnd,
    vision: Vision,
    config: MavlinkConfig,
    R_BI: Array,
    rng: np.random.Generator,
    *,
    reference: Truth | None = None,
    rest_s: float = 30.0,
    each_second: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
) -> Played:
    """Play a log's IMU and motion into an autopilot, our poses over MAVLink; its estimate.

    vision(now_ns, wanted): states that are known at a moment of the log's IMU clock, called at
    every step; wanted() says for which stamp one is wanted besides. reference: motion of I in W,
    None: the log's truth. The IMU is resampled to the autopilot's step: means over each step of its
    linear interpolation. rest_s: how long the vehicle stands before the log begins, while the
    autopilot starts. Raises LogError without IMU or reference, LinkError where the autopilot falls
    silent or starts again in the middle.
    """
    truth = reference or log.truth
    if log.imu is None or truth is None or len(log.imu) < 2:
        lacks = "IMU" if log.imu is None or len(log.imu) < 2 else "truth (or another reference)"
        raise LogError(f"{log.path}: no {lacks}; SITL needs the IMU and a motion to play")
    track = clean_truth(truth)
    heading = 0.0 if config.map_heading_deg == "fc" else float(np.radians(config.map_heading_deg))
    place = placed(log.imu, track, heading, R_BI)
    motion = Motion(log.imu, track, place, rng)
    run = _Run(end, lambda: SimLink(config, R_BI), vision, motion, rest_s, each_second, stop)
    try:
        end.start()
        run.all()
    finally:
        run.link.close()
        end.stop()
    link = run.link
    counters = end.counters + link.companion.counters
    R_NW = _R_NW(link, place.R_NW, heading)
    fc = fc_trajectory(link.positions, link.attitudes, link.sent, R_NW, R_BI)
    return Played(fc, counters, (run.now_ns - run.zero_ns) * 1e-9)


def _R_NW(link: SimLink, planned: Array, planned_rad: float) -> Array:
    """As planned, but for the heading, where that was to be the autopilot's."""
    heading = link.companion.heading.rad
    if heading is None:
        return planned
    return np.asarray(ned_from_level(heading) @ ned_from_level(planned_rad).T @ planned)


class _Run:
    """One pass: time moves by the autopilot's steps from `rest_s` before the log to its end."""

    def __init__(
        self,
        end: SitlEnd,
        make_link: Callable[[], SimLink],
        vision: Vision,
        motion: Motion,
        rest_s: float,
        each_second: Callable[[], None],
        stop: Callable[[], bool],
    ) -> None:
        self._end, self._vision, self._motion = end, vision, motion
        self._make_link, self.link = make_link, make_link()
        self._each_second, self._stop = each_second, stop
        self.zero_ns = self.now_ns = motion.begin_ns - round(rest_s * 1e9)
        self._rest_ns, self._restarts = motion.begin_ns - self.zero_ns, 0
        self._second_ns = self.now_ns

    def all(self) -> None:
        """To the end of the log, or until it is to stop."""
        while self.now_ns < self._motion.end_ns and not self._stop():
            self._block(self._end.period_ns)

    def _block(self, period_ns: int) -> None:
        """Some steps of one length."""
        steps = np.arange(1, _BLOCK + 1, dtype=np.int64) * period_ns + self.now_ns
        for state in self._motion.states(steps, period_ns, self.zero_ns):
            goes_on = self._end.step(state)
            self.now_ns = self.zero_ns + state.t_ns
            if not goes_on:
                self._begin_again()
                return
            self._talk()
            if self.now_ns >= self._motion.end_ns or self._end.period_ns != period_ns:
                return

    def _begin_again(self) -> None:
        """The autopilot has started again: stand still once more, or end it in the middle."""
        self._restarts += 1
        if self.now_ns > self._motion.begin_ns or self._restarts > _MOST_RESTARTS:
            at = (self.now_ns - self._motion.begin_ns) * 1e-9
            raise LinkError(
                f"the autopilot has started again at {at:.1f} s of the log: what it estimates from"
                " there is not comparable; look at its console"
            )
        LOG.warning("the autopilot has started again: it is given its time once more")
        self.link.close()
        self.link = self._make_link()
        # simulated time goes on for the autopilot, the log waits
        self.zero_ns -= self.now_ns - (self._motion.begin_ns - self._rest_ns)
        self.now_ns = self._motion.begin_ns - self._rest_ns

    def _talk(self) -> None:
        now = self.now_ns
        self.link.turn(now)
        for offer in self._vision(now, lambda: self.link.companion.wanted(now)):
            self.link.offer(offer.moment, offer.health, offer.captured, now)
        if now - self._second_ns >= 1_000_000_000:
            self._second_ns = now
            self._each_second()
