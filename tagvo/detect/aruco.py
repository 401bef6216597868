"""Adapter to OpenCV's ArUco module: its dictionaries, and AprilGrids with a wide border.

OpenCV only proposes squares here. Its corners lie 0.4 to 0.6 px off (whatever its refinement), so
that every square's edges are fitted anew and its bits read again between them; squares that
OpenCV turned down for their bits get the same second chance.
"""

from typing import Any

import numpy as np

from tagvo.detect.codes import Codes, codes, read_bits, upright
from tagvo.detect.edge_profile import Gray, refit_corners, signed_area
from tagvo.detect.protocol import gray_image, no_detections
from tagvo.errors import DetectorError
from tagvo.geometry import Array, BoolArray
from tagvo.records import Detections
from tagvo.tags.families import FAMILIES, Family

_MIN_AREA_PX = 64.0  # no family can be read in less than 8 x 8 pixels
_MIN_IMAGE_PX = 8
_SAME_PX = 2.0  # two finds of one id nearer than this are one tag


class ArucoDetector:
    """OpenCV's ArUco module behind the `Detector` protocol.

    border_bits: width of the black border in cells (2: Kalibr's AprilGrids); max_hamming: bits
    corrected, fewer where chance would make tags (4x4 and 16h5: 0); thorough: find squares by
    AprilTag's way, slower by about four, for grids whose squares touch (None: where the border is
    wide).
    """

    def __init__(
        self,
        family: Family,
        border_bits: int = 1,
        max_hamming: int = 1,
        thorough: bool | None = None,
    ) -> None:
        if border_bits < 1:
            raise DetectorError(f"aruco border_bits: {border_bits!r}; at least 1 is needed")
        aruco, dictionary = _dictionary(family)
        parameters = aruco.DetectorParameters()
        parameters.markerBorderBits = border_bits
        parameters.minDistanceToBorder = 0  # else it drops whole tags whose white ring is near
        parameters.errorCorrectionRate = 1.0  # the bits are read again between better corners
        if border_bits > 1 if thorough is None else thorough:
            parameters.cornerRefinementMethod = aruco.CORNER_REFINE_APRILTAG
        self._detector = aruco.ArucoDetector(dictionary, parameters)
        self._border_bits = border_bits
        self._codes = _codes(dictionary, turned="APRILTAG" in (family.aruco or ""))
        self._cells = self._codes.side + 2 * border_bits
        self._max_errors = self._codes.max_errors(max_hamming)
        self._second_chance = self._codes.by_chance < 1e-3

    def detect(self, image: Gray, decimate: float | None = None) -> Detections:
        """Tags in a grey (h, w) or BGR (h, w, 3) image, by id; always at full resolution."""
        gray = gray_image(image)
        if min(gray.shape) < _MIN_IMAGE_PX:
            return no_detections()
        squares = self._squares(gray)
        if not len(squares):
            return no_detections()
        corners = refit_corners(gray, squares, self._cells)
        read = read_bits(gray, corners, self._codes, self._border_bits)
        good = np.flatnonzero(read.ok & (read.errors <= self._max_errors))
        good = good[np.lexsort((-read.margin[good], read.errors[good], read.tag_id[good]))]
        quads = upright(corners[good], read.turns[good])
        found = Detections.of(read.tag_id[good], quads, read.errors[good], read.margin[good])
        return found[_first_of_each(found)]

    def _squares(self, gray: Gray) -> Array:
        """Rough corners of what may be tags, clockwise in the image; (m, 4, 2)."""
        known, _, refused = self._detector.detectMarkers(gray)
        both = [*known, *refused] if self._second_chance else list(known)
        squares = np.array(both, dtype=float).reshape(-1, 4, 2)
        return squares[signed_area(squares) > _MIN_AREA_PX]


def _first_of_each(found: Detections) -> BoolArray:
    """Mask (n,) that drops a find at the place of an earlier one of the same id."""
    apart = np.abs(found.corners_px[:, None] - found.corners_px[None]).max(axis=(2, 3))
    same = (found.tag_id[:, None] == found.tag_id) & (apart < _SAME_PX)
    return np.asarray(~np.tril(same, -1).any(axis=1))


def _codes(dictionary: Any, turned: bool) -> Codes:
    """The dictionary's bits upright; OpenCV draws its AprilTag dictionaries turned by 180 deg."""
    side, data = dictionary.markerSize, dictionary.bytesList
    bits = [dictionary.getBitsFromByteList(data[i : i + 1], side) for i in range(len(data))]
    array = np.array(bits, dtype=np.uint8).reshape(-1, side, side)
    return codes(array[:, ::-1, ::-1] if turned else array)


def _dictionary(family: Family) -> tuple[Any, Any]:
    """The aruco module and the family's dictionary; DetectorError says what is missing."""
    if family.aruco is None:
        names = (f.name for f in FAMILIES.values() if f.aruco)
        raise DetectorError(
            f"aruco: OpenCV does not read {family.name}; it reads {', '.join(names)}"
        )
    try:
        from cv2 import aruco
    except ImportError as err:
        raise DetectorError(
            f"aruco: OpenCV's ArUco module is not to be had here ({err});"
            " install it with `pip install opencv-contrib-python-headless`"
        ) from None
    if not hasattr(aruco, family.aruco):
        raise DetectorError(
            f"aruco: the OpenCV here lacks {family.aruco};"
            " `pip install -U opencv-contrib-python-headless` brings it"
        )
    return aruco, aruco.getPredefinedDictionary(getattr(aruco, family.aruco))
