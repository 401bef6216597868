"""The time of a log and the time now: a replay maps one to the other, a flight knows but one."""

from dataclasses import dataclass, replace

from vio.records import Moment


@dataclass(frozen=True, slots=True)
class FlightClock:
    """log0_ns of the log happens at now0_ns (monotonic); speed: seconds of the log in one of ours.

    The default is that of a flight: both are the same.
    """

    log0_ns: int = 0
    now0_ns: int = 0
    speed: float = 1.0

    def to_now(self, log_ns: int) -> int:
        """When a moment of the log happens here."""
        return self.now0_ns + self._scaled(log_ns - self.log0_ns, 1.0 / self.speed)

    def to_log(self, now_ns: int) -> int:
        """Which moment of the log is now."""
        return self.log0_ns + self._scaled(now_ns - self.now0_ns, self.speed)

    def _scaled(self, ns: int, factor: float) -> int:
        return ns if self.speed == 1.0 else round(ns * factor)

    def moment(self, moment: Moment) -> Moment:
        """A state of the log as one of now: a flight in quick motion is quicker."""
        if self.speed == 1.0:
            return replace(moment, t_ns=self.to_now(moment.t_ns))
        v_WI = None if moment.nav.v_WI is None else moment.nav.v_WI * self.speed
        nav = replace(moment.nav, v_WI=v_WI)
        return replace(moment, t_ns=self.to_now(moment.t_ns), nav=nav, w_I=moment.w_I * self.speed)
