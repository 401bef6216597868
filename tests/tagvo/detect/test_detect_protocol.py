"""Detectors against exact projections: corners, their order, the half-pixel, bad images."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.camera.model import Camera, project
from tagvo.detect import make_detector
from tagvo.detect.apriltag import AprilTagDetector, decimate_for
from tagvo.detect.aruco import ArucoDetector
from tagvo.detect.codes import codes, read_bits, upright
from tagvo.errors import DetectorError
from tagvo.render.view import render_view
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import TagMap, map_from_dict

F_PX = 600.0
DOWN = np.diag([1.0, -1.0, -1.0])  # R_WC of a camera that looks down, image up is +y


def camera(width=640, height=480):
    centre = [(width - 1) / 2, (height - 1) / 2]
    return Camera("none", np.array([F_PX, F_PX, *centre]), np.zeros(4), (width, height))


def board(family, side_px, columns, rows, rng, border_bits=1, turns=None) -> TagMap:
    """A board of tags of side_px at 1 m, centred at the origin, each turned at random."""
    size = side_px / F_PX
    total = size * FAMILIES[family].total_per_border(border_bits)
    tags = []
    for i in range(columns * rows):
        turn = rng.uniform(0, 2 * np.pi) if turns is None else turns[i]
        x, y = i % columns - (columns - 1) / 2, i // columns - (rows - 1) / 2
        pitch = 1.5 * total if turns is None else 1.2 * total
        q = [float(np.cos(turn / 2)), 0.0, 0.0, float(np.sin(turn / 2))]
        tags.append({"id": i, "size": size, "p": [float(x * pitch), float(y * pitch), 0.0], "q": q})
    data = {"family": family, "border_bits": border_bits, "tags": tags}
    return map_from_dict(data, "test board")


def view(tag_map, rng, tilt=0.2, noise=2.0, supersample=4, cam=None):
    """A picture from about 1 m and the exact corners (n, 4, 2) [px]."""
    cam = cam or camera()
    R_WC = geo.exp(rng.normal(0.0, tilt, 3) * [1, 1, 0.3]) @ DOWN
    p_WC = -R_WC[:, 2] + R_WC @ [*rng.uniform(-0.002, 0.002, 2), 0.0]
    image = render_view(
        tag_map, cam, R_WC, p_WC, supersample=supersample, noise_sigma=noise, rng=rng
    )
    pixels, _ = project(cam, (tag_map.corners_W - p_WC) @ R_WC)
    return image, pixels


def errors(det, tag_map, truth):
    rows = tag_map.rows(det.tag_id)
    assert (rows >= 0).all()
    return det.corners_px - truth[rows]


def whole(tag_map, truth, width=640, height=480):
    """Which tags lie in the image with all of their cells; (n,)."""
    centre = truth.mean(axis=1, keepdims=True)
    printed = centre + (truth - centre) * tag_map.family.total_per_border(tag_map.border_bits)
    return ((printed > 1) & (printed < np.array([width, height]) - 2)).all(axis=(1, 2))


def outward(error, truth_quads):
    """Mean error along the diagonals, positive where quads come out too large."""
    ray = truth_quads - truth_quads.mean(axis=1, keepdims=True)
    return float((error * ray / np.linalg.norm(ray, axis=-1, keepdims=True)).sum(-1).mean())


# (library, family, border_bits, side px, least recall, most rms per axis, most bias outward)
CASES = [
    ("apriltag", "tagStandard41h12", 1, 22, 0.98, 0.08, 0.03),
    ("apriltag", "tagStandard41h12", 1, 40, 0.98, 0.07, 0.03),
    ("apriltag", "tag36h11", 1, 45, 0.98, 0.07, 0.03),
    ("apriltag", "tag25h9", 1, 45, 0.98, 0.07, 0.03),
    ("aruco", "tag36h11", 1, 30, 0.98, 0.08, 0.03),
    ("aruco", "tag36h11", 1, 60, 0.98, 0.08, 0.03),
    ("aruco", "tag36h11", 2, 45, 0.95, 0.08, 0.03),
    ("aruco", "DICT_4X4_100", 1, 40, 0.98, 0.08, 0.03),
    ("aruco", "DICT_6X6_250", 1, 40, 0.98, 0.08, 0.03),
]


@pytest.mark.parametrize(("library", "family", "bits", "side", "recall", "rms", "bias"), CASES)
def test_corners_are_the_exact_projections(library, family, bits, side, recall, rms, bias):
    rng = np.random.default_rng(side)
    pitch = 1.5 * side * FAMILIES[family].total_per_border(bits)
    tag_map = board(family, side, int(600 // pitch), int(440 // pitch), rng, bits)
    detector = make_detector(library, tag_map.family, border_bits=bits)
    error, quads, seen, there = [], [], 0, 0
    for _ in range(3):
        image, truth = view(tag_map, rng)
        det = detector.detect(image)
        full = whole(tag_map, truth)
        there += full.sum()
        det = det[full[tag_map.rows(det.tag_id)]]
        seen += len(det)
        error.append(errors(det, tag_map, truth))
        quads.append(truth[tag_map.rows(det.tag_id)])
    e, q = np.concatenate(error), np.concatenate(quads)
    assert seen >= recall * there > 25
    assert np.abs(e.mean(axis=(0, 1))).max() < 0.03  # half a pixel off would be 0.5 here
    assert abs(outward(e, q)) < bias  # OpenCV's own corners: -0.4 to -0.7
    assert np.sqrt(np.square(e).mean()) < rms


@pytest.mark.parametrize(
    ("library", "family", "bits"),
    [
        ("apriltag", "tagStandard41h12", 1),
        ("apriltag", "tagStandard52h13", 1),
        ("apriltag", "tagCircle21h7", 1),
        ("apriltag", "tag36h11", 1),
        ("apriltag", "tag16h5", 1),
        ("aruco", "tag36h11", 1),
        ("aruco", "tag36h11", 2),
        ("aruco", "tag36h10", 1),
        ("aruco", "tag25h9", 1),
        ("aruco", "tag16h5", 1),
        ("aruco", "DICT_5X5_100", 1),
        ("aruco", "DICT_7X7_50", 1),
        ("aruco", "DICT_ARUCO_ORIGINAL", 1),
        ("aruco", "DICT_ARUCO_MIP_36h12", 1),
    ],
)
def test_corner_order_follows_the_tag(library, family, bits):
    rng = np.random.default_rng(4)
    turns = [0.0, np.pi / 2, np.pi, -np.pi / 2]
    tag_map = board(family, 60.0, 2, 2, rng, bits, turns)
    image, truth = view(tag_map, rng, tilt=0.05)
    det = make_detector(library, tag_map.family, border_bits=bits).detect(image)
    assert sorted(det.tag_id) == [0, 1, 2, 3]
    assert np.abs(errors(det, tag_map, truth)).max() < 0.4


def test_corner_order_in_words():
    """Seen upright, the first corner is top left: smallest x, smallest y."""
    tag_map = board("tag36h11", 100.0, 1, 1, np.random.default_rng(0), turns=[0.0])
    image, _ = view(tag_map, np.random.default_rng(0), tilt=0.0)
    for detector in (AprilTagDetector(tag_map.family), ArucoDetector(tag_map.family)):
        (tl, tr, br, bl) = detector.detect(image).corners_px[0]
        assert tl[0] < tr[0] - 50
        assert bl[0] < br[0] - 50
        assert tl[1] < bl[1] - 50
        assert tr[1] < br[1] - 50


@pytest.mark.parametrize("side", [25.0, 45.0])
def test_asked_for_a_coarse_search_small_tags_are_dropped_for_their_corners(side):
    """Only where the detector itself was not told how far to decimate; ArUco's takes no notice."""
    rng = np.random.default_rng(2)
    tag_map = board("tag36h11", side, 3, 2, rng)
    image, _ = view(tag_map, rng)
    library, told = AprilTagDetector(tag_map.family), AprilTagDetector(tag_map.family, 1.5)
    assert len(library.detect(image)) == len(library.detect(image, 1.5)) == 6
    assert len(library.detect(image, 3.0)) == (6 if side > 40.0 else 0)
    assert len(told.detect(image, 3.0)) == 6
    assert len(ArucoDetector(tag_map.family).detect(image, 3.0)) == 6


