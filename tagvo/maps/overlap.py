"""Finds printed tags that overlap: two of them on one surface cannot both lie where a map says."""

from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array, IntArray

_AT_ONCE = 1_000_000  # pairs: 0.1 GB of intermediates
_ENOUGH = 20_000  # pairs that overlap: nobody reads on
_SAME_PLANE_DEG = 5.0  # tags whose faces differ by more do not lie on one surface
_SAME_PLANE_M = 0.005  # ... nor those this far apart along the face, beyond what laying explains


@dataclass(frozen=True, slots=True, eq=False)
class Squares:
    """Printed squares: ids (n,), p_WT (n, 3), R_WT (n, 3, 3), border and total sides (n,) [m]."""

    ids: IntArray
    p_WT: Array
    R_WT: Array
    border: Array
    total: Array
    sigma_xy: float
    sigma_z: float


def pairs_in_one_plane(s: Squares) -> tuple[IntArray, IntArray]:
    """Rows of the pairs near enough to touch that face the same way on one surface; (k,), (k,)."""
    radius = 0.5 * np.sqrt(2.0) * s.total
    axis = int(np.argmax(np.ptp(s.p_WT, axis=0)))
    order = np.argsort(s.p_WT[:, axis], kind="stable")
    x = s.p_WT[order, axis]
    last = np.searchsorted(x, x + radius[order] + radius.max(), side="right")
    count = last - np.arange(len(x)) - 1
    batch = np.cumsum(count) // _AT_ONCE  # so many pairs are looked at in one go
    found_i, found_j, found = [], [], 0
    for rows in np.split(np.arange(len(x)), np.flatnonzero(np.diff(batch)) + 1):
        first = np.repeat(rows, count[rows])
        offset = np.arange(len(first)) - np.repeat(
            np.cumsum(count[rows]) - count[rows], count[rows]
        )
        i, j = _in_one_plane(s, radius, order[first], order[first + offset + 1])
        found_i.append(i)
        found_j.append(j)
        found += len(i)
        if found > _ENOUGH:
            break
    return np.concatenate(found_i)[:_ENOUGH], np.concatenate(found_j)[:_ENOUGH]


def _in_one_plane(s: Squares, radius: Array, i: IntArray, j: IntArray) -> tuple[IntArray, IntArray]:
    """Those of the pairs i, j (k,) that are near and face the same way on one surface."""
    d = s.p_WT[j] - s.p_WT[i]
    near = np.einsum("ki,ki->k", d, d) < np.square(radius[i] + radius[j])
    i, j, d = i[near], j[near], d[near]
    n_i, n_j = s.R_WT[i, :, 2], s.R_WT[j, :, 2]
    parallel = np.einsum("ki,ki->k", n_i, n_j) > np.cos(np.radians(_SAME_PLANE_DEG))
    apart = np.minimum(np.abs(np.einsum("ki,ki->k", d, n_i)), np.abs(np.einsum("ki,ki->k", d, n_j)))
    flat = parallel & (apart < _SAME_PLANE_M + 3.0 * np.sqrt(2.0) * s.sigma_z)
    return i[flat], j[flat]


def penetration(s: Squares, i: IntArray, j: IntArray, side: Array) -> Array:
    """How far two squares of one plane must move apart to part [m], <= 0: they do; (k,).

    Exact (separating axes): convex polygons overlap only if they do along every edge's normal.
    """
    depth = np.full(len(i), np.inf)
    d = s.p_WT[j] - s.p_WT[i]
    for row, axis in ((i, 0), (i, 1), (j, 0), (j, 1)):
        normal = s.R_WT[row, :, axis]
        reach = sum(
            0.5 * side[r] * np.abs(np.einsum("ki,ki->k", s.R_WT[r, :, a], normal))
            for r, a in ((i, 0), (i, 1), (j, 0), (j, 1))
        )
        depth = np.minimum(depth, reach - np.abs(np.einsum("ki,ki->k", d, normal)))
    return depth
