"""Says when the vehicle stands on the ground: disarmed, and its IMU as still as one at rest.

Disarmed alone is not enough: people carry vehicles about, and the filter must follow them.
"""

from collections import deque

import numpy as np

from vio.config.filter import VioConfig
from vio.filter.initialization import is_still
from vio.filter.preprocessing import Interval
from vio.records import ImuSample

_WINDOW_NS, _EVERY_NS = 1_000_000_000, 200_000_000
_NO_SCALE = np.ones(6)


class GroundJudge:
    """Takes the IMU's samples; `take` answers where its word has changed."""

    def __init__(self, config: VioConfig) -> None:
        self._config = config
        self._recent: deque[Interval] = deque()
        self._said: bool | None = None
        self._judged_ns = 0

    def take(self, sample: ImuSample, armed: bool) -> bool | None:
        """Whether it stands, where that is news; None: nothing new. Arming counts at once."""
        t_ns, recent = sample.t_ns, self._recent
        recent.append(Interval(t_ns, t_ns, sample.gyro_I, sample.accel_I, _NO_SCALE))
        while t_ns - recent[0].t_ns > _WINDOW_NS or t_ns < recent[0].t_ns:
            recent.popleft()
        if armed:
            return self._say(False)
        if t_ns - self._judged_ns < _EVERY_NS and t_ns >= self._judged_ns:
            return None
        self._judged_ns = t_ns
        whole = t_ns - recent[0].t_ns > 0.9 * _WINDOW_NS
        return self._say(whole and is_still(list(recent), self._config))

    def _say(self, stands: bool) -> bool | None:
        if stands is self._said:
            return None
        self._said = stands
        return stands
