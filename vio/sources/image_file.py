"""Image files: judged by their header before OpenCV decodes them, which trusts what they claim."""

import re
import struct

import numpy as np

Bytes = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
_MOST_PIXELS = 100_000_000  # a 10k x 10k camera; more is a claim, and 0.1 GB of memory
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
_SOF = {0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF}
_ALONE = {0x01, *range(0xD0, 0xD8)}  # markers of a JPEG that have no length
_MOST_CHUNKS = 100_000
_MOST_SCANS = 64  # of a progressive JPEG, each a pass over the whole image


def decoded(data: Bytes) -> Bytes | None:
    """Grey image (h, w) of a PNG, JPEG, BMP or PNM file's bytes (n,), None where it is none."""
    import cv2

    size = image_size(data)
    if size is None or size[0] * size[1] > _MOST_PIXELS:
        return None
    try:
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def image_size(data: Bytes) -> tuple[int, int] | None:
    """Width, height [px] that an image file's header states; None where it is broken or none."""
    raw = np.ascontiguousarray(data).data.cast("B") if data.size else memoryview(b"")
    start = bytes(raw[:8])
    try:
        if start == _PNG:
            return _sane(_png_size(raw))
        if start[:2] == _JPEG:
            return _sane(_jpeg_size(raw))
        if start[:2] == b"BM":
            w, h = struct.unpack_from("<ii", raw, 18)
            return _sane((w, abs(h)))
        if re.match(rb"P[2356]\s", start):
            found = re.match(
                rb"P[2356]\s+(?:#[^\n]*\n\s*)*(\d{1,6})\s+(\d{1,6})\s", bytes(raw[:512])
            )
            return None if found is None else _sane((int(found[1]), int(found[2])))
    except struct.error:  # the header is cut
        return None
    return None


def _sane(size: tuple[int, int] | None) -> tuple[int, int] | None:
    return size if size is not None and min(size) > 0 else None


def _png_size(raw: memoryview) -> tuple[int, int] | None:
    """Size by IHDR; None where a chunk claims more than the file has (but the last, cut one)."""
    length, kind, w, h = struct.unpack_from(">I4sII", raw, 8)
    if kind != b"IHDR" or length != 13:
        return None
    at = 8
    for _ in range(_MOST_CHUNKS):
        if at + 8 > len(raw):
            return int(w), int(h)
        length, kind = struct.unpack_from(">I4s", raw, at)
        if at + 12 + length > len(raw) and length > len(raw):
            return None
        if kind == b"IEND":
            return int(w), int(h)
        at += 12 + length
    return None


def _jpeg_size(raw: memoryview) -> tuple[int, int] | None:
    """Size by the frame header (SOF)."""
    at = 2
    while at + 4 <= len(raw):
        if raw[at] != 0xFF:
            return None
        marker = raw[at + 1]
        if marker == 0xFF:  # fill bytes
            at += 1
            continue
        if marker in _ALONE:
            at += 2
            continue
        length = struct.unpack_from(">H", raw, at + 2)[0]
        if marker in _SOF:
            h, w = struct.unpack_from(">HH", raw, at + 5)
            scans = bytes(raw).count(b"\xff\xda") if marker == 0xC2 else 1
            return (int(w), int(h)) if scans <= _MOST_SCANS else None
        at += 2 + length
    return None
