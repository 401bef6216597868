"""What an autopilot's simulator says at each step, and how such an end is driven."""

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

from tagvo.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class SimState:
    """One step of simulated time, t_ns since its start.

    gyro_F (3,) [rad/s] and accel_F (3,) specific force [m/s^2] of the body F (forward, right,
    down), means over the step that ends at t_ns; p_N (3,) [m], v_N (3,) [m/s], q_NF (4,) wxyz:
    reference motion in N (north, east, down).
    """

    t_ns: int
    gyro_F: Array
    accel_F: Array
    p_N: Array
    v_N: Array
    q_NF: Array


class SitlEnd(Protocol):
    """The simulator's end of an autopilot's protocol, in lock step: simulated time moves by `step`.

    counters: what was lost, repeated or begun anew.
    """

    counters: Counter[str]

    @property
    def period_ns(self) -> int:
        """How long a step is, as the autopilot wants it; may change."""

    def start(self) -> None:
        """Wait for the autopilot; LinkError where none comes."""

    def step(self, state: SimState) -> bool:
        """Hand over a state, wait until the autopilot is through with it.

        False: it has started again. LinkError: it has fallen silent.
        """

    def stop(self) -> None:
        """Give sockets back."""
