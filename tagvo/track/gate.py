"""Decides frame by frame whether tags are tracked, searched for in a strip, or searched for whole.

Pure decisions over a small state.
"""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.records import PosePrior
from tagvo.track.cells import Gray
from tagvo.track.settings import TrackConfig

_SAME_MOMENT_NS = 1_000_000  # a prior is for this frame when its stamp is this near
_MAX_ROTATION_RAD = float(np.radians(6.0))  # beyond, the covariance is no ellipse in the image
_DECIMATES = (1.5, 2.0, 3.0, 4.0)
_SIDE_PX, _ENOUGH_TAGS = 10.0, 8
_MOSAIC = 0.04  # half the difference of a mosaic's two diagonals, over the mean
_UNIT = 1e-3  # how far a rotation may be from orthonormal


@dataclass(frozen=True, slots=True)
class GateState:
    """What the gate remembers: why the next frame is searched whole (or None), the last strip."""

    search_next: str | None = None
    strip: int = -1


@dataclass(frozen=True, slots=True)
class Strip:
    """Rows of the image that are searched beside the tracking: top to bottom, bottom excluded."""

    index: int
    top: int
    bottom: int


def prior_fault(prior: PosePrior | None, t_ns: int) -> str | None:
    """Why a prior cannot be tracked by at a frame's stamp, None where it can."""
    if prior is None:
        return "no_prior"
    if prior.t_ns > t_ns + _SAME_MOMENT_NS:
        return "prior_from_the_future"
    if prior.t_ns < t_ns - _SAME_MOMENT_NS:
        return "prior_too_old"
    shapes = np.shape(prior.p_WC), np.shape(prior.R_WC), np.shape(prior.cov)
    if shapes != ((3,), (3, 3), (6, 6)):
        return "prior_not_finite"
    if not all(np.isfinite(a).all() for a in (prior.p_WC, prior.R_WC, prior.cov)):
        return "prior_not_finite"
    off = np.abs(prior.R_WC.T @ prior.R_WC - np.eye(3)).max()
    if off > _UNIT or np.linalg.det(prior.R_WC) < 0.0:
        return "prior_not_a_rotation"
    eigenvalues = np.linalg.eigvalsh(0.5 * (prior.cov + prior.cov.T))
    if eigenvalues[0] <= 1e-12 * max(eigenvalues[-1], 1e-12):
        return "prior_singular"
    if np.linalg.eigvalsh(prior.cov[3:, 3:])[-1] > _MAX_ROTATION_RAD**2:
        return "prior_too_wide"
    return None


def looks_mosaic(image: Gray) -> bool:
    """Whether a grey image (h, w) is a raw Bayer mosaic: its even diagonal lighter than its odd.

    Edges along rows or columns leave this alone; judged on some thirty pairs of rows.
    """
    step = max(2, image.shape[0] // 32 // 2 * 2)
    height, width = image.shape[0] // 2 * 2, image.shape[1] // 2 * 2
    if height < 2 or width < 2:
        return False
    upper = image[0:height:step, :width].mean(axis=0).reshape(-1, 2).mean(axis=0)
    lower = image[1:height:step, :width].mean(axis=0).reshape(-1, 2).mean(axis=0)
    difference = 0.25 * abs(float(upper[0] + lower[1] - upper[1] - lower[0]))
    mean = 0.25 * float(upper.sum() + lower.sum())
    return difference > _MOSAIC * max(mean, 1.0)


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


def symmetric(prior: PosePrior) -> PosePrior:
    """The prior with an exactly symmetric covariance and an exact rotation, as kernels want it."""
    cov = 0.5 * (prior.cov + prior.cov.T)
    return PosePrior(prior.t_ns, prior.p_WC, geo.project_to_so3(prior.R_WC), cov)


def decimate_needed(sides_px: Array, size: Array, largest_only: bool) -> float | None:
    """The coarsest decimation that still finds the tags that a pose lives on; None: none in view.

    sides_px (k,): shortest image side of each tag in view, size (k,) [m]; largest_only: the
    selection keeps the two largest sizes in view and needs no others. Tags of eight
    pixels and more after decimation are found in sharp images; ten leave room for blur.
    """
    if not len(sides_px):
        return None
    if largest_only:
        classes = np.unique(np.round(size, 6))
        sides_px = sides_px[size >= classes[-min(2, len(classes))] - 1e-6]
    needed = np.sort(sides_px)[::-1][:_ENOUGH_TAGS][-1]
    return max((d for d in _DECIMATES if needed >= _SIDE_PX * d), default=_DECIMATES[0])
