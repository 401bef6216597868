"""A tag map flattened onto the plane that is printed: where each tag lies on it, and its number.

A number is written beside its tag where there is white enough: below it, else above, left, right,
along its edge, with a small triangle that points at the tag.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from tagvo.errors import MapError
from tagvo.geometry import Array, IntArray
from tagvo.maps.draw.views import View, frontal_view
from tagvo.maps.printing.outlines import tag_outlines
from tagvo.tags.tag_map import TagMap, tag_corners

_FLAT_COS, _FLAT_M = np.cos(np.radians(2.0)), 0.02  # what may be pressed flat
_HEIGHTS = ((0.003, 0.002, 0.0015), (0.0012, 0.0009))  # of numbers [m], the best first
_CLEAR = 0.3  # white between a number and a tag, in its height
_POINTER = 1.1  # where the digits begin beside the triangle, in their height
_LARGEST_SHARE = 0.15  # of a tag's side: no number is higher
_SIDES = (  # where a number stands: its own axes in the tag's (u, v), and on which side the tag is
    (np.array([[1, 0], [0, 1]]), 1),
    (np.array([[1, 0], [0, 1]]), -1),
    (np.array([[0, 1], [-1, 0]]), -1),
    (np.array([[0, 1], [-1, 0]]), 1),
)


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """n tags on the plane of print: at (n, 2) [m], turn (n,) [rad] of their x axes, total (n,) [m].

    view: how the plane lies in W; flattened: by how much tags were moved onto it at most [m].
    """

    tag_map: TagMap
    view: View
    at: Array
    turn: Array
    total: Array
    flattened: float

    def squares(self, rows: IntArray) -> Array:
        """Lower left and upper right of the upright squares around the prints; (k, 2, 2)."""
        half = (
            0.5 * self.total[rows] * (np.abs(np.cos(self.turn)) + np.abs(np.sin(self.turn)))[rows]
        )
        return np.stack([self.at[rows] - half[:, None], self.at[rows] + half[:, None]], axis=1)

    def outlines(self, row: int) -> list[Array]:
        """Outlines of a tag's black areas on the plane [m]; each (k, 2)."""
        m = self.tag_map
        loops = tag_outlines(m.family, int(m.tag_id[row]), m.border_bits)
        return [self.at[row] + self.total[row] * loop @ _turned(self.turn[row]).T for loop in loops]

    def frames(self, sides: Array) -> Array:
        """Corners of squares of these sides (n,) in the tags' places [m]; (n, 4, 2)."""
        R = np.moveaxis(_turned(self.turn), -1, 0)
        return np.asarray(self.at[:, None] + tag_corners(sides)[..., :2] @ np.swapaxes(R, 1, 2))


@dataclass(frozen=True, slots=True, eq=False)
class Number:
    """A tag's number on the plane: base line from (2,), angle [rad], height of its digits [m].

    pointer (3, 2): the triangle that points at the tag; low, high (2,): the box around all.
    """

    row: int
    words: str
    start: Array
    angle: float
    height: float
    pointer: Array
    low: Array
    high: Array


