"""When and where a pixel is sampled: the camera's way during a frame, and the pattern of samples.

Row r of h is exposed around t_s + (r / (h - 1) - 1/2) readout_s. Within a pixel and an exposure
the samples are a lattice in column, row and time: even along every axis, and symmetric, so that no
edge is moved by the pattern.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from math import factorial
from typing import NamedTuple, TypeAlias

import numpy as np

from tagvo.camera.model import Camera, project
from tagvo.geometry import Array

PoseAt: TypeAlias = Callable[[Array], tuple[Array, Array]]

_KNOT_S = 5e-4  # the pose is asked for at least this often
_KNOTS_PX = 0.01  # what straight lines between the poses that are kept may be off
_MOVING = 2  # times as many samples as of a still picture: as exact, whatever the blur
_STILL_PX, _STRAIGHT_PX = 0.02, 0.02
_ANGLES, _OFFSETS, _SPEEDS = 32, 24, (0.0, 1.0, 3.0, 9.0)  # edges [px an exposure]
_FAR = 1e3  # [m] along rays that miss the floor
_PER_PX = 2  # at least so many samples for each pixel of blur


class Seen(NamedTuple):
    """Rays x_n (k, 2) spread over the picture, and the depth of the nearest surface [m]."""

    camera: Camera
    x_n: Array
    nearest_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """The camera's way during a frame: R_WC (k, 3, 3), p_WC (k, 3) [m] at start_s + i step_s;
    k = 1: it stands still."""

    start_s: float
    step_s: float
    R_WC: Array
    p_WC: Array

    def knot(self, t_s: Array) -> Array:
        """Times in knots after the start."""
        return np.asarray((t_s - self.start_s) / self.step_s)

    def pose(self, t_s: Array) -> tuple[Array, Array]:
        """R_WC (..., 3, 3), p_WC (..., 3) at times (...), linear between the knots."""
        if len(self.p_WC) == 1:
            shape = np.shape(t_s)
            return np.broadcast_to(self.R_WC[0], (*shape, 3, 3)), np.broadcast_to(
                self.p_WC[0], (*shape, 3)
            )
        at = self.knot(t_s)
        j = np.clip(at.astype(int), 0, len(self.p_WC) - 2)
        f = np.asarray(at - j)[..., None]
        R = self.R_WC[j] + f[..., None] * (self.R_WC[j + 1] - self.R_WC[j])
        return R, self.p_WC[j] + f * (self.p_WC[j + 1] - self.p_WC[j])


def way(pose_at: PoseAt, first_s: float, last_s: float) -> Way:
    """The poses between two times, close enough to be linear in between."""
    span = last_s - first_s
    if span <= 0.0:
        times, step = np.array([first_s]), 1.0
    else:
        gaps = 2 ** max(int(np.ceil(np.log2(span / _KNOT_S))), 1)
        times, step = np.linspace(first_s, last_s, gaps + 1), span / gaps
    R, p = pose_at(times)
    return Way(first_s, step, np.asarray(R, float), np.asarray(p, float))


def thinned(flown: Way, seen: Seen) -> Way:
    """The way with as few knots as keep what is seen within 0.01 px of its place."""
    gaps = len(flown.p_WC) - 1
    if gaps < 2:
        return flown
    px, keep = _ways(seen, flown.R_WC, flown.p_WC), 1
    if px.size == 0:
        return flown
    while gaps // keep > 2 and _bend(px, gaps // (2 * keep)) < _KNOTS_PX:
        keep *= 2
    return Way(flown.start_s, keep * flown.step_s, flown.R_WC[::keep], flown.p_WC[::keep])


def row_times(t_s: float, readout_s: float, height: int, pad: int) -> Array:
    """Middle of each row's exposure, `pad` rows above and below too; (height + 2 pad,)."""
    rows = np.arange(-pad, height + pad)
    return np.asarray(t_s + (rows / max(height - 1, 1) - 0.5) * readout_s)


def motion(seen: Seen, flown: Way, t_s: float, exposure_s: float) -> tuple[float, int]:
    """How what is seen moves in the picture during the exposure around t_s.

    -> the longest way [px], and the number of points in time between which straight lines follow
    it to within 0.02 px.
    """
    if exposure_s == 0.0 or len(flown.p_WC) == 1:
        return 0.0, 1
    finest = 2 ** int(np.ceil(np.log2(max(exposure_s / _KNOT_S, 2.0))))
    px = _ways(seen, *flown.pose(t_s + exposure_s * np.linspace(-0.5, 0.5, finest + 1)))
    if px.size == 0:
        return float(max(seen.camera.resolution)), finest + 1
    blur = float(np.linalg.norm(np.diff(px, axis=0), axis=-1).sum(axis=0).max())
    if blur < _STILL_PX:
        return 0.0, 1
    gaps = 1
    while gaps < finest and _bend(px, gaps) > _STRAIGHT_PX:
        gaps *= 2
    return blur, gaps + 1


