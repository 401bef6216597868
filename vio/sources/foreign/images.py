"""Pictures of ROS messages and video files as grey images."""

from typing import Any

import cv2
import numpy as np

Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
_BAYER = {"rggb": cv2.COLOR_BayerBG2GRAY, "bggr": cv2.COLOR_BayerRG2GRAY,
          "gbrg": cv2.COLOR_BayerGR2GRAY, "grbg": cv2.COLOR_BayerGB2GRAY}  # fmt: skip
_COLOUR = {  # ROS's encoding -> channels, OpenCV's conversion
    "bgr8": (3, cv2.COLOR_BGR2GRAY),
    "8UC3": (3, cv2.COLOR_BGR2GRAY),
    "rgb8": (3, cv2.COLOR_RGB2GRAY),
    "bgra8": (4, cv2.COLOR_BGRA2GRAY),
    "rgba8": (4, cv2.COLOR_RGBA2GRAY),
}
ENCODINGS = "mono8, mono16, rgb8, bgr8, rgba8, bgra8, bayer_*8"


def picture(message: Any) -> Image | None:
    """Grey (h, w) of a sensor_msgs/Image; None where its size or encoding is not one we know."""
    encoding = str(message.encoding)
    h, w, step = int(message.height), int(message.width), int(message.step)
    channels, conversion = _COLOUR.get(encoding, (1, None))
    wide = encoding in ("mono16", "16UC1")
    known = wide or encoding in ("mono8", "8UC1") or conversion or encoding.startswith("bayer_")
    width = w * channels * (2 if wide else 1)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if not known or not 0 < width <= step or h < 1 or len(data) < h * step:
        return None
    rows = np.ascontiguousarray(data[: h * step].reshape(h, step)[:, :width])
    if wide:
        return np.asarray(rows[:, (0 if message.is_bigendian else 1) :: 2])
    if conversion is not None:
        return np.asarray(cv2.cvtColor(rows.reshape(h, w, channels), conversion), dtype=np.uint8)
    if not encoding.startswith("bayer_"):
        return rows
    bayer = _BAYER.get(encoding[6:10]) if encoding.endswith("8") else None
    return None if bayer is None else np.asarray(cv2.cvtColor(rows, bayer), dtype=np.uint8)


def unpacked(data: Any) -> Image | None:
    """Grey (h, w) of a JPEG or PNG; None where it is broken."""
    buffer = np.frombuffer(data, dtype=np.uint8)
    try:
        image = cv2.imdecode(buffer, cv2.IMREAD_GRAYSCALE) if buffer.size else None
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)
