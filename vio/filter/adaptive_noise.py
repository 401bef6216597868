"""Adaptive measurement noise: R and its slow share from the innovations' autocorrelation.

A filter that takes correlated errors for white ones trusts them too much. White errors leave
innovations that forget at once; correlated ones show in the innovations' autocorrelation, which is
kept in the state (so that a replay finds it again). Correlation that decays within a few frames
moves the inflation of R between 1 and its limit; what a single decay does not explain is the share
of R that varies slowly, and belongs to the pose bias (where R is inflated, less of it is left).
Every entry forgets with the same rate.
Source: after Mehra, On the identification of variances and adaptive Kalman filtering, 1970.
"""

import math
from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import square
from vio.filter import state as at

_FORGET = 1.0 - 1.0 / 300.0  # per measurement
_PRIOR_WEIGHT = 6.0 * 50.0  # as much as 50 measurements know
_PRIOR = (0.5, 0.37, 0.27, 0.2, 0.16)  # by lag: cautious until the innovations tell
_LOW, _HIGH = 0.05, 0.2  # autocorrelation where inflation begins, and where it is at its limit
_SEEN = 1.5  # slow share per autocorrelation seen: the filter has followed a part of the error
_MOST = 0.9  # slow share
_TURNS = 0.5  # slow share of rotations over that of positions: what lasts there, gravity settles
_CLIP = 4.7  # no innovation counts for more than the gate's limit
_GAP_S = 0.5


class NoisePolicy(NamedTuple):
    """What `vio` says of the measurements' noise.

    usual_inflation: `r_inflation`; adapts: `r_adapt`; share_given, share: `pose_bias_share`, where
    it is not learnt; gate: what scales the 99.9 % limits.
    """

    usual_inflation: float
    adapts: bool
    share_given: bool
    share: float
    gate: float


class Trust(NamedTuple):
    """How a frame's noise is taken now: what multiplies it, and the shares that vary slowly.

    slow_position, slow_rotation: those of position and rotation, which are the pose bias's; gate:
    what scales the 99.9 % limits (inf: no gate).
    """

    inflation: float
    slow_position: float
    slow_rotation: float
    gate: float


def no_memory() -> Array:
    """The state's memory at the start; (MEMORY,)."""
    out = np.zeros(at.MEMORY)
    out[at.X_SUMS - at.X_RECENT] = _PRIOR_WEIGHT
    out[at.X_SUMS - at.X_RECENT + 1 : at.X_LAST - at.X_RECENT] = np.array(_PRIOR) * _PRIOR_WEIGHT
    return out


@bare
def _slow(x: Array) -> float:
    """Autocorrelation at the longest lags beyond what one exponential through lag 1 leaves."""
    first, beyond = max(x[at.X_SUMS + 1] / x[at.X_SUMS], 0.0), 0.0
    for lag in range(at.LAGS - 1, at.LAGS + 1):
        beyond += 0.5 * (x[at.X_SUMS + lag] / x[at.X_SUMS] - first**lag)
    return max(beyond, 0.0)


@bare
def _fast(x: Array, biased: bool) -> float:
    """How far, from 0 to 1, the autocorrelation that decays within a few frames asks for more R."""
    rho = x[at.X_SUMS + 1] / x[at.X_SUMS]
    if biased:
        rho -= _slow(x)
    return float(min(max((rho - _LOW) / (_HIGH - _LOW), 0.0), 1.0))


@bare
def slow_share(x: Array, policy: NoisePolicy, biased: bool) -> tuple[float, float]:
    """Which share of a pose's variance varies slowly, of its position and of its rotation.

    biased: the pose bias is a state; without it there is no such share.
    """
    if not biased:
        return 0.0, 0.0
    if policy.share_given or not policy.adapts:
        fixed = min(policy.share, _MOST) if policy.share_given else 0.0
        return fixed, fixed
    learnt = min(max(_SEEN * (_slow(x) - _LOW), 0.0), _MOST)
    return learnt, _TURNS * learnt


@bare
def inflation(x: Array, policy: NoisePolicy, biased: bool) -> float:
    """By how much R is multiplied now."""
    if not policy.adapts:
        return policy.usual_inflation
    return float(1.0 + _fast(x, biased) * max(2.0 * policy.usual_inflation - 1.0, 0.0))


@bare
def trust_now(x: Array, policy: NoisePolicy, biased: bool) -> Trust:
    """How a frame's noise is taken, by what the state remembers of its innovations."""
    position, rotation = slow_share(x, policy, biased)
    return Trust(inflation(x, policy, biased), position, rotation, policy.gate)


@njit
def remember(x: Array, y: Array, t_s: float) -> None:
    """Add a whitened innovation y (6,) of time t_s [s] to the memory in x."""
    norm = square(y)
    if not norm >= 0.0:
        return
    shrink = min(1.0, _CLIP / math.sqrt(norm)) if norm > 0.0 else 1.0
    if t_s - x[at.X_LAST] > _GAP_S:
        x[at.X_RECENT : at.X_SUMS] = 0.0
    x[at.X_LAST] = t_s
    k = len(y)
    for lag in range(at.LAGS + 1):
        product = norm * shrink * shrink
        if lag > 0:
            product = 0.0
            for i in range(k):
                product += shrink * y[i] * x[at.X_RECENT + k * (lag - 1) + i]
        x[at.X_SUMS + lag] = _FORGET * x[at.X_SUMS + lag] + product
    for i in range(at.X_SUMS - 1, at.X_RECENT + k - 1, -1):
        x[i] = x[i - k]
    x[at.X_RECENT : at.X_RECENT + k] = shrink * y