def wander_px(seen: Seen, flown: Way) -> float:
    """How far what is seen strays in the picture from the straight lines between its places at
    the start and the end of the frame [px]."""
    if len(flown.p_WC) <= 2:
        return 0.0
    px = _ways(seen, flown.R_WC, flown.p_WC)
    return _bend(px, 1) if px.size else float(max(seen.camera.resolution))


def _ways(seen: Seen, R_WC: Array, p_WC: Array) -> Array:
    """Pixels (n, k, 2) at poses (n, ...) of the points that the rays meet midway, on the floor or
    at the nearest surface's depth; of those alone that are in view all along."""
    middle, x_n = len(p_WC) // 2, seen.x_n
    ray_W = np.concatenate([x_n, np.ones((len(x_n), 1))], axis=-1) @ R_WC[middle].T
    height = p_WC[middle, 2]
    down = ray_W[:, 2] * height < 0.0
    depth = np.where(down, -height / np.where(down, ray_W[:, 2], 1.0), _FAR)
    X_W = p_WC[middle] + np.minimum(depth, seen.nearest_m)[:, None] * ray_W
    px, valid = project(seen.camera, (X_W - p_WC[:, None]) @ R_WC)
    return np.asarray(px[:, valid.all(axis=0)])


def _bend(px: Array, gaps: int) -> float:
    """How far a way px (n + 1, k, 2) leaves straight lines between gaps + 1 of its points [px]."""
    step = (len(px) - 1) // gaps
    f = (np.arange(len(px) - 1) % step / step)[:, None, None]
    start = np.repeat(px[:-1:step], step, axis=0)
    end = np.repeat(px[step::step], step, axis=0)
    return float(np.abs(px[:-1] - start - f * (end - start)).max())


def pattern(supersample: int, sub_exposures: int, blur: float) -> Array:
    """Samples (n, 3) of a pixel: column, row [px] and time [exposures], each in -1/2..1/2.

    sub_exposures > 0: that many instants, each with all supersample^2 places; 0: as many samples
    as the blur [px] needs, each at its own moment. They are in the order of their times.
    """
    still = supersample**2
    if blur == 0.0:
        return np.insert(lattice(still, 2), 2, 0.0, axis=1)
    if sub_exposures > 0:
        t = (np.arange(sub_exposures) + 0.5) / sub_exposures - 0.5
        places = lattice(still, 2)
        instants = np.repeat(t, still)[:, None]
        return np.concatenate([np.tile(places, (sub_exposures, 1)), instants], axis=1)
    many = max(_MOVING * still, 2 * int(np.ceil(0.5 * _PER_PX * min(blur, 512.0))))
    samples = lattice(many, 3)
    return np.asarray(samples[np.argsort(samples[:, 2], kind="stable")])


@lru_cache(maxsize=64)
def lattice(n: int, dims: int) -> Array:
    """The Korobov lattice (n, dims) in -1/2..1/2 that is best at edges; read-only.

    That is: the share of the points on one side of an edge is nearest to the volume there, in the
    mean over edges of all directions, standing and moving.
    """
    k = 2 * np.arange(n)[:, None] + 1
    directions = _directions(dims)
    width = np.abs(directions).sum(axis=1)
    at = width[:, None] * ((np.arange(_OFFSETS) + 0.5) / _OFFSETS - 0.5)
    volume = np.stack([_volume_below(w, d) for w, d in zip(np.abs(directions), at, strict=True)])
    best, least = np.zeros((n, dims)), np.inf
    for a in (a for a in range(1, max(n, 2)) if np.gcd(a, 2 * n) == 1):
        points = k * np.array([pow(a, d, 2 * n) for d in range(dims)]) % (2 * n) / (2.0 * n) - 0.5
        along = np.sort(points @ directions.T, axis=0)
        share = [np.searchsorted(x, d) for x, d in zip(along.T, at, strict=True)]
        error = float(np.mean((np.array(share) / n - volume) ** 2))
        if error < least:
            best, least = points, error
    best.setflags(write=False)
    return best


def _directions(dims: int) -> Array:
    """Normals (k, dims) of edges: of all directions in the picture, at several speeds."""
    angle = (np.arange(_ANGLES) + 0.5) * np.pi / _ANGLES
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    if dims == 2:
        return normal
    return np.concatenate([np.insert(normal, 2, speed, axis=1) for speed in _SPEEDS])


def _volume_below(width: Array, at: Array) -> Array:
    """Share of a box with these widths along a line that lies below `at`; (m,) -> (m,).

    The integral of a box spline: sum over the corners of sign (at + corner)_+^k / (k! widths).
    """
    width = width[width > 1e-9]
    total = np.zeros_like(at)
    for signs in product((-1.0, 1.0), repeat=len(width)):
        above = np.maximum(at + 0.5 * float(np.dot(signs, width)), 0.0)
        total += np.prod(signs) * above ** len(width)
    return np.asarray(total / (factorial(len(width)) * np.prod(width)))
