"""Decides frame by frame whether tags are tracked, searched for in a strip, or searched for whole.

Pure decisions over a small state.
"""

import math
from dataclasses import dataclass

import numpy as np

from tagvo.config import TrackConfig
from tagvo.geometry import Array
from tagvo.kernels.jit import bare
from tagvo.kernels.linalg import (
    cholesky,
    determinant,
    is_finite,
    largest_eigenvalue,
    symmetrize,
)
from tagvo.kernels.so3 import not_orthonormal, orthonormalize
from tagvo.records import PosePrior
from tagvo.track.tag_model import Gray

_SAME_MOMENT_NS = 1_000_000  # a prior is for this frame when its stamp is this near
_MAX_ROTATION_RAD = float(np.radians(6.0))  # beyond, the covariance is no ellipse in the image
_DECIMATES = (1.5, 2.0, 3.0, 4.0)
_SIDE_PX, _ENOUGH_TAGS = 12.0, 8
_MOSAIC = 0.04  # half the difference of a mosaic's two diagonals, over the mean
_UNIT = 1e-3  # how far a rotation may be from orthonormal
_LEAST_VARIANCE, _SINGULAR = 1e-24, 1e-12  # of a coordinate; of what its correlations leave of it


@dataclass(frozen=True, slots=True)
class GateState:
    """What the gate remembers: why the next frame is searched whole (or None), the last strip,
    whether the last frame was searched whole and how far what was found lets the next be decimated.
    """

    search_next: str | None = None
    strip: int = -1
    searched: bool = False
    decimate: float | None = None


@dataclass(frozen=True, slots=True)
class Strip:
    """Rows of the image that are searched beside the tracking: top to bottom, bottom excluded."""

    index: int
    top: int
    bottom: int


def admitted(prior: PosePrior | None, t_ns: int) -> tuple[PosePrior | None, str | None]:
    """The prior as kernels want it, or why it cannot be tracked by at a frame's stamp.

    Its covariance then is exactly symmetric, its rotation exact. Raises nothing.
    """
    if prior is None:
        return None, "no_prior"
    if prior.t_ns > t_ns + _SAME_MOMENT_NS:
        return None, "prior_from_the_future"
    if prior.t_ns < t_ns - _SAME_MOMENT_NS:
        return None, "prior_too_old"
    shapes = np.shape(prior.p_WC), np.shape(prior.R_WC), np.shape(prior.cov)
    if shapes != ((3,), (3, 3), (6, 6)):
        return None, _FAULTS[0]
    R_WC, p_WC, cov = np.empty((3, 3)), np.empty(3), np.empty((6, 6))
    R_WC[:], p_WC[:], cov[:] = prior.R_WC, prior.p_WC, prior.cov
    fault = _examine(R_WC, p_WC, cov, np.empty((6, 6)), np.empty((3, 3)))
    if fault >= 0:
        return None, _FAULTS[fault]
    return PosePrior(prior.t_ns, p_WC, R_WC, cov), None


_FAULTS = ("prior_not_finite", "prior_not_a_rotation", "prior_singular", "prior_too_wide")


@bare
def _examine(R: Array, p: Array, cov: Array, L: Array, E: Array) -> int:
    """Index of a fault, -1: none, and then R and cov are put right in place; L, E: scratch."""
    if not (is_finite(cov) and is_finite(R) and math.isfinite(p[0] + p[1] + p[2])):
        return 0
    if not_orthonormal(R, E) > _UNIT or determinant(R) < 0.0:
        return 1
    for _ in range(2):  # towards the nearest rotation; the error is squared each time
        not_orthonormal(R, E)
        orthonormalize(R, E)
    symmetrize(cov)
    for i in range(len(cov)):
        for j in range(i + 1):
            if not cov[i, i] > _LEAST_VARIANCE:
                return 2
            L[i, j] = cov[i, j] / math.sqrt(cov[i, i] * cov[j, j])
        L[i, i] = 1.0 - _SINGULAR
    if not cholesky(L):
        return 2
    return 3 if largest_eigenvalue(cov[3:, 3:]) > _MAX_ROTATION_RAD**2 else -1


def looks_mosaic(image: Gray) -> bool:
    """Whether a grey image (h, w) is a raw Bayer mosaic: its even diagonal lighter than its odd.

    Edges along rows or columns leave this alone; judged on some thirty pairs of rows.
    """
    return min(image.shape) >= 2 and bool(_diagonals_differ(image))


@bare
def _diagonals_differ(image: Gray) -> bool:
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    a = b = c = d = 0
    for y in range(0, height, max(2, image.shape[0] // 32 // 2 * 2)):
        for x in range(0, width, 2):
            a += image[y, x]
            b += image[y, x + 1]
            c += image[y + 1, x]
            d += image[y + 1, x + 1]
    return abs(a + d - b - c) > _MOSAIC * max(a + b + c + d, 1)


def strip_due(
    state: GateState, config: TrackConfig, t_ns: int, height: int, overlap: int
) -> Strip | None:
    """The strip to search at this stamp: each of them once a sweep, None where it is done."""
    if config.sweep_s <= 0.0:
        return None
    part = int(t_ns % round(config.sweep_s * 1e9) / (config.sweep_s * 1e9) * config.strips)
    if part == state.strip:
        return None
    rows = -(-height // config.strips)
    top = part * rows
    if top >= height:
        return None
    return Strip(part, max(top - overlap, 0), min(top + rows + overlap, height))


def tracking_failed(tracked: int, tried: int, config: TrackConfig) -> str | None:
    """Why what was tracked is not enough, None where it is."""
    if tried == 0:
        return "none_in_view"
    if tracked < config.min_tags:
        return "too_few"
    if tracked < config.min_share * tried:
        return "too_small_a_share"
    return None


def decimate_again(sides_px: Array, size: Array, largest_only: bool) -> float | None:
    """Like `decimate_needed`, by tags found in the image before; None: too few to learn from."""
    if len(sides_px) < _ENOUGH_TAGS:
        return None
    return decimate_needed(sides_px, size, largest_only)


def decimate_needed(sides_px: Array, size: Array, largest_only: bool) -> float | None:
    """The coarsest decimation that still finds the tags that a pose lives on; None: none in view.

    sides_px (k,): shortest image side of each tag in view, size (k,) [m]; largest_only: the
    selection keeps the two largest sizes in view and needs no others. Tags of eight
    pixels and more after decimation are found in sharp images; twelve leave room for blur and for
    those that the detector drops for inexact corners.
    """
    if not len(sides_px):
        return None
    if largest_only:
        classes = np.unique(np.round(size, 6))
        sides_px = sides_px[size >= classes[-min(2, len(classes))] - 1e-6]
    needed = np.sort(sides_px)[::-1][:_ENOUGH_TAGS][-1]
    return max((d for d in _DECIMATES if needed >= _SIDE_PX * d), default=_DECIMATES[0])