def _turned(angle: Array | float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def plane_of(tag_map: TagMap) -> Plane:
    """The map on its common plane; MapError names two tags that do not share one."""
    rows = np.arange(len(tag_map))
    n_W = tag_map.R_WT[:, :, 2]
    facing = n_W @ n_W[0]
    worst = int(facing.argmin())
    if facing[worst] < _FLAT_COS:
        degrees = np.degrees(np.arccos(np.clip(facing[worst], -1.0, 1.0)))
        raise _not_flat(tag_map, worst, f"face {degrees:.1f} deg apart")
    view = frontal_view(tag_map, rows)
    depth = tag_map.p_WT @ view.towards
    low, high = int(depth.argmin()), int(depth.argmax())
    if depth[high] - depth[low] > _FLAT_M:
        far = f"lie {1e3 * (depth[high] - depth[low]):.0f} mm apart across it"
        raise _not_flat(tag_map, high, far, low)
    x_axis = np.einsum("ij,nj->ni", view.page, tag_map.R_WT[:, :, 0])
    turn = np.arctan2(x_axis[:, 1], x_axis[:, 0])
    off = float(np.abs(depth - depth.mean()).max())
    return Plane(tag_map, view, view.project(tag_map.p_WT), turn, tag_map.total_size, off)


def _not_flat(tag_map: TagMap, row: int, how: str, other: int = 0) -> MapError:
    a, b = sorted((int(tag_map.tag_id[other]), int(tag_map.tag_id[row])))
    return MapError(
        f"{tag_map.source}: tags {a} and {b} do not share one plane, they {how}; print tags of one"
        " plane (--only-tags) or one tag a sheet (--each)"
    )


def numbers_beside(
    plane: Plane, width: Callable[[str, float], float]
) -> tuple[list[Number], list[int]]:
    """A number for each tag that has room for one, and the rows of those without.

    `width` tells how wide words of a height come out [m].
    """
    found: list[Number] = []
    without: list[int] = []
    boxes = np.full((len(plane.at), 2, 2), np.nan)  # of the numbers so far
    for row in range(len(plane.at)):
        number = _number(plane, row, boxes, width)
        if number is None:
            without.append(row)
        else:
            found.append(number)
            boxes[row] = number.low, number.high
    return found, without


def _number(
    plane: Plane, row: int, boxes: Array, width: Callable[[str, float], float]
) -> Number | None:
    total = float(plane.total[row])
    away = np.abs(plane.at - plane.at[row]).max(axis=1)
    near = np.flatnonzero(away < 0.75 * (plane.total + total) + 0.05)
    near = near[near != row]
    quarter = plane.turn[row] - 0.5 * np.pi * np.round(plane.turn[row] / (0.5 * np.pi))
    axes = _turned(float(quarter))  # columns u, v of the tag's square, u about to the right
    for heights in _HEIGHTS:
        fit = [h for h in heights if h <= _LARGEST_SHARE * total] or [heights[-1]]
        for (own, side), height in product(_SIDES, fit):
            number = _made(plane, row, axes @ own.T, height, side, width)
            if _free(plane, near, number, boxes):
                return number
    return None


def _made(
    plane: Plane,
    row: int,
    R: Array,
    height: float,
    side: int,
    width: Callable[[str, float], float],
) -> Number:
    """A tag's number along one side of it, in axes R (columns); side > 0: the tag is above it."""
    at, total, words = plane.at[row], float(plane.total[row]), str(plane.tag_map.tag_id[row])
    away = 0.5 * total + _CLEAR * height
    low = np.array([-0.5 * total, -away - height if side > 0 else away])
    tip, base = (0.8, 0.0) if side > 0 else (0.0, 0.8)
    pointer = low + height * np.array([[0.0, base], [0.4, tip], [0.8, base]])
    long = width(words, height) + _POINTER * height
    box = at + (low + np.array([[0, 0], [long, 0], [long, height], [0, height]])) @ R.T
    start = at + R @ (low + np.array([_POINTER * height, 0.0]))
    angle = float(np.arctan2(R[1, 0], R[0, 0]))
    points = at + pointer @ R.T
    return Number(row, words, start, angle, height, points, box.min(axis=0), box.max(axis=0))


def _free(plane: Plane, near: IntArray, number: Number, boxes: Array) -> bool:
    """Whether a number's box stays clear of the tags near it and of the numbers placed."""
    margin = 0.5 * _CLEAR * number.height
    before = (number.low < boxes[:, 1] + margin) & (boxes[:, 0] - margin < number.high)
    if before.all(axis=1).any():
        return False
    xs, ys = np.linspace(number.low, number.high, 9).T
    points = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    off = points - plane.at[near, None]
    inside = np.abs(np.einsum("kpi,ijk->kpj", off, _turned(plane.turn[near])))
    return not (inside.max(axis=2) < 0.5 * plane.total[near, None] + margin).any()
