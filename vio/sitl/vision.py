"""Our own poses for a simulated flight: the log through the localizer, as it was known."""

from collections.abc import Callable

from tagvo.records import Frame
from vio.filter.eskf import ErrorStateFilter
from vio.localize.localizer import Event, Localizer
from vio.records import ImuSample, NavState
from vio.sitl.play import Offer
from vio.sources.flight_log.log import FlightLog


class LogVision:
    """Hands the log's events to a localizer when their time of arrival has come.

    outputs: what the filter said, a state a stamp, for the estimator `vio` beside `fc`; frames,
    with_pose: counts.
    """

    def __init__(self, log: FlightLog, localizer: Localizer, each_frame: Callable[[], None]):
        assert localizer.filter is not None
        self._events, self._localizer, self._each_frame = log.events(), localizer, each_frame
        self._filter: ErrorStateFilter = localizer.filter
        self._next = next(self._events, None)
        self.outputs: list[NavState] = []
        self.frames = self.with_pose = 0

    def __call__(self, now_ns: int, wanted: Callable[[], int | None]) -> list[Offer]:
        """All states that became known up to now."""
        offers: list[Offer] = []
        while self._next is not None and _arrival(self._next) <= now_ns:
            event, state = self._next, self._localizer.process(self._next)
            if state is not None and (not self.outputs or self.outputs[-1].t_ns != state.t_ns):
                self.outputs.append(state)
            t_ns = event.t_ns if isinstance(event, Frame) else None
            if isinstance(event, ImuSample):
                t_ns = wanted()
            if isinstance(event, Frame):
                self._count()
            if t_ns is not None:
                moment, health = self._filter.moment(t_ns), self._filter.health()
                offers.append(Offer(moment, health, isinstance(event, Frame)))
            self._next = next(self._events, None)
        return offers

    def _count(self) -> None:
        trace = self._localizer.trace
        self.frames += 1
        self.with_pose += trace is not None and trace.pose is not None
        self._each_frame()


def _arrival(event: Event) -> int:
    if not isinstance(event, Frame):
        return event.arrival_ns
    return event.t_ns if event.arrival_ns is None else event.arrival_ns
