"""Pictures of ROS messages and video files as grey images."""

import re
from typing import Any

import cv2
import numpy as np

from vio.sources.image_file import decoded

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
_LUMA = {  # YUV 4:2:2, two bytes a pixel: the first byte that is brightness
    "yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0, "yuv422_yuyv": 0,
}  # fmt: skip
_PLANAR = ("nv12", "nv21", "nv24", "i420", "yv12", "yuv420", "yuv420p", "yuv_420_888")
_DEEP = ("mono16", "16UC1")
ENCODINGS = "mono8, mono16, rgb8, bgr8, rgba8, bgra8, bayer_*8, yuv422, yuyv, uyvy, nv12, i420"


def picture(message: Any) -> Image | None:
    """Grey (h, w) of a sensor_msgs/Image; None where its size or encoding is not one we know."""
    encoding = str(message.encoding)
    h, w, step = int(message.height), int(message.width), int(message.step)
    wide = encoding in _DEEP or encoding.lower() in _LUMA
    width = w * _COLOUR.get(encoding, (1, None))[0] * (2 if wide else 1)
    data = np.frombuffer(message.data, dtype=np.uint8)
    if not 0 < width <= step or h < 1 or len(data) < h * step:
        return None
    rows = np.ascontiguousarray(data[: h * step].reshape(h, step)[:, :width])
    return _grey(encoding, rows, w, bool(message.is_bigendian))


def _grey(encoding: str, rows: Image, w: int, big: bool) -> Image | None:
    """Grey (h, w) of an image's rows of bytes; None for an encoding that we do not know."""
    name = encoding.lower()
    if encoding in _DEEP:
        return np.asarray(rows[:, (0 if big else 1) :: 2])
    if name in _LUMA:
        return np.asarray(rows[:, _LUMA[name] :: 2])
    if encoding in ("mono8", "8UC1") or name in _PLANAR:
        return rows  # of planes the first h rows are the brightness
    channels, conversion = _COLOUR.get(encoding, (1, None))
    if conversion is not None:
        bands = rows.reshape(len(rows), w, channels)
        return np.asarray(cv2.cvtColor(bands, conversion), dtype=np.uint8)
    bayer = _BAYER.get(encoding[6:10]) if re.fullmatch("bayer_[bgr]{4}8", encoding) else None
    if bayer is None or min(rows.shape) < 2:
        return None
    return np.asarray(cv2.cvtColor(rows, bayer), dtype=np.uint8)


def unpacked(data: Any) -> Image | None:
    """Grey (h, w) of a JPEG or PNG; None where it is broken."""
    return decoded(np.frombuffer(data, dtype=np.uint8))
