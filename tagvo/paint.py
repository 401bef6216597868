"""What the rays of each pixel meet, row by row: the compiled heart of the renderer.

A pixel's light is the mean over samples, each with its own place in the pixel and its own moment
of the exposure. Where the pixel's whole path over a surface keeps to one colour, no sample need be
cast; elsewhere the nearest surface along each sample's ray wins.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tagvo.compiled import njit
from tagvo.geometry import IntArray
from tagvo.trace import (
    BARE,
    BLACK,
    CELLS,
    MANY,
    OFF,
    POINTS,
    U0,
    U1,
    V0,
    V1,
    WHITE,
    Array32,
    Codes,
    Samples,
    Surfaces,
    code_met,
    cut_met,
    inks,
    pixels_ahead,
    poses_of,
    sampled,
    trace_pixel,
)  # fmt: skip

_FLOOR, _MIXED = -1, -2  # instead of a surface's number
_NEARER = np.float32(1.0 - 1e-6)
_ZERO, _ONE = np.float32(0), np.float32(1)
_NOTHING = np.float32(np.inf)


class _Row(NamedTuple):
    """A row of w pixels as it shows so far.

    who (w,): the surface that fills a pixel, _FLOOR or _MIXED; code, near (w,): its code and
    depth; codes, depths (w, n): of a mixed pixel's samples; lone (w,): the only surface that is
    mixed with the floor, its depths not noted yet, or _FLOOR.
    """

    who: IntArray
    code: Codes
    near: Array32
    codes: Codes
    depths: Array32
    lone: IntArray


class _Work(NamedTuple):
    """Buffers: todo (w,) pixels to be sampled and their traces (w + 2, ...), the last one spare;
    H, other (p, 10); column, row, depth, ink (n,) of samples; at, place (n,): one buffer."""

    todo: IntArray
    trace: Array32
    H: Array32
    other: Array32
    column: Array32
    row: Array32
    depth: Array32
    ink: Codes
    at: NDArray[np.int32]
    place: NDArray[np.uint32]


@njit
def _scan(scene: Surfaces, i: int, rays: Array32, y: int, pixels: _Row, work: _Work) -> int:
    """Bring surface i into the pixels of row y where it is one colour; list and trace the others.

    -> the number of those listed in `todo`.
    """
    cells, first, n, kind = scene.cells, scene.first[i], scene.across[i], scene.kind[i]
    outline, trace, todo, H = scene.outline[i], work.trace, work.todo, work.H
    who, code, near = pixels.who, pixels.code, pixels.near
    middle, m = H.shape[0] // 2, 0
    h6, h7, h8, h9 = H[middle, 6], H[middle, 7], H[middle, 8], H[middle, 9]
    x, last = scene.box[i, 0], scene.box[i, 1]
    while x < last:
        if not trace_pixel(rays, y, x, H, trace, m):
            x += 1
            continue
        met = code_met(cells, first, n, trace[m, U0], trace[m, U1], trace[m, V0], trace[m, V1])
        if kind != CELLS and met != OFF:
            part = cut_met(kind, outline, n, trace, m)
            met = met if part == BARE else part
        if met == MANY:
            todo[m] = x
            m += 1
            x += 1
            continue
        end = x + 1
        if kind == CELLS or met == OFF:
            end = min(end + pixels_ahead(trace, m, n, met == OFF), last)
        if met == OFF:
            x = end
            continue
        while x < end:
            d = h9 / (h6 * rays[y, x, 0] + h7 * rays[y, x, 1] + h8)
            if who[x] == _MIXED:
                if trace_pixel(rays, y, x, H, trace, m):
                    todo[m] = x
                    m += 1
            elif d < near[x] * _NEARER:
                who[x], code[x], near[x] = i, met, d
            x += 1
    return m


@njit
def _note_depths(
    scene: Surfaces,
    j: int,
    rays: Array32,
    y: int,
    x: int,
    at: float,
    samples: Samples,
    pixels: _Row,
    work: _Work,
) -> None:
    """Depths of surface j, the only one in a pixel so far, at its samples."""
    trace, codes, depths = work.trace, pixels.codes, pixels.depths
    spare = len(trace) - 1
    poses_of(scene.H, j, samples.time, at, work.other)
    trace_pixel(rays, y, x, work.other, trace, spare)
    sampled(trace, spare, 2, len(samples.time), samples, depths[x])
    for k in range(codes.shape[1]):
        if codes[x, k] == BARE:
            depths[x, k] = _NOTHING


@njit
def _mix(
    scene: Surfaces,
    i: int,
    rays: Array32,
    y: int,
    at: float,
    listed: int,
    samples: Samples,
    pixels: _Row,
    work: _Work,
) -> None:
    """Bring surface i into its listed pixels, sample by sample, the nearest surface first."""
    n, points, cells_only = scene.across[i], len(samples.time), scene.kind[i] == CELLS
    trace, todo, u, v, d, ink = (
        work.trace, work.todo, work.column, work.row, work.depth, work.ink
    )  # fmt: skip
    who, code, lone, codes, depths = (
        pixels.who, pixels.code, pixels.lone, pixels.codes, pixels.depths
    )  # fmt: skip
    for m in range(listed):
        x = todo[m]
        sampled(trace, m, 0, points, samples, u)
        sampled(trace, m, 1, points, samples, v)
        inside = trace[m, U0] >= _ZERO and trace[m, U1] < n
        inside = inside and trace[m, V0] >= _ZERO and trace[m, V1] < n
        if who[x] == _FLOOR and inside and cells_only:
            inks(scene, i, u, v, work.at, work.place, codes[x])
            who[x], lone[x] = _MIXED, i
            continue
        inks(scene, i, u, v, work.at, work.place, ink)
        sampled(trace, m, 2, points, samples, d)
        if who[x] == _FLOOR:
            for k in range(len(ink)):
                codes[x, k] = ink[k]
                depths[x, k] = _NOTHING if ink[k] == BARE else d[k]
        else:
            j = lone[x] if who[x] == _MIXED else who[x]
            if who[x] != _MIXED:
                codes[x, :] = code[x]
            if j != _FLOOR:
                _note_depths(scene, j, rays, y, x, at, samples, pixels, work)
            for k in range(len(ink)):
                if ink[k] != BARE and d[k] < depths[x, k] * _NEARER:
                    codes[x, k], depths[x, k] = ink[k], d[k]
        who[x], lone[x] = _MIXED, _FLOOR


@njit
def _mean_of(codes: Codes, x: int, grey: Array32) -> tuple[float, float]:
    """Grey of what the samples of a pixel met, and their share of the bare floor."""
    black = white = bare = 0
    n = codes.shape[1]
    for k in range(n):
        black += codes[x, k] == BLACK
        white += codes[x, k] == WHITE
        bare += codes[x, k] == BARE
    total = np.float32(black) * grey[BLACK] + np.float32(white) * grey[WHITE]
    if black + white + bare < n:
        for k in range(n):
            if codes[x, k] > WHITE:
                total += grey[codes[x, k]]
    return float(total / np.float32(n)), float(np.float32(bare) / np.float32(n))


@njit
def paint(
    rays: Array32, row_time: Array32, samples: Samples, scene: Surfaces, grey: Array32
) -> tuple[Array32, Array32]:
    """Grey of what is met, and share of the bare floor, of each pixel; (h, w) each.

    rays (h, w, 6): normalised coordinates of the pixel's centre and their derivatives xu xv yu yv
    by pixel; row_time (h,): middle of each row's exposure [knots]; grey (256,) of each code.
    """
    height, width = rays.shape[0], rays.shape[1]
    n, p = len(samples.x), len(samples.time)
    albedo, bare = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    pixels = _Row(
        np.empty(width, np.int64), np.empty(width, np.uint8), np.empty(width, np.float32),
        np.empty((width, n), np.uint8), np.empty((width, n), np.float32), np.empty(width, np.int64),
    )  # fmt: skip
    at = np.empty(n, np.int32)
    work = _Work(
        np.empty(width, np.int64), np.empty((width + 2, POINTS + 3 * p), np.float32),
        np.empty((p, 10), np.float32), np.empty((p, 10), np.float32), np.empty(n, np.float32),
        np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.uint8), at,
        at.view(np.uint32),
    )  # fmt: skip
    for y in range(height):
        pixels.who[:], pixels.lone[:] = _FLOOR, _FLOOR
        pixels.code[:], pixels.near[:] = BARE, _NOTHING
        for i in range(len(scene.box)):
            if scene.box[i, 2] <= y < scene.box[i, 3]:
                poses_of(scene.H, i, samples.time, row_time[y], work.H)
                listed = _scan(scene, i, rays, y, pixels, work)
                _mix(scene, i, rays, y, row_time[y], listed, samples, pixels, work)
        for x in range(width):
            if pixels.who[x] == _MIXED:
                albedo[y, x], bare[y, x] = _mean_of(pixels.codes, x, grey)
            else:
                code = pixels.code[x]
                albedo[y, x], bare[y, x] = grey[code], _ONE if code == BARE else _ZERO
    return albedo, bare
