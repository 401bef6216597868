"""Our own poses for a simulated flight: the log through tagvo and the filter, as it was known."""

from collections.abc import Callable

from tagvo.pipeline import TagVO
from tagvo.records import Frame
from vio.localize.baselines import Output
from vio.localize.fused import VioArm
from vio.records import Ground, ImuSample
from vio.sitl.play import Offer
from vio.sources.flight_log.log import FlightLog


class LogVision:
    """Feeds the log's events to the filter when their time of arrival has come.

    outputs: what the filter said, an output a stamp, for the estimator `vio` beside `fc`; frames,
    with_pose: counts.
    """

    def __init__(self, log: FlightLog, vo: TagVO, arm: VioArm, each_frame: Callable[[], None]):
        self._events, self._vo, self._arm = log.events(), vo, arm
        self._each_frame = each_frame
        self._next = next(self._events, None)
        self.outputs: list[Output] = []
        self.frames = self.with_pose = 0

    def __call__(self, now_ns: int, wanted: Callable[[], int | None]) -> list[Offer]:
        """All states that became known up to now."""
        offers: list[Offer] = []
        while self._next is not None and _arrival(self._next) <= now_ns:
            offers += self._take(self._next, wanted)
            self._next = next(self._events, None)
        return offers

    def _take(
        self, event: ImuSample | Frame | Ground, wanted: Callable[[], int | None]
    ) -> list[Offer]:
        estimator = self._arm.estimator
        if isinstance(event, Ground):
            self._arm.ground(event.on_ground)
            return []
        if isinstance(event, ImuSample):
            self._keep(self._arm.imu(event))
            t_ns = wanted()
            if t_ns is None:
                return []
            return [Offer(estimator.moment(t_ns), estimator.health(), False)]
        trace = self._vo.trace(event, self._arm.prior(event.t_ns))
        self._keep(self._arm.pose(event, trace.pose, trace.observations))
        self.frames += 1
        self.with_pose += trace.pose is not None
        self._each_frame()
        return [Offer(estimator.moment(event.t_ns), estimator.health(), True)]

    def _keep(self, output: Output | None) -> None:
        if output is not None and (not self.outputs or self.outputs[-1].t_ns != output.t_ns):
            self.outputs.append(output)


def _arrival(event: ImuSample | Frame | Ground) -> int:
    if not isinstance(event, Frame):
        return event.arrival_ns
    return event.t_ns if event.arrival_ns is None else event.arrival_ns
