"""A drawn map is a picture that says what the map says: ids, sizes, axes, on every kind of map."""

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.errors import MapError
from tagvo.maps.draw.page import draw_map
from tagvo.maps.draw.views import corner_view, frontal_view, nice_step, surfaces_of
from tagvo.tags.tag_map import TagMap, map_from_dict

FLOOR = (1.0, 0.0, 0.0, 0.0)
FACING_MINUS_Y = tuple(geo.quat_from_matrix(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])))
FACING_PLUS_X = tuple(geo.quat_from_matrix(np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])))
CEILING = (0.0, 1.0, 0.0, 0.0)


def hall(*quaternions: tuple[float, ...], sizes: tuple[float, ...] = (0.1, 0.2)) -> TagMap:
    tags = []
    for k, q in enumerate(quaternions):
        R_WT = geo.matrix_from_quat(np.array(q))
        for i, size in enumerate(sizes):
            p = R_WT @ [0.5 * i, 0.1 * i, 2.0]
            tags.append({"id": 100 * k + i, "size": size, "p": p.tolist(), "q": list(q)})
    return map_from_dict({"family": "tag36h11", "tags": tags}, "hall/tagmap.yaml")


MAPS = {
    "floor": hall(FLOOR),
    "wall": hall(FACING_MINUS_Y),
    "ceiling": hall(CEILING),
    "one tag": hall(FLOOR, sizes=(0.1,)),
    "room": hall(FLOOR, FACING_MINUS_Y, FACING_PLUS_X),
    "many classes": hall(FLOOR, sizes=tuple(0.02 * 1.3**i for i in range(8))),
    "slope": hall((0.96, 0.28, 0.0, 0.0)),
}


@pytest.mark.parametrize("name", MAPS)
def test_png_is_a_picture_with_ink_of_each_axis(name, tmp_path):
    path = tmp_path / "map.png"
    draw_map(MAPS[name], path)
    image = cv2.imread(str(path))
    assert image is not None
    assert min(image.shape[:2]) > 200
    for red, green, blue in ((0xD0, 0x31, 0x2D), (0x1A, 0x96, 0x41)):
        near = np.abs(image.astype(int) - [blue, green, red]).max(axis=2) < 8
        assert near.sum() > 20


@pytest.mark.parametrize("name", MAPS)
def test_svg_names_every_tag_and_every_class(name, tmp_path):
    path = tmp_path / "map.svg"
    tag_map = MAPS[name]
    draw_map(tag_map, path, title="Hall 2")
    words = [
        element.text or "" for element in ET.parse(path).iter() if element.tag.endswith("text")
    ]
    assert any(word.startswith("Hall 2 ") for word in words)
    assert {str(i) for i in tag_map.tag_id} <= {word.strip() for word in words}
    for border, total in zip(tag_map.classes, tag_map.classes * 1.25, strict=True):
        legend = f"{1e3 * border:.4g} mm border, {1e3 * total:.4g} mm total"
        assert any(legend in word for word in words), legend


def test_svg_of_one_map_is_the_same_twice(tmp_path):
    for name in ("a.svg", "b.svg"):
        draw_map(MAPS["room"], tmp_path / name)
    first, second = ((tmp_path / name).read_text() for name in ("a.svg", "b.svg"))
    assert re.sub(r"<dc:date>.*?</dc:date>", "", first) == second


def test_other_suffixes_are_refused(tmp_path):
    with pytest.raises(MapError, match=r"'\.pdf'; a name in \.png or \.svg"):
        draw_map(MAPS["floor"], tmp_path / "map.pdf")


def test_surfaces_are_told_apart():
    assert [len(rows) for rows in surfaces_of(MAPS["room"])] == [2, 2, 2]
    assert [len(rows) for rows in surfaces_of(MAPS["wall"])] == [2]


@pytest.mark.parametrize(
    ("name", "right", "up"),  # a wall facing -y is seen by who looks along +y, x to the right
    [
        ("floor", (1, 0, 0), (0, 1, 0)),
        ("wall", (1, 0, 0), (0, 0, 1)),
        ("ceiling", (-1, 0, 0), (0, 1, 0)),
    ],
)
def test_frontal_view_is_what_an_onlooker_sees(name, right, up):
    view = frontal_view(MAPS[name], np.arange(2))
    assert_allclose(view.page, [right, up], atol=1e-12)
    assert [sign for _, sign in view.labels] == [sum(right), sum(up)]


def test_tags_keep_their_hand_in_every_frontal_view():
    for tag_map in MAPS.values():
        for rows in surfaces_of(tag_map):
            page = frontal_view(tag_map, rows).project(tag_map.corners_W[rows])
            top, side = page[:, 1] - page[:, 0], page[:, 3] - page[:, 0]
            turn = top[:, 0] * side[:, 1] - top[:, 1] * side[:, 0]
            assert (turn < 0).all()  # TL, TR, BR, BL run clockwise, as printed: not mirrored


def test_corner_view_is_a_rotation_with_z_up():
    view = corner_view()
    R = np.vstack([view.page, view.towards])
    assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    assert view.project(np.array([0.0, 0.0, 1.0]))[1] > 0.5


@pytest.mark.parametrize(("extent", "step"), [(0.7, 0.1), (5.0, 1.0), (8.0, 1.0), (12.0, 2.0)])
def test_grid_steps_are_round(extent, step):
    assert nice_step(extent) == pytest.approx(step)


def test_matplotlib_is_imported_late():
    code = (
        "import sys, tagvo.maps.draw.page, tagvo.maps.formats;"
        " assert 'matplotlib' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[3])
