"""What every tag detector promises, and the checks on images that all of them share."""

from typing import Any, Protocol

import numpy as np

from tagvo.detect.edge_profile import Gray
from tagvo.errors import DetectorError
from tagvo.records import Detections


class Detector(Protocol):
    """Finds tags: image (h, w) uint8 -> corners TL, TR, BR, BL, pixel centres at integers."""

    def detect(self, image: Gray, decimate: float | None = None) -> Detections:
        """Tags in a grey (h, w) or BGR (h, w, 3) image; none in an image too small for one.

        decimate: the tags that are needed stand an image so many times as coarse; a detector may
        search that, and then drops those too small for exact corners, or take no notice.
        """


def gray_image(image: np.ndarray[Any, Any]) -> Gray:
    """The image as contiguous grey uint8 (h, w); BGR (h, w, 3) is converted, the rest refused."""
    shape, kind = getattr(image, "shape", None), getattr(image, "dtype", None)
    fits = shape is not None and (len(shape) == 2 or (len(shape) == 3 and shape[2] in (1, 3)))
    if not fits or kind != np.uint8:
        raise DetectorError(
            f"image: {type(image).__name__} of shape {shape} and dtype {kind};"
            " uint8 of shape (h, w) or (h, w, 3) BGR is needed"
        )
    if image.ndim == 3 and image.shape[2] == 3 and image.size:
        import cv2

        return np.asarray(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_BGR2GRAY), np.uint8)
    return np.ascontiguousarray(image if image.ndim == 2 else image[..., 0])


def no_detections() -> Detections:
    """What a detector answers where there is nothing."""
    return Detections.of(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)))
