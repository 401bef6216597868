"""Makes lines fit to draw: in the order of time, with gaps at pauses, thinned, never too many."""

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.tags.tag_map import TagMap

MAX_POINTS = 3000  # a line; the rest is thinned so that a long flight still opens on a phone
_BREAK_S = 1.0  # a longer pause is drawn as a gap


def tag_outlines(tag_map: TagMap) -> tuple[Array, list[str]]:
    """Squares of n tags as one line with gaps; -> points (6 n, 3) [m] and a name for each."""
    n = len(tag_map)
    corners = tag_map.corners_W[:, [0, 1, 2, 3, 0]]
    points = np.concatenate([corners, np.full((n, 1, 3), np.nan)], axis=1)
    rows = zip(tag_map.tag_id, tag_map.size, strict=True)
    names = [f"tag {tag_id}, {size * 100:.4g} cm" for tag_id, size in rows]
    return points.reshape(6 * n, 3), [name for name in names for _ in range(6)]


def thin(t_s: Array, y: Array, limit: int = MAX_POINTS) -> tuple[Array, Array]:
    """A line (n,) of at most `limit` points that keeps every peak: least and most of each run."""
    run = -(-2 * len(y) // limit)  # rounded up
    if run <= 2:
        return t_s, y
    whole = len(y) // run * run
    runs = y[:whole].reshape(-1, run)
    low = np.argmin(np.where(np.isnan(runs), np.inf, runs), axis=1)
    high = np.argmax(np.where(np.isnan(runs), -np.inf, runs), axis=1)
    gap = np.where(np.isnan(runs).any(axis=1), np.isnan(runs).argmax(axis=1), low)
    start = np.arange(len(runs)) * run
    keep = np.unique(np.concatenate([start + low, start + high, start + gap]))
    keep = np.concatenate([keep, np.arange(whole, len(y))])
    return t_s[keep], y[keep]


def band(t_s: Array, half: Array) -> tuple[Array, Array]:
    """Outlines of -half..half (n,), a closed polygon for each stretch without NaN."""
    t_s, half = thin(t_s, half, MAX_POINTS // 2)
    xs, ys = [np.empty(0)], [np.empty(0)]
    for rows in np.split(np.arange(len(half)), np.flatnonzero(np.isnan(half))):
        good = rows[np.isfinite(half[rows])]
        if len(good):
            xs += [t_s[good], t_s[good[::-1]], np.array([np.nan])]
            ys += [half[good], -half[good[::-1]], np.array([np.nan])]
    return np.concatenate(xs), np.concatenate(ys)


def in_time(t_ns: IntArray, y: Array, t_zero_ns: int) -> tuple[Array, Array]:
    """Times [s] and values in the order of time, a NaN put into every long pause."""
    order = np.argsort(t_ns, kind="stable")
    t_s, y = (t_ns[order] - t_zero_ns) * 1e-9, y[order]
    pause = np.flatnonzero(np.diff(t_s) > _BREAK_S) + 1
    return np.insert(t_s, pause, t_s[pause - 1]), np.insert(y, pause, np.nan, axis=0)


def path_in_time(t_ns: IntArray, p: Array) -> Array:
    """A path (n, 3) in the order of time, thinned, with gaps at long pauses."""
    path = in_time(t_ns, p, 0)[1]
    step = max(1, -(-len(path) // MAX_POINTS))
    keep = np.isnan(path).any(axis=-1) | (np.arange(len(path)) % step == 0)
    keep[-1:] = True
    return np.asarray(path[keep])
