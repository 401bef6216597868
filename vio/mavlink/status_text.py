"""What the ground station reads: changes of state in plain words, no more than one a second."""

from vio.filter.health import Health, State
from vio.mavlink.messages import INFO, WARNING, Outgoing, statustext
from vio.setup_check.findings import SHORT

_APART_NS = 1_000_000_000
_SAY = {
    State.INIT: "waiting for tags and IMU",
    State.TRACKING: "tracking",
    State.COASTING: "no tags, coasting on the IMU",
    State.LOST: "lost, pose withheld",
    State.RELOCATING: "tags contradict the filter",
}
_WHY = {
    "no_imu": "no IMU",
    "no_pose": "no tag pose",
    "still_window": "hold still",
    "poses_disagree_with_imu": "tags disagree with the IMU",
    "imu_lost": "IMU gap",
    "position_sigma": "position uncertain",
    "attitude_sigma": "attitude uncertain",
    "no_pose_for_long": "no tags for long",
    "poses_rejected": "tags rejected",
    "innovation": "residuals large",
    "imu_gap": "IMU gap",
    "imu_stalled": "IMU stalled",
    "calibration_far": "calibration far off",
    "begins_again": "beginning again",
    **{f"setup_{code}": text for code, text in SHORT.items()},
}


class Speaker:
    """Keeps the newest thing to say; `due` hands it over as STATUSTEXT."""

    def __init__(self, mute: bool = False) -> None:
        """mute: say nothing, ever."""
        self._mute = mute
        self._next: list[tuple[str, int]] = []
        self._state: State | None = None
        self._last_ns: int | None = None
        self._id = 0

    def health(self, health: Health) -> None:
        """Note the filter's state; only a change is said, and only the newest of several."""
        if health.state is self._state:
            return
        self._state = health.state
        why = ", ".join(_WHY.get(r, r) for r in health.reasons)
        quiet = health.state in (State.TRACKING, State.INIT)
        text = f"tagvio: {_SAY[health.state]}" + (f" ({why})" if why and not quiet else "")
        self._next = [one for one in self._next if not one[0].startswith("tagvio: ")]
        self._next.append((text, INFO if quiet else WARNING))

    def say(self, text: str, severity: int) -> None:
        """Say something else."""
        self._next.append((f"tagvio {text}", severity))
        self._next = self._next[-4:]

    def at_once(self, text: str, severity: int) -> list[Outgoing]:
        """Say something now, whatever was said a moment ago."""
        self._id = self._id % 65535 + 1
        return statustext(f"tagvio {text}", severity, self._id)

    def due(self, now_ns: int) -> list[Outgoing]:
        """What to send now."""
        if self._mute:
            self._next.clear()
        if not self._next or (self._last_ns is not None and now_ns - self._last_ns < _APART_NS):
            return []
        self._last_ns = now_ns
        self._id = self._id % 65535 + 1
        text, severity = self._next.pop(0)
        return statustext(text, severity, self._id)
