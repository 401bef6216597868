"""Floors made by procedure: wood, tiles, concrete; periodic, and filtered for every distance.

A texture is a pyramid of square images of the plane z = 0 of W, which it fills by repetition;
a value of 128 stands for the floor's own grey, 0 for black, 255 for twice the grey.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import njit
from tagvo.render.cells_hit import Array32, Codes
from tagvo.render.config import TextureConfig

PERIOD_M = 2.048
_SIDE = 2048  # texels of the finest level: 1 mm each
_LEVELS = 11
_PLANK_M, _TILE_M = (_SIDE // 4, _SIDE // 16), _SIDE // 8  # texels: 0.51 x 0.13 m, 0.26 m
_JOINT, _GROUT = 2, 5  # texels


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """levels: images one after the other, each of half the side of the one before; (k,)."""

    levels: Codes


def make_texture(config: TextureConfig, rng: np.random.Generator) -> Texture | None:
    """The floor's pattern; None where it has none."""
    if config.kind == "plain" or config.strength_share == 0.0:
        return None
    pattern = _KINDS[config.kind](rng)
    pattern = np.clip(pattern - pattern.mean(), -1.0, 1.0) * config.strength_share
    level = 128.0 * (1.0 + pattern)
    levels = [level]
    for _ in range(_LEVELS):
        level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
        levels.append(level)
    flat = np.concatenate([np.rint(each).ravel() for each in levels])
    return Texture(np.clip(flat, 0, 255).astype(np.uint8))


def _noise(rng: np.random.Generator, power: float, stretch: float = 1.0) -> Array:
    """Periodic noise of unit variance with spectrum f^-power, `stretch` times as long along x."""
    white = rng.standard_normal((_SIDE, _SIDE), dtype=np.float32)
    fx, fy = np.fft.rfftfreq(_SIDE) * _SIDE * stretch, np.fft.fftfreq(_SIDE) * _SIDE
    f = np.hypot(fx, fy[:, None])
    f[0, 0] = np.inf
    noise = np.fft.irfft2(np.fft.rfft2(white) * f**-power, s=(_SIDE, _SIDE))
    return np.asarray(noise / noise.std())


def _concrete(rng: np.random.Generator) -> Array:
    """Blotches of all sizes, sandy grain, light stones and dark pores."""
    blotches, sand = _noise(rng, 1.25), _noise(rng, 0.25)
    coarse = _noise(rng, 0.7)
    return np.asarray(
        0.2 * blotches + 0.13 * sand + 0.1 * coarse + 0.5 * (coarse > 2.6) - 0.8 * (coarse < -3.0)
    )


