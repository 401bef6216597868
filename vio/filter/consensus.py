"""Which rejected poses deserve belief after all: those that agree with one another.

The gates themselves (chi-square 99.9 %) are decided inside the compiled corrections; here is the
way out when they hold against the truth, as after a kidnap or a wrong start.
"""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.config.filter import RecoveryConfig
from vio.filter import state as at
from vio.filter.adaptive_noise import no_memory


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
    out[at.GR : at.GR + 2, :] = out[:, at.GR : at.GR + 2] = 0.0
    out[at.GR, at.GR] = out[at.GR + 1, at.GR + 1] = max(P[at.GR, at.GR], min(tilt, 0.3) ** 2)
    return x, out[:n, :n]
