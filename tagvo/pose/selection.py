"""THS, the paper's tags hierarchical selection: which tags take part; one function a method.

Each function takes the body poses of one frame and answers with a mask (n,).
"""

from collections.abc import Callable

import numpy as np

from tagvo.geometry import Array, BoolArray
from tagvo.records import ImuPoses

_SAME_CLASS = 1e-3  # sizes that differ by less than this share are one class


def _of_class(size: Array, which: float) -> BoolArray:
    return np.asarray(np.abs(size - which) <= _SAME_CLASS * which)


def just_biggest(poses: ImuPoses) -> BoolArray:
    """JBT: one tag of the biggest visible class, the largest in the image, then the lowest id."""
    mask = np.zeros(len(poses), dtype=bool)
    if len(poses):
        rows = np.flatnonzero(_of_class(poses.size, poses.size.max()))
        best = np.lexsort((poses.tag_id[rows], -poses.area_px[rows]))[0]
        mask[rows[best]] = True
    return mask


def two_biggest(poses: ImuPoses) -> BoolArray:
    """TBS: all tags of the two biggest visible classes (of the one, where only one is seen)."""
    if not len(poses):
        return np.zeros(0, dtype=bool)
    mask = _of_class(poses.size, poses.size.max())
    rest = poses.size[~mask]
    return mask if not len(rest) else mask | _of_class(poses.size, rest.max())


def keep_all(poses: ImuPoses) -> BoolArray:
    """ALL: every detected tag."""
    return np.ones(len(poses), dtype=bool)


SELECT: dict[str, Callable[[ImuPoses], BoolArray]] = {
    "JBT": just_biggest,
    "TBS": two_biggest,
    "ALL": keep_all,
}
