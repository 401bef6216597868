"""Draws what a camera saw at a moment: its image, the tags in use, those rejected."""

import cv2
import numpy as np

from tagvo.geometry import BoolArray
from tagvo.records import Observations

Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
_WIDTH = 560  # pixels: a page of several pictures must stay small
_USED, _REJECTED = (80, 200, 60), (40, 40, 235)  # BGR
_QUALITY = 75


def picture(
    image: Image | None, seen: Observations, rejected: BoolArray, resolution: tuple[int, int]
) -> tuple[bytes, tuple[int, int]]:
    """A JPEG of the image (grey where there is none) with its tags outlined, and its size."""
    if image is None:
        image = np.full(resolution[::-1], 128, dtype=np.uint8)
    shown = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()
    scale = min(1.0, _WIDTH / shown.shape[1])
    shown = cv2.resize(shown, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    for i in range(len(seen)):
        corners = np.rint(scale * seen.corners_px[i]).astype(np.int32)
        colour = _REJECTED if rejected[i] else _USED
        cv2.polylines(shown, [corners], True, colour, 2, cv2.LINE_AA)
        if rejected[i]:  # not by colour alone
            for a, b in ((0, 2), (1, 3)):
                cv2.line(shown, _at(corners[a]), _at(corners[b]), colour, 1, cv2.LINE_AA)
        middle = _at(corners.mean(axis=0))
        text = str(seen.tag_id[i])
        for tint, width in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(shown, text, middle, cv2.FONT_HERSHEY_SIMPLEX, 0.4, tint, width,
                        cv2.LINE_AA)  # fmt: skip
    done, data = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return (data.tobytes() if done else b""), (shown.shape[1], shown.shape[0])


def _at(point: "np.ndarray[tuple[int, ...], np.dtype[np.int32]]") -> tuple[int, int]:
    return int(point[0]), int(point[1])
