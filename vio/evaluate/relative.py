"""Relative pose errors: how far an estimate drifts over a time or a way, whatever it started at."""

from itertools import pairwise

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray


def relative_errors(
    p_WI: Array, R_WI: Array, p_WI_true: Array, R_WI_true: Array, pairs: IntArray
) -> tuple[Array, Array]:
    """Translation [m] and rotation [rad] error of the motion over each pair of rows; (k,), (k,).

    p_WI, p_WI_true (n, 3) [m]; R_WI, R_WI_true (n, 3, 3); pairs (k, 2) rows. As evo's RPE: the
    motion of the estimate seen from where the true motion leads.
    """
    i, j = pairs[:, 0], pairs[:, 1]
    moved, true = _motion(p_WI, R_WI, i, j), _motion(p_WI_true, R_WI_true, i, j)
    turn = np.swapaxes(true[0], -1, -2)
    gap = np.einsum("kij,kj->ki", turn, moved[1] - true[1])
    return np.linalg.norm(gap, axis=-1), geo.angle(turn @ moved[0])


def _motion(p_WI: Array, R_WI: Array, i: IntArray, j: IntArray) -> tuple[Array, Array]:
    """I at row j in I at row i: R (k, 3, 3), p (k, 3) [m]."""
    R_IW = np.swapaxes(R_WI[i], -1, -2)
    return R_IW @ R_WI[j], np.einsum("kij,kj->ki", R_IW, p_WI[j] - p_WI[i])


def pairs_in_time(t_ns: IntArray, seconds: float, slack: float = 0.1) -> IntArray:
    """Each row with the first that is `seconds` later, within a share of it; (k, 2)."""
    span = round(seconds * 1e9)
    later = np.searchsorted(t_ns, t_ns + span)
    rows = np.flatnonzero(later < len(t_ns))
    late = t_ns[later[rows]] - t_ns[rows] - span
    rows = rows[late <= slack * span]
    return np.stack([rows, later[rows]], axis=-1)


def pairs_along_way(p_WI: Array, metres: float) -> IntArray:
    """Rows (k, 2) of p_WI (n, 3) [m], each the first `metres` of way beyond the one before."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(p_WI, axis=0), axis=-1)))
    rows, last = [0], 0.0
    while (row := int(np.searchsorted(way, last + metres))) < len(way):
        row = max(row, rows[-1] + 1)  # after 1e29 m a metre more is the same number
        if row == len(way):
            break
        rows.append(row)
        last = float(way[row])
    return np.array(list(pairwise(rows)), dtype=np.int64).reshape(-1, 2)