def _wood(rng: np.random.Generator) -> Array:
    """Staggered planks along x, each of its own tone and grain."""
    length, width = _PLANK_M
    y, x = np.mgrid[:_SIDE, :_SIDE]
    row = y // width
    x = x + (row % 2) * (length // 2) + 37 * (row % 4)
    plank = (x // length) % (_SIDE // length) + (_SIDE // length) * row
    many = int(plank.max()) + 1
    tone, shift = rng.uniform(-0.35, 0.35, many), rng.integers(0, _SIDE, many)
    warp, grain = _noise(rng, 1.5, 12.0), _noise(rng, 0.7, 25.0)
    moved = (y + shift[plank]) % _SIDE, x % _SIDE
    rings = np.sin(2.0 * np.pi * (moved[0] / 46.0 + 0.9 * warp[moved]))
    pattern = tone[plank] + 0.2 * rings + 0.16 * grain[moved]
    joint = (y % width < _JOINT) | (x % length < _JOINT)
    return np.where(joint, -1.0, pattern)


def _tiles(rng: np.random.Generator) -> Array:
    """Square tiles of slightly different tones, speckled, with veins; light grout between them."""
    y, x = np.mgrid[:_SIDE, :_SIDE]
    tile = x // _TILE_M + (_SIDE // _TILE_M) * (y // _TILE_M)
    tone, shift = rng.normal(0.0, 0.15, tile.max() + 1), rng.integers(0, _SIDE, tile.max() + 1)
    moved = (y + shift[tile]) % _SIDE, (x + 3 * shift[tile]) % _SIDE
    veins = np.exp(-np.abs(_noise(rng, 1.5)) / 0.06)[moved]
    pattern = tone[tile] + 0.12 * _noise(rng, 1.2)[moved] - 0.4 * veins + 0.1 * _noise(rng, 0.2)
    grout = (y % _TILE_M < _GROUT) | (x % _TILE_M < _GROUT)
    return np.where(grout, 0.75 + 0.1 * _noise(rng, 0.3), pattern)


_KINDS: dict[str, Callable[[np.random.Generator], Array]] = {
    "concrete": _concrete,
    "wood": _wood,
    "tiles": _tiles,
}


@njit
def _texel(levels: Codes, side: int, first: int, x: float, y: float) -> float:
    """Bilinear value of one level at x, y [texels of that level], repeated."""
    left, upper = np.floor(x - 0.5), np.floor(y - 0.5)
    x0, y0 = int(left) & (side - 1), int(upper) & (side - 1)
    x1, y1 = (x0 + 1) & (side - 1), (y0 + 1) & (side - 1)
    fx, fy = x - 0.5 - left, y - 0.5 - upper
    top = levels[first + y0 * side + x0] * (1 - fx) + levels[first + y0 * side + x1] * fx
    low = levels[first + y1 * side + x0] * (1 - fx) + levels[first + y1 * side + x1] * fx
    return float(top * (1 - fy) + low * fy)


@njit
def _value(levels: Codes, x_m: float, y_m: float, width_m: float) -> float:
    """Value at a place of the floor [m] seen through a pixel of that width on it."""
    x, y = x_m * (_SIDE / PERIOD_M), y_m * (_SIDE / PERIOD_M)
    lod = np.log2(max(width_m * (_SIDE / PERIOD_M), 1.0))
    level = min(int(lod), _LEVELS - 1)
    side, first = _SIDE, 0
    for _ in range(level):
        first += side * side
        side //= 2
    scale = side / _SIDE
    fine = _texel(levels, side, first, x * scale, y * scale)
    coarse = _texel(levels, side // 2, first + side * side, 0.5 * x * scale, 0.5 * y * scale)
    f = min(lod - level, 1.0)
    return float(fine + f * (coarse - fine))


@njit
def floor_factor(rays: Array32, bare: Array32, poses: Array32, levels: Codes, out: Array32) -> None:
    """Mean of the texture over the exposure where the floor shows, as a factor, into out (h, w).

    rays (h, 6, w) as in `tagvo.paint`; bare (h, w) share of the floor; poses (h, k, 12): R_WC and
    p_WC at the k moments of each row.
    """
    for y in range(rays.shape[0]):
        for x in range(rays.shape[2]):
            if bare[y, x] == 0.0:
                continue
            a, b = rays[y, 0, x], rays[y, 1, x]
            wide = np.sqrt(abs(rays[y, 2, x] * rays[y, 5, x] - rays[y, 3, x] * rays[y, 4, x]))
            total = 0.0
            for k in range(poses.shape[1]):
                P = poses[y, k]
                down = P[6] * a + P[7] * b + P[8]
                if down * P[11] >= -1e-6:
                    total += 128.0
                    continue
                depth = -P[11] / down
                aslant = np.sqrt(a * a + b * b + 1.0) / abs(down)  # the pixel's length over width
                x_m = P[9] + depth * (P[0] * a + P[1] * b + P[2])
                y_m = P[10] + depth * (P[3] * a + P[4] * b + P[5])
                total += _value(levels, x_m, y_m, depth * wide * aslant)
            out[y, x] = total / (128.0 * poses.shape[1])
