"""The picture of each tag, cell by cell: what rendering, printing and oracles draw from.

Upright is as the AprilTag library draws it; OpenCV draws its AprilTag dictionaries turned by 180
degrees. ArUco's own dictionaries are upright as OpenCV draws them.
"""

import ctypes
import importlib.util
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from tagvo.errors import DetectorError
from tagvo.tags.families import Family

Cells: TypeAlias = NDArray[np.uint8]


class _FamilyHead(ctypes.Structure):
    """First field of the library's `apriltag_family_t`."""

    _fields_ = (("ncodes", ctypes.c_uint32),)


class _ImageU8(ctypes.Structure):
    """The library's `image_u8_t`."""

    _fields_ = (
        ("width", ctypes.c_int32),
        ("height", ctypes.c_int32),
        ("stride", ctypes.c_int32),
        ("buf", ctypes.POINTER(ctypes.c_uint8)),
    )


@lru_cache(maxsize=4096)
def tag_bitmap(family: Family, tag_id: int, border_bits: int = 1) -> Cells:
    """The whole printed tag, upright, a number a cell: 0 black, 255 white; read-only.

    -> (cells, cells), cells = total_cells + 2 (border_bits - 1), the outermost ring included.
    """
    if not 0 <= tag_id < family.ids:
        raise DetectorError(
            f"{family.name}: no tag {tag_id} in this family; 0 to {family.ids - 1} are"
        )
    if border_bits < 1 or (border_bits > 1 and family.reversed_border):
        raise DetectorError(
            f"{family.name}: border_bits {border_bits} cannot be drawn; "
            + ("this family knows 1 alone" if family.reversed_border else "at least 1 is needed")
        )
    cells = _april_cells(family, tag_id) if family.apriltag else _opencv_cells(family, tag_id)
    if border_bits > 1:
        cells = _frame(cells[2:-2, 2:-2], border_bits)
    cells.setflags(write=False)
    return cells


def _frame(data: Cells, border_bits: int) -> Cells:
    """Data cells with a black border and a white ring around it."""
    return np.pad(np.pad(data, border_bits), 1, constant_values=255)


@lru_cache(maxsize=1)
def _april_library() -> ctypes.CDLL:
    spec = importlib.util.find_spec("apriltag")
    folders = [Path(p) for p in (spec.submodule_search_locations or [])] if spec else []
    for folder in folders:
        for path in sorted((*folder.glob("libapriltag.*"), *folder.glob("apriltag.dll"))):
            try:
                library = ctypes.CDLL(str(path))
            except OSError:
                continue
            library.apriltag_to_image.argtypes = (ctypes.c_void_p, ctypes.c_uint32)
            library.apriltag_to_image.restype = ctypes.POINTER(_ImageU8)
            library.image_u8_destroy.argtypes = (ctypes.POINTER(_ImageU8),)
            library.image_u8_destroy.restype = None
            return library
    raise DetectorError(
        "the AprilTag library is not to be had here; `pip install apriltag-python` brings it"
    )


@lru_cache(maxsize=16)
def _april_family(name: str) -> int:
    """Address of the library's family, made once and kept."""
    try:
        create = getattr(_april_library(), f"{name}_create")
    except AttributeError:
        raise DetectorError(
            f"{name}: the AprilTag library here lacks this family;"
            " `pip install -U apriltag-python` brings it"
        ) from None
    create.argtypes, create.restype = (), ctypes.c_void_p
    return int(create())


def _april_cells(family: Family, tag_id: int) -> Cells:
    pointer = _april_family(family.name)
    known = _FamilyHead.from_address(pointer).ncodes
    if tag_id >= known:
        raise DetectorError(
            f"{family.name}: no tag {tag_id} in the AprilTag library; 0 to {known - 1} are"
        )
    library = _april_library()
    image = library.apriltag_to_image(pointer, tag_id)
    try:
        head = image.contents
        rows = np.ctypeslib.as_array(head.buf, (head.height, head.stride))
        return np.where(rows[:, : head.width] > 127, 255, 0).astype(np.uint8)
    finally:
        library.image_u8_destroy(image)


def _opencv_cells(family: Family, tag_id: int) -> Cells:
    try:
        from cv2 import aruco
    except ImportError:
        raise DetectorError(
            f"{family.name}: OpenCV's aruco module is not to be had here;"
            " `pip install opencv-contrib-python-headless` brings it"
        ) from None
    number = getattr(aruco, family.aruco or "", None)
    if number is None:
        raise DetectorError(
            f"{family.name}: the OpenCV here lacks this dictionary;"
            " `pip install -U opencv-contrib-python-headless` brings it"
        )
    side = family.total_cells - 2
    marker = aruco.generateImageMarker(aruco.getPredefinedDictionary(number), tag_id, side)
    if "APRILTAG" in (family.aruco or ""):
        marker = marker[::-1, ::-1]
    return np.pad(np.asarray(marker, dtype=np.uint8), 1, constant_values=255)
