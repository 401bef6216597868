"""The way back after a kidnap or a wrong start: where the rejected poses would have the filter."""

from collections.abc import Sequence

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.records import PoseMeasurement
from vio.config.filter import RecoveryConfig
from vio.filter import state as at
from vio.filter.consensus import Rejected, agreement, relocate
from vio.filter.health import Health, State
from vio.filter.history import Window

_POSES_STOP_NS = 1_000_000_000  # poses further apart do not keep arriving


class LostWatch:
    """Since when the filter is LOST though poses arrive: then it must begin anew by itself."""

    def __init__(self, config: RecoveryConfig) -> None:
        self._after_s, self._patience = config.restart_after_s, 1.0
        self._since_ns: int | None = None
        self._pose_ns = 0

    def clear(self) -> None:
        """It has begun anew, or jumped."""
        self._since_ns = None

    def asks(self, health: Health, now_ns: int, pose_ns: int) -> bool:
        """Whether to begin anew; asked at each pose, with its stamp."""
        gap, self._pose_ns = pose_ns - self._pose_ns > _POSES_STOP_NS, pose_ns
        if health.state is State.TRACKING:
            self._patience = 1.0
        if gap or health.state is not State.LOST:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        if now_ns - self._since_ns <= self._after_s * self._patience * 1e9:
            return False
        self._patience *= 2.0  # what a new start has not mended needs longer
        return True


def relocation(
    window: Window, poses: Sequence[PoseMeasurement], config: RecoveryConfig
) -> tuple[int, Array, Array] | None:
    """Snapshot to begin anew at, with its new state and covariance; None: the poses disagree."""
    td_ns = round(window.X[window.last, at.X_TD] * 1e9)
    ticks = [window.at_or_before(p.t_ns + td_ns) for p in poses]
    if min(ticks) < 0:
        return None
    move = agreement(_beside_predictions(window, poses, ticks, td_ns), config)
    if move is None:
        return None
    return ticks[-1], *relocate(window.X[ticks[-1]], window.P[ticks[-1]], move)


def _beside_predictions(
    window: Window, poses: Sequence[PoseMeasurement], ticks: list[int], td_ns: int
) -> Rejected:
    x = window.X[ticks]
    R_CI, p_CI = geo.invert(
        geo.matrix_from_quat(x[:, at.X_QIC : at.X_QIC + 4]), x[:, at.X_PIC : at.X_PIC + 3]
    )
    R_WC, p_WC = np.array([p.R_WC for p in poses]), np.array([p.p_WC for p in poses])
    R_z, p_z = geo.compose(R_WC, p_WC, R_CI, p_CI)
    t_ns = np.array([p.t_ns for p in poses])
    lead = (t_ns + td_ns - window.t[ticks]) * 1e-9
    return Rejected(
        (t_ns - t_ns[0]) * 1e-9,
        p_z,
        R_z,
        x[:, at.X_P : at.X_P + 3] + lead[:, None] * x[:, at.X_V : at.X_V + 3],
        geo.matrix_from_quat(x[:, at.X_Q : at.X_Q + 4]),
        np.sqrt([np.trace(p.cov[:3, :3]) / 3.0 for p in poses]),
    )