def test_both_libraries_agree_on_36h11():
    rng = np.random.default_rng(2)
    tag_map = board("tag36h11", 45, 6, 4, rng)
    image, _ = view(tag_map, rng, noise=1.0)
    a, b = (make_detector(lib, tag_map.family).detect(image) for lib in ("apriltag", "aruco"))
    a, b = a[np.argsort(a.tag_id)], b[np.argsort(b.tag_id)]
    assert list(a.tag_id) == list(b.tag_id) == list(range(24))
    assert np.sqrt(np.square(a.corners_px - b.corners_px).mean()) < 0.06
    assert (a.hamming == 0).all()
    assert (b.hamming == 0).all()
    assert (a.margin > 40).all()
    assert (b.margin > 40).all()


@pytest.mark.parametrize("family", [f for f in FAMILIES.values() if f.aruco], ids=lambda f: f.name)
def test_bits_are_read_upright_as_the_bitmap_draws_them(family):
    """The reading table of every dictionary against pictures drawn by another path."""
    ids = [0, family.ids // 2, family.ids - 1]
    table = ArucoDetector(family)._codes.table.reshape(family.ids, 4, -1)
    drawn = np.array([tag_bitmap(family, i)[2:-2, 2:-2] > 0 for i in ids], dtype=np.uint8)
    assert_allclose(table[ids], codes(drawn).table.reshape(len(ids), 4, -1))


def test_a_square_is_read_from_any_corner():
    """Squares that OpenCV turned down start at any corner: reading finds which is top left."""
    rng = np.random.default_rng(9)
    tag_map = board("tag36h11", 60.0, 2, 2, rng, turns=[0.0, 0.6, 2.0, 4.0])
    image, truth = view(tag_map, rng)
    table = ArucoDetector(tag_map.family)._codes
    for turn in range(4):
        squares = np.roll(truth, turn, axis=1)
        read = read_bits(image, squares, table, 1)
        assert read.ok.all()
        assert read.tag_id.tolist() == [0, 1, 2, 3]
        assert read.errors.tolist() == [0] * 4
        assert_allclose(upright(squares, read.turns), truth)


def test_aruco_tells_corrected_bits():
    rng = np.random.default_rng(8)
    tag_map = board("tag36h11", 100.0, 1, 1, rng, turns=[0.0])
    image, truth = view(tag_map, rng, tilt=0.0, noise=0.0)
    x, y = np.rint(truth[0].mean(axis=0) + 12.5 / 2).astype(int)  # centre of one data cell
    image[y - 5 : y + 6, x - 5 : x + 6] = 250 - image[y - 5 : y + 6, x - 5 : x + 6]
    assert ArucoDetector(tag_map.family, max_hamming=1).detect(image).hamming.tolist() == [1]
    assert len(ArucoDetector(tag_map.family, max_hamming=0).detect(image)) == 0


def test_nothing_is_found_in_noise():
    rng = np.random.default_rng(6)
    for name in ("tagStandard41h12", "tag36h11", "DICT_4X4_1000"):
        detector = make_detector("auto", FAMILIES[name])
        for scale in (1, 8):
            small = rng.integers(0, 256, (480 // scale, 640 // scale), dtype=np.uint8)
            image = np.kron(small, np.ones((scale, scale), dtype=np.uint8))
            assert len(detector.detect(image)) == 0


@pytest.fixture(scope="module", params=["apriltag", "aruco"])
def any_detector(request):
    return make_detector(request.param, FAMILIES["tag36h11"])


@pytest.mark.parametrize("height", [0, 1, 2, 3, 4, 5, 7, 8, 9, 12])
@pytest.mark.parametrize("width", [0, 1, 3, 5, 8, 9, 640])
def test_tiny_images_give_nothing(any_detector, height, width):
    """The AprilTag library crashes the process below some pixels: it must not be asked."""
    rng = np.random.default_rng(1)
    for shape in ((height, width), (width, height)):
        assert len(any_detector.detect(rng.integers(0, 256, shape, dtype=np.uint8))) == 0
        assert len(any_detector.detect(np.zeros((*shape, 3), dtype=np.uint8))) == 0


@pytest.mark.parametrize("decimate", [1, 1.5, 2, 3, 8])
def test_small_images_never_crash_at_any_decimation(decimate):
    detector = AprilTagDetector(FAMILIES["tag36h11"], decimate)
    for side in range(1, 48):
        detector.detect(np.zeros((side, 64), dtype=np.uint8))
        detector.detect(np.full((64, side), 9, dtype=np.uint8))


def test_memory_layout_and_colour_make_no_difference(any_detector):
    rng = np.random.default_rng(3)
    tag_map = board("tag36h11", 45, 3, 2, rng)
    image, _ = view(tag_map, rng)
    want = any_detector.detect(image)
    assert len(want) == 6
    strided = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)[::2, ::2]
    layouts = {
        "fortran": np.asfortranarray(image),
        "strided": strided,
        "reversed": image[::-1].copy()[::-1],
        "one channel": image[..., None],
        "bgr": np.repeat(image[..., None], 3, axis=2),
    }
    for name, same in layouts.items():
        assert_allclose(any_detector.detect(same).corners_px, want.corners_px, err_msg=name)


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((48, 64)),
        np.zeros((48, 64), dtype=np.uint16),
        np.zeros((48, 64, 4), dtype=np.uint8),
        np.zeros((2, 48, 64, 3), dtype=np.uint8),
        np.zeros(64, dtype=np.uint8),
        None,
        [[0, 1], [2, 3]],
    ],
)
def test_other_images_are_refused_with_what_is_needed(any_detector, image):
    with pytest.raises(DetectorError, match=r"image: .* is needed"):
        any_detector.detect(image)


