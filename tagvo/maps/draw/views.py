"""From where a tag map is looked at: its surfaces, and the parallel views that show them."""

from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.tags.tag_map import TagMap

_SAME_SURFACE_COS = 0.97  # faces within 14 degrees of one another make one surface
_SAME_SURFACE_M = 0.10  # ... where they lie within this of one plane
_ALIGNED = 0.9995  # a page axis this near to an axis of W bears its name
_AZIMUTH, _ELEVATION = np.radians(-58.0), np.radians(30.0)  # of the eye, in the corner view


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A parallel view: rows of page (2, 3) are the page's right and up in W; towards (3,) the eye.

    labels: what the two page axes measure, with the sign by which a page coordinate is W's.
    """

    page: Array
    towards: Array
    labels: tuple[tuple[str, float], tuple[str, float]]
    frontal: bool

    def project(self, x_W: Array) -> Array:
        """Points of W on the page [m]; (..., 3) -> (..., 2)."""
        return np.asarray(x_W @ self.page.T)


def surfaces_of(tag_map: TagMap) -> list[IntArray]:
    """Rows of the tags of each surface (tags facing one way in about one plane), largest first."""
    rows = np.arange(len(tag_map))
    n_W = tag_map.R_WT[:, :, 2]
    found: list[IntArray] = []
    while len(rows):
        seed = rows[0]
        facing = n_W[rows] @ n_W[seed] > _SAME_SURFACE_COS
        off = np.abs((tag_map.p_WT[rows] - tag_map.p_WT[seed]) @ n_W[seed])
        member = facing & (off < _SAME_SURFACE_M)
        found.append(rows[member])
        rows = rows[~member]
    return sorted(found, key=len, reverse=True)


def frontal_view(tag_map: TagMap, rows: IntArray) -> View:
    """View onto the face of some tags: W's z up for walls, W's y up for floors and ceilings."""
    n_W = tag_map.R_WT[rows, :, 2].mean(axis=0)
    n_W = n_W / np.linalg.norm(n_W)
    level = abs(n_W[2]) > 0.7
    up = np.array([0.0, 1.0, 0.0]) if level else np.array([0.0, 0.0, 1.0])
    nearest = np.eye(3)[int(np.argmax(np.abs(n_W)))] * np.sign(n_W[np.argmax(np.abs(n_W))])
    if n_W @ nearest > np.cos(np.radians(2.0)):  # a surveyed wall: its normal is not quite W's axis
        n_W = nearest
    up = up - n_W * (up @ n_W)
    up = up / np.linalg.norm(up)
    right = np.cross(up, n_W)
    return View(np.stack([right, up]), n_W, (_label(right), _label(up)), frontal=True)


def corner_view() -> View:
    """View from above a corner, W's z up."""
    cos_e, sin_e = np.cos(_ELEVATION), np.sin(_ELEVATION)
    towards = np.array([cos_e * np.cos(_AZIMUTH), cos_e * np.sin(_AZIMUTH), sin_e])
    right = np.array([-np.sin(_AZIMUTH), np.cos(_AZIMUTH), 0.0])
    page = np.stack([right, np.cross(towards, right)])
    return View(page, towards, (("", 1.0), ("", 1.0)), frontal=False)


def surface_name(view: View) -> str:
    """What a frontal view looks at, such as `facing +x`."""
    along = int(np.argmax(np.abs(view.towards)))
    if abs(view.towards[along]) < _ALIGNED:
        return "facing " + ", ".join(f"{v:+.2f}" for v in view.towards)
    return f"facing {'+' if view.towards[along] > 0 else '−'}{'xyz'[along]}"


def _label(axis_W: Array) -> tuple[str, float]:
    along = int(np.argmax(np.abs(axis_W)))
    if abs(axis_W[along]) < _ALIGNED:
        return "along the surface [m]", 1.0
    return f"{'xyz'[along]} in W [m]", float(np.sign(axis_W[along]))


def nice_step(extent: float, parts: int = 8) -> float:
    """A step of 1, 2 or 5 times a power of ten that cuts an extent into about so many parts."""
    rough = max(extent, 1e-6) / parts
    power = 10.0 ** np.floor(np.log10(rough))
    return float(next(m * power for m in (1.0, 2.0, 5.0, 10.0) if m * power >= rough * 0.999))
