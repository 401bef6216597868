"""Adapter to the AprilTag library (pip package apriltag-python, module `apriltag`)."""

from typing import Any

import numpy as np

from tagvo.detect.edge_profile import Gray
from tagvo.detect.protocol import gray_image, no_detections
from tagvo.errors import DetectorError
from tagvo.geometry import Array, BoolArray, shortest_sides
from tagvo.records import Detections
from tagvo.tags.families import FAMILIES, Family

_UPRIGHT = [3, 2, 1, 0]  # the library's order is BL, BR, TR, TL
_PIXEL_CENTRE = 0.5  # where the library puts the centre of the first pixel
_WIDE = 1280  # [px] from here decimate 2 loses no tag worth having; below, 1.5 pays
_FINE = 1.5  # up to this decimation every tag found has exact corners
_EXACT_PX = 10.0  # of a side after decimation; below, corners are worse, at 3 and 4 by times
_DECIMATES = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)  # at 1.75 the library finds nothing


def decimate_for(width: int) -> float:
    """The decimation that pays for images of that width: 1.5 near 640, 2 from 1280 up."""
    return 1.5 if width < _WIDE else 2.0


class AprilTagDetector:
    """The AprilTag library behind the `Detector` protocol.

    decimate None: by the image's width (`decimate_for`); blur: standard deviation [px] of the
    library's own smoothing; one object belongs to one thread.
    """

    def __init__(
        self,
        family: Family,
        decimate: float | None = None,
        maxhamming: int = 1,
        threads: int = 1,
        blur: float = 0.0,
    ) -> None:
        if not family.apriltag:
            names = (f.name for f in FAMILIES.values() if f.apriltag)
            raise DetectorError(
                f"apriltag: the AprilTag library does not read {family.name};"
                f" it reads {', '.join(names)}"
            )
        if decimate is not None and decimate not in _DECIMATES:
            allowed = ", ".join(f"{d:g}" for d in _DECIMATES)
            raise DetectorError(f"apriltag decimate: {decimate!r}; choose one of {allowed}")
        if not 0 <= maxhamming <= 2:
            raise DetectorError(f"apriltag maxhamming: {maxhamming!r}; 0, 1 or 2 corrected bits")
        self._family, self._decimate = family.name, decimate
        self._options = {"maxhamming": maxhamming, "threads": threads, "blur": blur}
        self._library = _library()
        self._detectors: dict[float, Any] = {}
        if decimate is not None:
            self._at(decimate)

    def _at(self, decimate: float) -> Any:
        if decimate not in self._detectors:
            self._detectors[decimate] = self._library(
                self._family, decimate=decimate, refine_edges=True, **self._options
            )
        return self._detectors[decimate]

    def detect(self, image: Gray, decimate: float | None = None) -> Detections:
        """Tags in a grey (h, w) or BGR (h, w, 3) image, in the order the library gives them.

        decimate: for this image, where the detector was made with none; then small tags are
        dropped (`_exact`).
        """
        gray = gray_image(image)
        asked = None if self._decimate else decimate
        taken = self._decimate or decimate or decimate_for(gray.shape[1])
        if min(gray.shape) < 4 * taken + 4:  # below about 3 decimated pixels the library crashes
            return no_detections()
        found = self._at(taken).detect(gray)
        if not found:
            return no_detections()
        corners = np.array([tag["lb-rb-rt-lt"] for tag in found], dtype=float)
        tags = Detections.of(
            np.array([tag["id"] for tag in found]),
            upright(corners),
            np.array([tag["hamming"] for tag in found]),
            np.array([tag["margin"] for tag in found]),
        )
        return tags if asked is None else tags[_exact(tags.corners_px, asked)]


def _exact(corners_px: Array, decimate: float) -> BoolArray:
    """Which quads (n, 4, 2) of a search are large enough to have exact corners."""
    if decimate <= _FINE:
        return np.ones(len(corners_px), dtype=bool)
    return np.asarray(shortest_sides(corners_px) >= _EXACT_PX * decimate)


def upright(corners_px: Array) -> Array:
    """The library's corners (n, 4, 2) [px] as ours: from the upper left, pixel centres whole."""
    return np.asarray(corners_px[:, _UPRIGHT] - _PIXEL_CENTRE)


def as_library(corners_px: Array) -> Array:
    """Our corners (n, 4, 2) [px] as the library has them: the inverse of `upright`."""
    return np.asarray(corners_px[:, _UPRIGHT] + _PIXEL_CENTRE)


def _library() -> Any:
    """The class `apriltag.apriltag`; DetectorError says what to install."""
    try:
        from apriltag import apriltag
    except ImportError as err:
        raise DetectorError(
            f"apriltag: the AprilTag library is not to be had here ({err});"
            " install it with `pip install apriltag-python`"
        ) from None
    return apriltag
