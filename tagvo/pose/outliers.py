"""OR, the paper's outlier removal: interquartile ranges of the positions, axis by axis."""

from collections.abc import Callable

import numpy as np

from tagvo.config import IqrConfig
from tagvo.geometry import Array, BoolArray
from tagvo.kernels.jit import njit

_FEWEST = 3  # the paper: at least three elements

# position of the lower quartile among n sorted values counted from 0, a + b n; the upper mirrors it
_QUARTILE = {"hazen": (-0.5, 0.25), "linear": (-0.25, 0.25), "weibull": (-0.75, 0.25)}


@njit
def _inliers(p: Array, gain: float, a: float, b: float, floor: float) -> BoolArray:
    n = len(p)
    mask = np.ones(n, dtype=np.bool_)
    at = min(max(a + b * n, 0.0), n - 1.0)
    low, share = int(at), at - int(at)
    above = min(low + 1, n - 1)
    for axis in range(p.shape[1]):
        s = np.sort(p[:, axis])
        lower = s[low] + share * (s[above] - s[low])
        upper = s[n - 1 - low] + share * (s[n - 1 - above] - s[n - 1 - low])
        reach = gain * max(upper - lower, floor)
        for i in range(n):
            mask[i] = mask[i] and lower - reach <= p[i, axis] <= upper + reach
    return mask


def iqr_inliers(p: Array, config: IqrConfig) -> tuple[BoolArray, tuple[str, ...]]:
    """Positions inside [Q1 - gain IQR, Q3 + gain IQR] on all three axes.

    p (n, 3) [m] -> mask (n,), flags. Fewer than three: all kept, `or_skipped`. None left: the one
    nearest the median, `degraded`. Paper, eq. valid_pos; `<=` and a floor on the IQR so that
    noise-free data are not rejected.
    """
    n = len(p)
    if n < _FEWEST:
        return np.ones(n, dtype=bool), ("or_skipped",) if n else ()
    a, b = _QUARTILE[config.quartiles]
    mask = _inliers(p, config.gain, a, b, config.floor_m)
    if mask.any():
        return mask, ()
    mask[np.argmin(np.linalg.norm(p - np.median(p, axis=0), axis=1))] = True
    return mask, ("degraded", "or_empty")


def no_removal(p: Array, config: IqrConfig) -> tuple[BoolArray, tuple[str, ...]]:
    """notOR: everything is kept; (n, 3) -> mask (n,), flags."""
    return np.ones(len(p), dtype=bool), ()


REJECT: dict[str, Callable[[Array, IqrConfig], tuple[BoolArray, tuple[str, ...]]]] = {
    "iqr": iqr_inliers,
    "none": no_removal,
}
