"""How much the poses' errors remember: what the filter must add for errors that are not white.

A filter that takes correlated errors for white ones trusts them too much. White errors leave
innovations that forget at once; correlated ones show in the innovations' autocorrelation, which is
kept in the state (so that a replay finds it again) and moves the inflation of R between 1 and its
limit. Every entry forgets with the same rate.
"""

import math

import numpy as np

from tagvo.compiled import njit
from tagvo.geometry import Array
from vio import layout as at

_FORGET = 1.0 - 1.0 / 300.0  # per measurement
_PRIOR_WEIGHT = 6.0 * 40.0  # as much as 40 measurements know
_PRIOR = 0.16
_LOW, _HIGH = 0.05, 0.2  # autocorrelation where inflation begins, and where it is at its limit
_CLIP = 4.7  # no innovation counts for more than the gate's limit
_GAP_S = 0.5


def no_memory() -> Array:
    """The state's memory at the start; (MEMORY,)."""
    out = np.zeros(at.MEMORY)
    out[at.X_SUMS - at.X_RECENT] = _PRIOR_WEIGHT
    out[at.X_SUMS - at.X_RECENT + 1 : at.X_LAST - at.X_RECENT] = _PRIOR * _PRIOR_WEIGHT
    return out


@njit
def inflation(x: Array, par: Array) -> float:
    """By how much R is multiplied now; par (3,): usual inflation, gate, whether to adapt."""
    if par[2] == 0.0:
        return float(par[0])
    mean = 0.0
    for lag in range(1, at.LAGS + 1):
        mean += x[at.X_SUMS + lag] / at.LAGS
    rho = max(mean, x[at.X_SUMS + 1]) / x[at.X_SUMS]
    s = min(max((rho - _LOW) / (_HIGH - _LOW), 0.0), 1.0)
    return float(1.0 + s * max(2.0 * par[0] - 1.0, 0.0))


@njit
def remember(x: Array, y: Array, t_s: float) -> None:
    """Add a whitened innovation y (6,) of time t_s [s] to the memory in x."""
    norm = 0.0
    for i in range(6):
        norm += y[i] * y[i]
    if not norm >= 0.0:
        return
    shrink = min(1.0, _CLIP / math.sqrt(norm)) if norm > 0.0 else 1.0
    if t_s - x[at.X_LAST] > _GAP_S:
        x[at.X_RECENT : at.X_SUMS] = 0.0
    x[at.X_LAST] = t_s
    for lag in range(at.LAGS + 1):
        product = norm * shrink * shrink
        if lag > 0:
            product = 0.0
            for i in range(6):
                product += shrink * y[i] * x[at.X_RECENT + 6 * (lag - 1) + i]
        x[at.X_SUMS + lag] = _FORGET * x[at.X_SUMS + lag] + product
    for k in range(6 * at.LAGS - 1, 5, -1):
        x[at.X_RECENT + k] = x[at.X_RECENT + k - 6]
    for i in range(6):
        x[at.X_RECENT + i] = shrink * y[i]
