"""How well each corner is known, from how wide the tag's edges are in the image.

Calibrated on rendered views (41h12 and 36h11 at 20, 40, 80 px; motion of 0 to 9 px in any
direction, defocus to 2 px, noise of 1 to 8 grey values) with the AprilTag library: see
`corner_sigma`.
"""

import numpy as np

from tagvo.detect.edge_profile import Gray, cell_width, edge_profiles, rising
from tagvo.geometry import Array

_SCANS = 6
_STEPS = 15
_REACH_PX = 6.0  # as far as the edge of a tag blurred by 10 px reaches
_SHARP_PX = 0.55  # spread of a sharp edge, the box of a pixel and bilinear sampling included
_BLEED = 10.5  # systematic error of a blurred corner: _BLEED * spread * (spread / cell)^3
_FLOOR = 0.15  # share of the steepest step below which a step is noise or a neighbouring edge


def edge_spread(image: Gray, corners_px: Array, cells: int) -> Array:
    """Width of the edge of each side [px]: standard deviation of its gradient; (n, 4, 2) -> (n, 4).

    cells: cells across the square that the corners span; nothing further than a cell from the
    edge is looked at, so that a blur wider than a cell shows as one cell.
    """
    if not len(corners_px) or not image.size:
        return np.zeros((len(corners_px), 4))
    reach = np.clip(cell_width(corners_px, cells), 1.5, _REACH_PX)
    profiles = edge_profiles(image, corners_px, reach, _SCANS, _STEPS)
    step = rising(profiles.mean(axis=2))
    step = np.maximum(step - _FLOOR * step.max(axis=-1, keepdims=True), 0.0)
    middle = np.linspace(-1.0, 1.0, 2 * _STEPS - 1)[1::2]
    mass = np.maximum(step.sum(axis=-1), 1e-9)
    mean = step @ middle / mass
    variance = np.maximum(step @ middle**2 / mass - mean**2, 0.0)
    return np.asarray(reach * np.sqrt(variance))


def corner_sigma(spread_px: Array, cell_px: Array, base_px: float) -> Array:
    """Standard deviation per axis of each corner [px]; (n, 4) and (n, 4) of the sides -> (n, 4).

    base_px: that of a corner between sharp edges. Noise moves an edge in proportion to its spread
    s; beyond that the data cells of width c bleed into the edge by 10.5 s (s / c)^3. A corner
    takes the mean square of its two sides.
    """
    noise = base_px * np.maximum(spread_px / _SHARP_PX, 1.0)
    bleed = _BLEED * spread_px * (spread_px / np.maximum(cell_px, 1e-6)) ** 3
    square = np.square(noise) + np.square(bleed)
    return np.asarray(np.sqrt(0.5 * (square + square[:, [3, 0, 1, 2]])))


def measured_sigma(image: Gray, corners_px: Array, cells: int, base_px: float) -> Array:
    """Standard deviation per axis of each corner [px] as the image shows it; -> (n, 4)."""
    spread = edge_spread(image, corners_px, cells)
    return corner_sigma(spread, cell_width(corners_px, cells), base_px)
