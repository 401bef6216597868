"""The localizer that flies: what it says goes to the flight controller, sample by sample."""

import threading
from collections.abc import Callable
from typing import Protocol

from tagvo.records import Frame, Observations, PoseMeasurement, PosePrior
from vio.config import Config
from vio.daemon.preflight import Parts
from vio.daemon.time_base import FlightClock
from vio.filter.eskf import ErrorStateFilter
from vio.filter.health import Health
from vio.localize.localizer import Localizer
from vio.records import Ground, ImuSample, Moment, NavState

_COUNT_EVERY = 100  # samples between two looks at the filter's counters


class Link(Protocol):
    """The part of a Bridge that a publisher needs."""

    def wanted(self) -> int | None:
        """The stamp for which a state is wanted besides those at captures."""

    def offer(self, moment: Moment | None, health: Health, captured: bool) -> None:
        """Take a state of the filter."""


class Publisher(Localizer):
    """A localizer whose states at captures (or wanted in between) are offered to a link.

    Its frames come with their tags found. health, counters: the filter's last word on itself, for
    other threads to read; `foresee` is for the thread that tracks.
    """

    filter: ErrorStateFilter

    def __init__(
        self,
        parts: Parts,
        link: Link,
        clock: FlightClock,
        *,
        note: Callable[[int, Health], None] = lambda t_ns, health: None,
        blame: Callable[[], tuple[str, ...]] = tuple,
        lap: Callable[[str], None] = lambda stage: None,
    ) -> None:
        """note: called with each health that was offered and its moment; blame: asked at every
        sample for reasons why the filter is not to be believed, whatever it says."""
        config: Config = parts.config
        super().__init__(parts.camera, parts.tag_map, config, parts.noise, detects=False, lap=lap)
        self.health = self.filter.health()
        self.counters: dict[str, int] = {}
        self._link, self._clock, self._note = link, clock, note
        self._blame = blame
        self._samples = 0
        self._lock = threading.Lock()  # held while the filter changes

    def imu(self, sample: ImuSample) -> NavState | None:
        """The state at this sample; one goes out where the link wants it."""
        with self._lock:
            self.filter.distrust(*self._blame())
            state = super().imu(sample)
        wanted = self._link.wanted()
        if wanted is not None:
            self._offer(self._clock.to_log(wanted), False)
        self._samples += 1
        if self._samples % _COUNT_EVERY == 0:
            self.counters = self.filter.counters
        return state

    def fuse(
        self, frame: Frame, measured: PoseMeasurement | None, seen: Observations | None = None
    ) -> NavState | None:
        """Fuse a frame; the state at its capture goes out."""
        with self._lock:
            state = super().fuse(frame, measured, seen)
        self._offer(frame.t_ns, True)
        return state

    def ground(self, report: Ground) -> None:
        """On the ground the filter takes a velocity of zero."""
        with self._lock:
            super().ground(report)

    def foresee(self, t_ns: int) -> PosePrior | None:
        """As `prior`, from any thread; None also where the IMU has not come near the stamp."""
        with self._lock:
            if self.filter.moment(t_ns) is None:
                return None
            return self.filter.prior(t_ns)

    def _offer(self, t_ns: int, captured: bool) -> None:
        moment = self.filter.moment(t_ns)
        self.health = self.filter.health()
        mapped = None if moment is None else self._clock.moment(moment)
        self._link.offer(mapped, self.health, captured)
        self._note(t_ns, self.health)
