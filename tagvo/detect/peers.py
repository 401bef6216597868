"""Other people's detectors as they are usually run, for the benchmark alone."""

from typing import Any

import numpy as np

from tagvo.detect.edge_profile import Gray
from tagvo.detect.protocol import gray_image, no_detections
from tagvo.errors import DetectorError
from tagvo.records import Detections
from tagvo.tags.families import Family

_PIXEL_CENTRE = 0.5


class PyAprilTags:
    """The package pyapriltags with its own defaults but for the decimation."""

    def __init__(self, family: Family, decimate: float) -> None:
        try:
            import pyapriltags
        except ImportError as err:
            raise DetectorError(
                f"pyapriltags is not to be had here ({err}); `pip install pyapriltags` brings it"
            ) from None
        self._detector: Any = pyapriltags.Detector(
            families=family.name, nthreads=1, quad_decimate=decimate
        )

    def detect(self, image: Gray, decimate: float | None = None) -> Detections:
        """Tags in a grey or BGR image; decimate is not heeded."""
        found = self._detector.detect(gray_image(image))
        if not found:
            return no_detections()
        corners = np.array([tag.corners for tag in found])[:, ::-1] - _PIXEL_CENTRE
        return Detections.of(np.array([tag.tag_id for tag in found]), corners)


class PlainAruco:
    """OpenCV's ArUco module with subpixel corners, as its tutorials have it."""

    def __init__(self, family: Family, border_bits: int = 1) -> None:
        if family.aruco is None:
            raise DetectorError(f"OpenCV does not read {family.name}")
        from cv2 import aruco

        parameters = aruco.DetectorParameters()
        parameters.markerBorderBits = border_bits
        parameters.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
        dictionary = aruco.getPredefinedDictionary(getattr(aruco, family.aruco))
        self._detector = aruco.ArucoDetector(dictionary, parameters)
        self._roll = 2 if "APRILTAG" in family.aruco else 0

    def detect(self, image: Gray, decimate: float | None = None) -> Detections:
        """Tags in a grey or BGR image; decimate is not heeded."""
        corners, ids, _ = self._detector.detectMarkers(gray_image(image))
        if ids is None or not len(ids):
            return no_detections()
        quads = np.array(corners, dtype=float).reshape(-1, 4, 2)
        return Detections.of(np.ravel(ids), np.roll(quads, self._roll, axis=1))
