"""What the rays of each pixel meet, row by row: the compiled heart of the renderer.

A pixel's light is the mean over samples, each with its own place in the pixel and its own moment
of the exposure. Where the pixel's whole path over a surface keeps to one colour, no sample need be
cast; elsewhere the nearest surface along each sample's ray wins.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tagvo.geometry import IntArray
from tagvo.kernels.jit import njit
from tagvo.render.cells_hit import (
    BARE,
    BLACK,
    CELLS,
    DX,
    DY,
    MANY,
    OFF,
    POINTS,
    SEEN,
    U0,
    U1,
    V0,
    V1,
    WHITE,
    Array32,
    Codes,
    Samples,
    Surfaces,
    cells_met,
    code_met,
    cut_met,
    cut_samples,
    depth_traced,
    pixels_ahead,
    poses_of,
    sampled,
    trace_row,
)  # fmt: skip

_FLOOR, _MIXED = -1, -2  # instead of a surface's number
_NEARER = np.float32(1.0 - 1e-6)
_WIDER = np.float32(0.55)  # half a pixel and a tenth
_ZERO, _ONE = np.float32(0), np.float32(1)
_NOTHING = np.float32(np.inf)
_NO_BITS, _SHIFT, _TOP = np.uint64(0), np.uint64(1), np.uint64(56)
_EACH_ONE = np.uint64(0x0101010101010101)  # BLACK in each of eight samples
_OTHER_BITS = np.uint64(0xFCFCFCFCFCFCFCFC)  # of the codes of objects


class _Row(NamedTuple):
    """A row of w pixels as it shows so far.

    who (w,): the surface that fills a pixel, _FLOOR or _MIXED; code, near, far (w,): its code, its
    depth, and a bound of that over the pixel and the exposure. Of mixed pixels: codes, depths
    (w, n) of the samples; words (w, ceil(n / 8)): the memory of the codes; lone (w,): the only
    surface mixed with the floor, its depths not noted yet, or _FLOOR.
    """

    who: IntArray
    code: Codes
    near: Array32
    far: Array32
    codes: Codes
    words: NDArray[np.uint64]
    depths: Array32
    lone: IntArray


class _Sampled(NamedTuple):
    """Of the n samples of a pixel: column, row, depth, ink; at, place: their cells, one buffer."""

    column: Array32
    row: Array32
    depth: Array32
    ink: Codes
    at: NDArray[np.int32]
    place: NDArray[np.uint32]


class _Work(NamedTuple):
    """Buffers: todo (w,): pixels to be sampled; trace (fields, w), spare (fields, 1); H, other
    (p, 10); what the samples of a pixel meet."""

    todo: IntArray
    trace: Array32
    spare: Array32
    H: Array32
    other: Array32
    met: _Sampled


class _Line(NamedTuple):
    """Row y of the rays (h, 6, w), and the middle of its exposure [knots]."""

    rays: Array32
    y: int
    at: float


@njit
def _scan(scene: Surfaces, i: int, pixels: _Row, work: _Work) -> int:
    """Bring surface i into the traced pixels of a row where it is one colour; list the others.

    -> the number of those listed in `todo`.
    """
    cells, first, n, kind = scene.cells, scene.first[i], scene.across[i], scene.kind[i]
    outline, trace, todo = scene.outline[i], work.trace, work.todo
    who, code, near, far = pixels.who, pixels.code, pixels.near, pixels.far
    points, listed = len(work.H), 0
    depth = trace[POINTS + 2 * points + points // 2]
    x, last = scene.box[i, 0], scene.box[i, 1]
    while x < last:
        met = OFF
        if trace[SEEN, x] > _ZERO:
            met = code_met(cells, first, n, trace[U0, x], trace[U1, x], trace[V0, x], trace[V1, x])
        if kind != CELLS and met != OFF:
            part = cut_met(kind, outline, n, trace, x)
            met = met if part == BARE else part
        if met == MANY:
            lowest = trace[SEEN, x] - _WIDER * (abs(trace[DX, x]) + abs(trace[DY, x]))
            if who[x] < 0 or lowest < far[x]:
                todo[listed] = x
                listed += 1
            x += 1
            continue
        end = x + 1
        if kind == CELLS or met == OFF:
            end = min(end + pixels_ahead(trace, x, n, met == OFF), last)
        while x < end:
            if met != OFF:
                if who[x] == _MIXED:
                    todo[listed] = x
                    listed += 1
                elif depth[x] < near[x] * _NEARER:
                    who[x], code[x], near[x] = i, met, depth[x]
                    wide = _WIDER * (abs(trace[DX, x]) + abs(trace[DY, x]))
                    far[x] = depth[x] + (depth[x] - trace[SEEN, x]) + wide
            x += 1
    return listed


@njit
def _mix(
    scene: Surfaces, i: int, line: _Line, listed: int, samples: Samples, pixels: _Row, work: _Work
) -> None:
    """Bring surface i into its listed pixels, sample by sample, the nearest surface first."""
    rays, y, at = line
    n, first, kind, cells = scene.across[i], scene.first[i], scene.kind[i], scene.cells
    trace, todo, outline = work.trace, work.todo, scene.outline[i]
    column, row, d, ink, cell, place = work.met
    who, lone, codes, depths = pixels.who, pixels.lone, pixels.codes, pixels.depths
    many, H, other, spare, filled = len(ink), scene.H, work.other, work.spare, pixels.code
    for m in range(listed):
        x = todo[m]
        cells_met(trace, x, samples, first, n, cell)
        for k in range(many):
            ink[k] = cells[place[k]]
        if kind != CELLS and cut_met(kind, outline, n, trace, x) != BARE:
            cut_samples(scene, i, trace, x, samples, column, row, ink)
        if who[x] == _FLOOR:
            for k in range(many):
                codes[x, k] = ink[k]
            who[x], lone[x] = _MIXED, i
            continue
        j = lone[x] if who[x] == _MIXED else who[x]
        if who[x] != _MIXED:
            for k in range(many):
                codes[x, k] = filled[x]
        if j != _FLOOR:  # it was alone, and its depths are not noted
            poses_of(H, j, samples.time, at, other)
            depth_traced(rays, y, x, other, spare)
            sampled(spare, 0, 2, samples, depths[x])
        sampled(trace, x, 2, samples, d)
        code, depth = codes[x], depths[x]
        for k in range(many):  # without branches: no processor could foresee them
            over = (code[k] == BARE) | (d[k] < depth[k] * _NEARER)
            takes = (ink[k] != BARE) & over
            code[k] = ink[k] if takes else code[k]
            depth[k] = d[k] if takes else depth[k]
        who[x], lone[x] = _MIXED, _FLOOR


@njit
def _mean_of(
    codes: Codes, words: NDArray[np.uint64], x: int, n: int, grey: Array32
) -> tuple[float, float]:
    """Grey of what the n samples of a pixel met, and their share of the bare floor."""
    black, white, others = _NO_BITS, _NO_BITS, _NO_BITS
    for k in range(words.shape[1]):  # eight samples at once; what is beyond n is BARE
        word = words[x, k]
        others |= word & _OTHER_BITS
        black += ((word & _EACH_ONE) * _EACH_ONE) >> _TOP
        white += (((word >> _SHIFT) & _EACH_ONE) * _EACH_ONE) >> _TOP
    bare = n - int(black) - int(white)
    total = np.float32(black) * grey[BLACK] + np.float32(white) * grey[WHITE]
    if others != _NO_BITS:
        bare, total = 0, _ZERO
        for k in range(n):
            bare += int(codes[x, k] == BARE)
            total += grey[codes[x, k]]
    return float(total / np.float32(n)), float(np.float32(bare) / np.float32(n))


@njit
def paint(
    rays: Array32, row_time: Array32, samples: Samples, scene: Surfaces, grey: Array32
) -> tuple[Array32, Array32]:
    """Grey of what is met, and share of the bare floor, of each pixel; (h, w) each.

    rays (h, 6, w): normalised coordinates of the pixel's centre and their derivatives xu xv yu yv
    by pixel; row_time (h,): middle of each row's exposure [knots]; grey (256,) of each code.
    """
    height, width = rays.shape[0], rays.shape[2]
    n, p = len(samples.x), len(samples.time)
    albedo, bare = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    words = np.zeros((width, (n + 7) // 8), np.uint64)
    pixels = _Row(
        np.empty(width, np.int64), np.empty(width, np.uint8), np.empty(width, np.float32),
        np.empty(width, np.float32), words.view(np.uint8), words,
        np.empty((width, n), np.float32), np.empty(width, np.int64),
    )  # fmt: skip
    at, fields = np.empty(n, np.int32), POINTS + 3 * p
    met = _Sampled(
        np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, np.float32),
        np.empty(n, np.uint8), at, at.view(np.uint32),
    )  # fmt: skip
    work = _Work(
        np.empty(width, np.int64), np.empty((fields, width), np.float32),
        np.empty((fields, 1), np.float32), np.empty((p, 10), np.float32),
        np.empty((p, 10), np.float32), met,
    )  # fmt: skip
    for y in range(height):
        pixels.who[:], pixels.lone[:] = _FLOOR, _FLOOR
        pixels.code[:], pixels.near[:] = BARE, _NOTHING
        for i in range(len(scene.box) - 1, -1, -1):  # objects first: they hide what is below
            if not scene.box[i, 2] <= y < scene.box[i, 3]:
                continue
            if poses_of(scene.H, i, samples.time, row_time[y], work.H):
                trace_row(rays, y, scene.box[i, 0], scene.box[i, 1], work.H, work.trace)
                listed = _scan(scene, i, pixels, work)
                _mix(scene, i, _Line(rays, y, row_time[y]), listed, samples, pixels, work)
        for x in range(width):
            if pixels.who[x] == _MIXED:
                albedo[y, x], bare[y, x] = _mean_of(pixels.codes, words, x, n, grey)
            else:
                code = pixels.code[x]
                albedo[y, x], bare[y, x] = grey[code], _ONE if code == BARE else _ZERO
    return albedo, bare
