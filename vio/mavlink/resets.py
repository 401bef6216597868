"""The reset counter: the autopilot's only way to know that the pose has jumped, not the vehicle."""

from vio.filter.health import State
from vio.frames import ON_GROUND_RAD, RELEVEL_RAD, Levelling, levelled, relevelled
from vio.records import Moment

_APART_NS = 5_000_000_000  # between two moves on the ground: each resets the autopilot's filter


class ResetCounter:
    """Counts jumps of what is sent, modulo 256: of the filter, of the levelling, and restarts.

    A new value must be on disk before it is sent: `unsaved` until `saved` is told.
    """

    def __init__(self, first: int) -> None:
        self.value = first % 256
        self.levelling: Levelling | None = None
        self.causes: list[str] = []
        self._on_disk: int | None = None
        self._resets: int | None = None
        self._levelled_ns = 0

    @property
    def unsaved(self) -> bool:
        """Whether the value must be saved before it may be sent."""
        return self._on_disk != self.value

    def saved(self, value: int) -> None:
        """This value is on disk."""
        self._on_disk = value

    def look(self, moment: Moment, state: State, resets: int, armed: bool = True) -> bool:
        """Take one state of the filter; whether the counter has moved.

        resets: how often the filter's estimate has jumped. The map is levelled once the filter has
        started, anew when that jumps, and else where gravity has surely moved: while disarmed by
        more than 0.1 deg and at most once in 5 s, armed by more than 0.5 deg.
        """
        if state is State.INIT:
            return False
        jumped = self._resets is not None and resets != self._resets
        self._resets = resets
        if self.levelling is None or jumped:
            axis = None if self.levelling is None else self.levelling.axis
            self.levelling = levelled(moment.down_W, axis)
            self._levelled_ns, turned = moment.t_ns, False
        else:
            turned = self._relevel(moment, armed)
        if jumped or turned:
            self.value = (self.value + 1) % 256
            self.causes.append("relocated" if jumped else "levelled anew")
        return jumped or turned

    def _relevel(self, moment: Moment, armed: bool) -> bool:
        """Follow gravity where it has surely moved; whether the levelling is another one."""
        assert self.levelling is not None
        if not armed and moment.t_ns - self._levelled_ns < _APART_NS:
            return False
        least_rad = RELEVEL_RAD if armed else ON_GROUND_RAD
        self.levelling, turned = relevelled(
            self.levelling, moment.down_W, moment.down_sigma, least_rad
        )
        if turned:
            self._levelled_ns = moment.t_ns
        return turned
