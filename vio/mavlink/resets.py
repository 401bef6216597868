"""The reset counter: the autopilot's only way to know that the pose has jumped, not the vehicle."""

from vio.frames import Levelling, levelled, relevelled
from vio.health import State
from vio.records import Moment


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

    @property
    def unsaved(self) -> bool:
        """Whether the value must be saved before it may be sent."""
        return self._on_disk != self.value

    def saved(self, value: int) -> None:
        """This value is on disk."""
        self._on_disk = value

    def look(self, moment: Moment, state: State, resets: int) -> bool:
        """Take one state of the filter; whether the counter has moved.

        resets: how often the filter's estimate has jumped. The map is levelled once the filter has
        started, anew when that jumps, and else where gravity has surely moved by more than 0.5 deg.
        """
        if state is State.INIT:
            return False
        jumped = self._resets is not None and resets != self._resets
        self._resets = resets
        if self.levelling is None or jumped:
            axis = None if self.levelling is None else self.levelling.axis
            self.levelling = levelled(moment.down_W, axis)
            turned = False
        else:
            self.levelling, turned = relevelled(self.levelling, moment.down_W, moment.down_sigma)
        if jumped or turned:
            self.value = (self.value + 1) % 256
            self.causes.append("relocated" if jumped else "levelled anew")
        return jumped or turned
