"""Relocalization: consensus of rejected poses, and the state moved to it.

The gates themselves (chi-square 99.9 %) are decided inside the compiled updates; here is the way
out when they hold against the truth, as after a kidnap or a wrong start.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.records import PoseMeasurement
from vio.config.filter import RecoveryConfig
from vio.filter import state as at
from vio.filter.adaptive_noise import no_memory
from vio.filter.health import Health, State
from vio.filter.history import History, Snapshots

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


@dataclass(frozen=True, slots=True, eq=False)
class Rejected:
    """Rejected poses beside what the filter had predicted, of I in W.

    tau (k,) [s]; measured p (k, 3), R (k, 3, 3); predicted p and R; sigma (k,) of a position [m].
    """

    tau: Array
    p_z: Array
    R_z: Array
    p: Array
    R: Array
    sigma: Array


@dataclass(frozen=True, slots=True, eq=False)
class Relocation:
    """What takes the prediction to the measurements: p := offset at the last pose, R := turn R."""

    p_WI: Array
    turn_W: Array
    velocity_error: Array
    sigma_m: float
    sigma_rad: float


def agreement(seen: Rejected, config: RecoveryConfig) -> Relocation | None:
    """The one correction that explains every rejected pose, or None where they disagree."""
    turn = seen.R_z @ np.swapaxes(seen.R, -1, -2)
    mean = geo.project_to_so3(turn.mean(axis=0))
    apart = geo.angle(mean.T @ turn)
    if apart.max() > np.radians(config.spread_deg):
        return None
    last = len(seen.tau) - 1
    moved = (seen.p - seen.p[last]) @ mean.T
    offset = seen.p_z - moved
    A = np.stack([np.ones_like(seen.tau), seen.tau - seen.tau[last]], axis=-1)
    fit = np.linalg.lstsq(A, offset, rcond=None)[0]
    miss = np.linalg.norm(offset - A @ fit, axis=1)
    limit = max(config.spread_m, 3.0 * float(np.median(seen.sigma)))
    if miss.max() > limit:
        return None
    sigma_m = max(float(seen.sigma[last]), float(miss.max()), 0.02)
    return Relocation(fit[0], mean, fit[1], sigma_m, max(float(apart.max()), np.radians(2.0)))


def relocate(x: Array, P: Array, move: Relocation) -> tuple[Array, Array]:
    """State and covariance moved there: calibration and biases kept, the rest open again."""
    x, n = x.copy(), len(P)
    R_WI = move.turn_W @ geo.matrix_from_quat(x[at.X_Q : at.X_Q + 4])
    x[at.X_P : at.X_P + 3] = move.p_WI
    x[at.X_Q : at.X_Q + 4] = geo.quat_from_matrix(R_WI)
    x[at.X_V : at.X_V + 3] = move.turn_W @ x[at.X_V : at.X_V + 3] + move.velocity_error
    x[at.X_RECENT :] = no_memory()
    out = P.copy()
    sigma = np.repeat([2.0 * move.sigma_m, 0.5, 2.0 * move.sigma_rad], 3)
    out[: at.BG, :] = out[:, : at.BG] = 0.0
    out[: at.BG, : at.BG] = np.diag(sigma**2)
    tilt = 0.03 + 0.5 * float(geo.angle(move.turn_W))
    out[at.LEVEL : at.LEVEL + 2, :] = out[:, at.LEVEL : at.LEVEL + 2] = 0.0
    out[at.LEVEL, at.LEVEL] = out[at.LEVEL + 1, at.LEVEL + 1] = max(
        P[at.LEVEL, at.LEVEL], min(tilt, 0.3) ** 2
    )
    return x, out[:n, :n]


def relocation(
    history: History, poses: Sequence[PoseMeasurement], config: RecoveryConfig
) -> tuple[int, Array, Array] | None:
    """Snapshot to begin anew at, with its new state and covariance; None: the poses disagree."""
    td_ns, s = history.time_offset_ns, history.snapshots
    ticks = [history.at_or_before(p.t_ns + td_ns) for p in poses]
    if min(ticks) < 0:
        return None
    move = agreement(_beside_predictions(s, poses, ticks, td_ns), config)
    if move is None:
        return None
    return ticks[-1], *relocate(s.x[ticks[-1]], s.P[ticks[-1]], move)


def _beside_predictions(
    snapshots: Snapshots, poses: Sequence[PoseMeasurement], ticks: list[int], td_ns: int
) -> Rejected:
    x = snapshots.x[ticks]
    R_CI, p_CI = geo.invert(
        geo.matrix_from_quat(x[:, at.X_QIC : at.X_QIC + 4]), x[:, at.X_PIC : at.X_PIC + 3]
    )
    R_WC, p_WC = np.array([p.R_WC for p in poses]), np.array([p.p_WC for p in poses])
    R_z, p_z = geo.compose(R_WC, p_WC, R_CI, p_CI)
    t_ns = np.array([p.t_ns for p in poses])
    lead = (t_ns + td_ns - snapshots.t[ticks]) * 1e-9
    return Rejected(
        (t_ns - t_ns[0]) * 1e-9,
        p_z,
        R_z,
        x[:, at.X_P : at.X_P + 3] + lead[:, None] * x[:, at.X_V : at.X_V + 3],
        geo.matrix_from_quat(x[:, at.X_Q : at.X_Q + 4]),
        np.sqrt([np.trace(p.cov[:3, :3]) / 3.0 for p in poses]),
    )
