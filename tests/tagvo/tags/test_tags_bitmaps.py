"""Pictures of tags against the detectors that read them and against the other library's."""

import numpy as np
import pytest

from tagvo.errors import DetectorError
from tagvo.tags import bitmaps
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.families import FAMILIES, Family

APRIL = [f for f in FAMILIES.values() if f.apriltag]
BOTH = [f for f in APRIL if f.aruco]


def picture(cells: np.ndarray, scale: int = 8, pad: int = 40) -> np.ndarray:
    return np.pad(np.kron(cells, np.ones((scale, scale), np.uint8)), pad, constant_values=255)


def opencv_marker(family: Family, tag_id: int, border_bits: int) -> np.ndarray:
    from cv2 import aruco

    book = aruco.getPredefinedDictionary(getattr(aruco, str(family.aruco)))
    side = family.border_cells + 2 * (border_bits - 1)
    return np.asarray(aruco.generateImageMarker(book, tag_id, side, borderBits=border_bits))


@pytest.mark.parametrize("family", FAMILIES.values(), ids=lambda f: f.name)
def test_a_picture_has_the_cells_of_its_family(family):
    for tag_id in (0, family.ids // 2, family.ids - 1):
        cells = tag_bitmap(family, tag_id)
        assert cells.shape == (family.total_cells, family.total_cells)
        assert cells.dtype == np.uint8
        assert set(np.unique(cells)) == {0, 255}
        ring = (family.total_cells - family.border_cells) // 2
        edge = cells[ring : -ring or None, ring]  # left column of the border square
        outside = cells[ring - 1 : cells.shape[0] - ring + 1, ring - 1]
        assert (edge == (255 if family.reversed_border else 0)).all()
        assert (outside == (0 if family.reversed_border else 255)).all()


@pytest.mark.parametrize("family", APRIL, ids=lambda f: f.name)
def test_the_apriltag_detector_reads_it_upright(family):
    import apriltag

    detector = apriltag.apriltag(family.name, maxhamming=0, decimate=1.0)
    tag_id = min(family.ids - 1, 17)
    cells = tag_bitmap(family, tag_id)
    (found,) = detector.detect(picture(cells))
    assert found["id"] == tag_id
    ring = (family.total_cells - family.border_cells) // 2
    low, high = 40 + 8 * ring, 40 + 8 * (family.total_cells - ring)
    upright = [[low, high], [high, high], [high, low], [low, low]]  # lb rb rt lt, y down
    np.testing.assert_allclose(found["lb-rb-rt-lt"], upright, atol=0.5)


@pytest.mark.parametrize("family", BOTH, ids=lambda f: f.name)
@pytest.mark.parametrize("bits", [1, 2, 3])
def test_apriltag_is_opencv_turned_by_180_degrees(family, bits):
    for tag_id in (0, 3, family.ids - 1):
        ours = tag_bitmap(family, tag_id, bits)
        theirs = np.pad(opencv_marker(family, tag_id, bits), 1, constant_values=255)
        np.testing.assert_array_equal(ours, theirs[::-1, ::-1])
        assert (ours != theirs).any()


@pytest.mark.parametrize("bits", [1, 2])
def test_aruco_is_as_opencv_draws_it_and_reads(bits):
    from cv2 import aruco

    family = FAMILIES["DICT_5X5_100"]
    cells = tag_bitmap(family, 42, bits)
    np.testing.assert_array_equal(cells[1:-1, 1:-1], opencv_marker(family, 42, bits))
    parameters = aruco.DetectorParameters()
    parameters.markerBorderBits = bits
    book = aruco.getPredefinedDictionary(aruco.DICT_5X5_100)
    corners, ids, _ = aruco.ArucoDetector(book, parameters).detectMarkers(picture(cells))
    assert ids.ravel().tolist() == [42]
    np.testing.assert_allclose(corners[0][0, 0], [48, 48], atol=1.0)  # TL first: upright


def test_a_picture_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        tag_bitmap(FAMILIES["tag36h11"], 0)[0, 0] = 7


@pytest.mark.parametrize(
    ("name", "tag_id", "bits", "says"),
    [
        ("tag36h11", 587, 1, "0 to 586"),
        ("tag36h11", -1, 1, "0 to 586"),
        ("tagStandard41h12", 0, 2, "knows 1 alone"),
        ("tag36h11", 0, 0, "at least 1"),
    ],
)
def test_what_cannot_be_drawn_is_refused(name, tag_id, bits, says):
    with pytest.raises(DetectorError, match=says):
        tag_bitmap(FAMILIES[name], tag_id, bits)


def test_a_missing_library_names_its_package(monkeypatch):
    monkeypatch.setattr(bitmaps.importlib.util, "find_spec", lambda name: None)
    bitmaps._april_library.cache_clear()
    try:
        with pytest.raises(DetectorError, match="pip install apriltag-python"):
            bitmaps._april_library()
    finally:
        bitmaps._april_library.cache_clear()
