"""Reads the bits of squares in an image: which tag, which way up, how many bits were wrong."""

from dataclasses import dataclass
from math import comb

import numpy as np

from tagvo.detect.edge_profile import Gray, Single, sample
from tagvo.geometry import Array, BoolArray, IntArray

_MIN_CONTRAST = 12.0  # grey values between black and white cells; below, noise writes the bits
_BORDER_ERRORS = 0.1  # share of the border's cells that may be bright
_CHANCE = 1e-3  # odds at which a square of random bits may pass for a tag


@dataclass(frozen=True, slots=True, eq=False)
class Codes:
    """A family's bits: n ids, s cells a side; table (4 n, s * s) of +-1, row 4 id + turns."""

    ids: int
    side: int
    table: Single

    def max_errors(self, wanted: int) -> int:
        """Bit errors to correct: `wanted`, fewer where chance would often make a tag of nothing."""
        bits, passing, errors = self.side**2, 4.0 * self.ids, 0
        while errors < wanted:
            passing += 4.0 * self.ids * comb(bits, errors + 1)
            if passing / 2.0**bits > _CHANCE:
                break
            errors += 1
        return errors

    @property
    def by_chance(self) -> float:
        """Odds that a square of random bits is one of the family's tags without an error."""
        return float(4.0 * self.ids / 2.0**self.side**2)


def codes(bits: np.ndarray[tuple[int, ...], np.dtype[np.uint8]]) -> Codes:
    """The table of a family from its bits upright (n, s, s), white 1."""
    n, side, _ = bits.shape
    turned = np.stack([np.rot90(bits, k, axes=(1, 2)) for k in range(4)], axis=1)
    return Codes(n, side, turned.reshape(n * 4, side * side).astype(np.float32) * 2.0 - 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What stands in m squares; each field (m,).

    turns: quarter turns that `upright` undoes; errors: wrong bits; margin: as in Detections;
    ok: border and contrast are those of a tag.
    """

    tag_id: IntArray
    turns: IntArray
    errors: IntArray
    margin: Array
    ok: BoolArray


def read_bits(image: Gray, corners_px: Array, family: Codes, border_bits: int) -> Reading:
    """The nearest tag of the family in each square; corners (m, 4, 2) of the black border.

    margin: mean distance of the worse colour's cells from the threshold, as the AprilTag library.
    """
    cells = family.side + 2 * border_bits
    grid = (np.arange(cells) + 0.5) / cells
    points = _from_unit_square(corners_px, grid)
    grey = sample(image, points[..., 0], points[..., 1]).astype(float)  # (m, cells, cells)
    inside = np.zeros((cells, cells), dtype=bool)
    inside[border_bits:-border_bits, border_bits:-border_bits] = True
    frame, data = grey[:, ~inside], grey[:, inside]
    black = np.median(frame, axis=1)
    white = np.partition(data, -2, axis=1)[:, -2]
    level = 0.5 * (black + white)[:, None]
    signal = data - level
    bright = signal > 0.0
    score = np.where(bright, 1.0, -1.0).astype(np.float32) @ family.table.T
    best = score.argmax(axis=1)
    errors = np.rint(0.5 * (family.side**2 - score[np.arange(len(score)), best])).astype(np.int64)
    up = (signal * bright).sum(axis=1) / np.maximum(bright.sum(axis=1), 1)
    down = (-signal * ~bright).sum(axis=1) / np.maximum((~bright).sum(axis=1), 1)
    ok = (white - black > _MIN_CONTRAST) & ((frame > level).mean(axis=1) <= _BORDER_ERRORS)
    return Reading(best // 4, best % 4, errors, np.minimum(up, down), ok)


def upright(corners_px: Array, turns: IntArray) -> Array:
    """Corners (m, 4, 2) renumbered to TL, TR, BR, BL of the tag; turns (m,) of its `Reading`."""
    order = (np.arange(4) - turns[:, None]) % 4
    return np.asarray(np.take_along_axis(corners_px, order[..., None], axis=1))


def _from_unit_square(corners_px: Array, grid: Array) -> Single:
    """Pixels (m, g, g, 2) of the lattice grid x grid of the square [0, 1]^2, by homography.

    The closed form of the homography of four corners TL, TR, BR, BL (Heckbert).
    """
    p0, p1, p2, p3 = (corners_px[:, k] for k in range(4))
    s, d1, d2 = p0 - p1 + p2 - p3, p1 - p2, p3 - p2
    det = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    det = np.where(np.abs(det) < 1e-9, 1e-9, det)
    g = ((s[:, 0] * d2[:, 1] - s[:, 1] * d2[:, 0]) / det)[:, None]
    h = ((d1[:, 0] * s[:, 1] - d1[:, 1] * s[:, 0]) / det)[:, None]
    along_x, along_y = p1 - p0 + g * p1, p3 - p0 + h * p3
    u, v = grid[None, :, None], grid[:, None, None]
    top = along_x[:, None, None] * u + along_y[:, None, None] * v + p0[:, None, None]
    depth = g[:, None, None] * u + h[:, None, None] * v + 1.0
    return np.asarray(top / np.where(np.abs(depth) < 1e-6, 1e-6, depth), dtype=np.float32)