def test_auto_takes_the_library_that_reads_the_family():
    def kind(name, bits=1, library="auto"):
        return type(make_detector(library, FAMILIES[name], border_bits=bits))

    assert kind("tagStandard41h12") is AprilTagDetector
    assert kind("tag36h11") is AprilTagDetector
    assert kind("tag36h11", bits=2) is ArucoDetector
    assert kind("DICT_4X4_50") is ArucoDetector
    assert kind("tag36h11", library="aruco") is ArucoDetector
    assert (decimate_for(640), decimate_for(752), decimate_for(1280)) == (1.5, 1.5, 2.0)


@pytest.mark.parametrize(
    ("library", "family", "options", "text"),
    [
        ("opencv", "tag36h11", {}, "detector library: unknown 'opencv'; choose one of auto, "),
        ("apriltag", "DICT_4X4_50", {}, "does not read DICT_4X4_50; it reads tagStandard41h12, "),
        ("aruco", "tagStandard41h12", {}, "does not read tagStandard41h12; it reads tag36h11, "),
        ("auto", "tagStandard41h12", {"border_bits": 2}, "does not read tagStandard41h12"),
        ("apriltag", "tag36h11", {"border_bits": 2}, "border_bits 2; .* reads 1 only"),
        ("apriltag", "tag36h11", {"decimate": 1.75}, "decimate: 1.75; choose one of 1, 1.5, 2"),
        ("apriltag", "tag36h11", {"max_hamming": 3}, "maxhamming: 3; 0, 1 or 2"),
        ("aruco", "tag36h11", {"border_bits": 0}, "border_bits: 0; at least 1"),
    ],
)
def test_what_cannot_be_had_is_said(library, family, options, text):
    with pytest.raises(DetectorError, match=text):
        make_detector(library, FAMILIES[family], **options)


@pytest.mark.parametrize(
    ("library", "module", "package"),
    [
        ("apriltag", "apriltag", "pip install apriltag-python"),
        ("aruco", "cv2", "pip install opencv-contrib-python-headless"),
    ],
)
def test_a_missing_library_says_what_to_install(monkeypatch, library, module, package):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DetectorError, match=package):
        make_detector(library, FAMILIES["tag36h11"])


def test_a_missing_library_is_no_matter_to_the_other(monkeypatch):
    monkeypatch.setitem(sys.modules, "apriltag", None)
    make_detector("auto", FAMILIES["tag36h11"], border_bits=2)
