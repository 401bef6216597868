"""Printed maps, rendered back to pixels by another engine: ids, sizes, places, rulers, joints.

The bar is 0.1 mm everywhere, measured from detected corners, crop marks and what pages say of
themselves, not from the layout that drew them.
"""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scans import crop_corner, detect, image_objects, line_at, mosaic, pages

from tagvo import geometry as geo
from tagvo.errors import MapError
from tagvo.maps.design.plan import MapWish, lay_out, plan_map
from tagvo.maps.design.search import Found
from tagvo.maps.printing import draw_print, plan_print
from tagvo.maps.printing.cutting import LONGEST, PAPERS, Paper
from tagvo.tags.bitmaps import tag_bitmap
from tagvo.tags.tag_map import map_from_dict, map_to_dict

BAR_MM = 0.1
NEAR = np.array([16.0, 31.0])  # the cut corner of a sheet: margin, marks, overlap; and the footer


def paper(name, **keys):
    return Paper(name, *PAPERS[name], **keys)


def roll(width, **keys):
    return Paper(f"roll {width}", width, LONGEST, roll=True, **keys)


def floor_of(seed=11, **wish):
    """A floor by chance."""
    rng = np.random.default_rng(seed)
    wanted = MapWish(**wish)
    plan, placed = plan_map(wanted, rng)
    return lay_out(wanted, plan, Found(placed, rng.integers(4, size=plan.repeats), 0, 0), rng)


@pytest.fixture(scope="module")
def floor():
    return floor_of(size=(1.3, 1.9))


def printed(tag_map, path, sheet_paper, **keys):
    """Write a PDF; what was planned."""
    index = keys.pop("index", True)
    ready = plan_print(tag_map, sheet_paper, title="floor", **keys)
    draw_print(ready, path, index=index)
    return ready


def border_corners(tag_map):
    """Border corners TL, TR, BR, BL of each id in the map's x, y [mm]."""
    return dict(zip(tag_map.tag_id.tolist(), 1e3 * tag_map.corners_W[..., :2], strict=True))


def worst_corner(page, tag_map, corner):
    """Largest error [mm] of the detected corners of a page whose cut corner is known, and ids."""
    ids, px = detect(page.image, tag_map.family.name)
    truth = border_corners(tag_map)
    in_W = page.mm(px) - corner + page.cut_corner
    errors = [np.linalg.norm(c - truth[i], axis=-1).max() for i, c in zip(ids, in_W, strict=True)]
    return max(errors), ids.tolist()


def whole_tags(tag_map, sheet):
    """Ids whose print lies wholly on a sheet."""
    half = 0.5 * tag_map.total_size[:, None]
    low, high = sheet.window
    p = tag_map.p_WT[:, :2]
    inside = (p - half >= low) & (p + half <= high)
    return set(tag_map.tag_id[inside.all(axis=1)].tolist())


@pytest.mark.parametrize(
    ("sheet_paper", "dpi"),
    [
        (paper("A4"), 120),
        (paper("A4", turn="landscape", margin=0.008, overlap=0.003), 120),
        (paper("A0"), 80),
        (roll(0.914), 80),
        (roll(0.610, turn="landscape"), 80),
    ],
    ids=["A4", "A4-landscape", "A0", "roll", "roll-landscape"],
)
def test_tags_on_a_sheet_have_their_ids_sizes_and_places_to_a_tenth_of_a_mm(
    floor, tmp_path, sheet_paper, dpi
):
    ready = printed(floor, tmp_path / "p.pdf", sheet_paper)
    sheets = ready.drawings[0].sheets.sheets
    some = [i + 1 for i, sheet in enumerate(sheets) if whole_tags(floor, sheet)][-3:]
    near = 1e3 * (sheet_paper.margin + sheet_paper.overlap) + np.array([6.0, 21.0])
    seen = 0
    for number, page in zip(some, pages(tmp_path / "p.pdf", dpi, some), strict=True):
        sheet = sheets[number - 1]
        np.testing.assert_allclose(page.size, 1e3 * np.array(sheet.paper), atol=0.01)
        corner = crop_corner(page, near, 1e3 * sheet_paper.overlap)
        np.testing.assert_allclose(corner, near, atol=BAR_MM / 2)
        whole = whole_tags(floor, sheet)
        error, ids = worst_corner(page, floor, corner)
        assert whole <= set(ids)
        assert error < BAR_MM
        seen += len(whole)
    assert seen >= 3


@pytest.mark.parametrize("name", ["A4", "A0"])
def test_both_rulers_are_100_mm_long_and_ticks_1_mm_apart(floor, tmp_path, name):
    printed(floor, tmp_path / "p.pdf", paper(name))
    (page,) = pages(tmp_path / "p.pdf", 200, [1])
    across = [line_at(page, (x - 0.45, 12.2), (x + 0.45, 14.2), True) for x in (6.0, 106.0)]
    assert across[1] - across[0] == pytest.approx(100.0, abs=0.02)
    ticks = [line_at(page, (x - 0.45, 11.7), (x + 0.45, 12.5), True) for x in 6.0 + np.arange(101)]
    np.testing.assert_allclose(np.diff(ticks), 1.0, atol=0.05)
    up = [line_at(page, (5.4, y - 0.45), (7.0, y + 0.45), False) for y in (41.0, 141.0)]
    assert up[1] - up[0] == pytest.approx(100.0, abs=0.02)


def test_sheets_cut_at_their_marks_and_laid_side_by_side_give_the_whole_map(floor, tmp_path):
    ready = printed(floor, tmp_path / "p.pdf", paper("A2"))
    sheets, dpi = ready.drawings[0].sheets, 72
    scans = pages(tmp_path / "p.pdf", dpi)[1:]
    assert len(scans) == len(sheets.sheets) >= 12
    parts = []
    for page, sheet in zip(scans, sheets.sheets, strict=True):
        end = NEAR + 1e3 * (sheet.high - sheet.low)
        parts.append(
            (page, crop_corner(page, NEAR, 5.0), crop_corner(page, end, 5.0, False, False))
        )
        np.testing.assert_allclose(parts[-1][2], end, atol=BAR_MM / 2)
    low, high = (1e3 * np.array([c[k] for c in sheets.cuts]) for k in (0, -1))
    picture = mosaic(parts, low, high, dpi)
    ids, px = detect(picture)
    assert set(ids.tolist()) == set(floor.tag_id.tolist())  # cut ones among them
    assert ready.cut >= 5
    truth, scale = border_corners(floor), 25.4 / dpi
    for tag_id, corners in zip(ids.tolist(), px, strict=True):
        in_W = np.stack([low[0] + scale * (corners[:, 0] + 0.5),
                         high[1] - scale * (corners[:, 1] + 0.5)], axis=-1)  # fmt: skip
        assert np.linalg.norm(in_W - truth[tag_id], axis=-1).max() < BAR_MM, tag_id


def test_neighbours_share_their_overlap(floor, tmp_path):
    ready = printed(floor, tmp_path / "p.pdf", paper("A3", overlap=0.01, turn="portrait"))
    sheets = ready.drawings[0].sheets.sheets
    left, right = sheets[0], sheets[1]
    assert (left.row, left.column + 1) == (right.row, right.column)
    a, b = pages(tmp_path / "p.pdf", 254, [1, 2])  # ten pixels a mm
    cut_a = 21.0 + 1e3 * (left.high[0] - left.low[0])  # where the shared line lies on each
    strip_a, first_a = a.window((cut_a - 9.5, 40.0), (cut_a + 9.5, 330.0))
    strip_b, first_b = b.window((21.0 - 9.5, 40.0), (21.0 + 9.5, 330.0))
    assert strip_a.shape == strip_b.shape
    shift = (first_a - cut_a * np.array([1, 0])) - (first_b - 21.0 * np.array([1, 0]))
    assert np.abs(shift).max() < 0.1  # the two windows differ by less than a pixel
    assert strip_a.mean() > 0.2
    edges = np.abs(strip_a - strip_b) > 0.5
    assert edges.mean() < 0.01  # pixels that an edge runs through


def test_black_cells_are_joined_without_a_hairline(tmp_path):
    """A turned tag, whose cells' edges run through pixels: between black cells all stays black."""
    q = [float(np.cos(0.2)), 0.0, 0.0, float(np.sin(0.2))]
    tags = [{"id": 137, "size": 0.0575, "p": [0.0, 0.0, 0.0], "q": q}]
    one = map_from_dict({"family": "tagStandard41h12", "tags": tags}, "one")
    printed(one, tmp_path / "p.pdf", paper("A4"), index=False, numbers=False)
    black = tag_bitmap(one.family, 137) == 0
    for dpi in (70, 97, 150):
        (page,) = pages(tmp_path / "p.pdf", dpi)
        _, px = detect(page.image)
        right, down = (px[0, 1] - px[0, 0]) / 5, (px[0, 3] - px[0, 0]) / 5  # a cell
        first = px[0, 0] - 2 * (right + down)  # of the print, two cells out from the border
        seams = [(c + 1.0, r + t) for r, c in np.argwhere(black[:, :-1] & black[:, 1:])
                 for t in np.linspace(0.3, 0.7, 9)]  # fmt: skip
        seams += [(c + t, r + 1.0) for r, c in np.argwhere(black[:-1] & black[1:])
                  for t in np.linspace(0.3, 0.7, 9)]  # fmt: skip
        at = np.rint(first + np.array(seams) @ np.stack([right, down])).astype(int)
        assert len(at) > 300
        assert page.image[at[:, 1], at[:, 0]].max() < 8


def test_a_page_holds_no_raster_image(floor, tmp_path):
    printed(floor, tmp_path / "p.pdf", paper("A1"))
    assert image_objects(tmp_path / "p.pdf") == 0


def test_numbers_stand_beside_tags_and_never_in_them(floor, tmp_path):
    ready = printed(floor, tmp_path / "with.pdf", paper("A1"))
    bare = replace(ready, drawings=(replace(ready.drawings[0], numbers=()),))
    draw_print(bare, tmp_path / "without.pdf")
    assert ready.without_number == ()
    changed = 0
    for with_, without in zip(
        pages(tmp_path / "with.pdf", 100)[1:], pages(tmp_path / "without.pdf", 100)[1:], strict=True
    ):
        rows, columns = np.nonzero(np.abs(with_.image.astype(int) - without.image) > 40)
        mm = with_.mm(np.stack([columns, rows], axis=-1)) - NEAR + with_.cut_corner
        half = 500.0 * floor.total_size
        apart = np.abs(mm[:, None] - 1e3 * floor.p_WT[None, :, :2]).max(axis=-1) - half
        assert (apart.min(axis=1) > 0.1).all()
        changed += len(mm)
    assert changed > 1000
    text = " ".join(p.text for p in pages(tmp_path / "with.pdf", 20)[1:])
    assert all(str(i) in text for i in floor.tag_id)


def test_a_map_without_white_says_whose_numbers_have_no_room():
    packed = floor_of(size=(1.0, 1.0), sizes=(0.115, 0.0575), shares=(1, 1), quiet_zone=0.0)
    ready = plan_print(packed, paper("A4"))
    numbered = {int(packed.tag_id[n.row]) for n in ready.drawings[0].numbers}
    assert len(ready.without_number) > 20
    assert numbered | set(ready.without_number) == set(packed.tag_id.tolist())
    assert numbered.isdisjoint(ready.without_number)


def test_the_index_names_every_sheet_with_its_page(floor, tmp_path):
    ready = printed(floor, tmp_path / "p.pdf", paper("A3"))
    index, *rest = pages(tmp_path / "p.pdf", 20)
    np.testing.assert_allclose(index.size, [210.0, 297.0], atol=0.01)
    words = index.text.split()
    for i, (sheet, page) in enumerate(zip(ready.drawings[0].sheets.sheets, rest, strict=True)):
        assert sheet.name in words
        assert f"p. {i + 2}" in index.text
        assert f"Sheet {sheet.name} · page {i + 2} of {len(rest) + 1}" in page.text
        np.testing.assert_allclose(page.cut_corner, 1e3 * sheet.low, atol=0.051)
    assert "460 mm" in index.text
    assert "x in W [m]" in index.text


def walls(tag_map):
    """The floor's first four tags, two of them moved onto a wall."""
    few = tag_map.only(tag_map.tag_id[-4:])
    R_WT, p_WT = few.R_WT.copy(), few.p_WT.copy()
    R_WT[2:] = geo.matrix_from_rpy(0.5 * np.pi, 0.0, 0.3)
    p_WT[2:, 2] = 1.0
    return replace(few, R_WT=R_WT, p_WT=p_WT)


def test_tags_that_share_no_plane_are_refused_or_printed_one_by_one(floor, tmp_path):
    mixed = walls(floor)
    with pytest.raises(
        MapError, match=r"tags \d+ and \d+ do not share one plane.*90.0 deg.*--each"
    ):
        plan_print(mixed, paper("A4"))
    apart = replace(mixed, R_WT=np.tile(np.eye(3), (4, 1, 1)))
    with pytest.raises(MapError, match="1000 mm apart"):
        plan_print(apart, paper("A4"))
    ready = printed(mixed, tmp_path / "e.pdf", paper("A4"), each=True)
    index, *sheets = pages(tmp_path / "e.pdf", 110)
    assert len(sheets) == ready.sheets == 4
    for i, (tag_id, page) in enumerate(zip(mixed.tag_id.tolist(), sheets, strict=True)):
        ids, px = detect(page.image)
        assert ids.tolist() == [tag_id]
        sides = np.linalg.norm(np.diff(page.mm(px[0]), axis=0), axis=-1)
        np.testing.assert_allclose(sides, 57.5, atol=BAR_MM)
        assert np.all(page.mm(px[0])[0] < page.mm(px[0])[1] + [0, 1])  # TL left of TR: upright
        assert f"Tag {tag_id} · page {i + 2} of 5" in page.text
        assert f"tag {tag_id}, 57.5 mm: p. {i + 2}" in index.text


def test_a_tag_larger_than_a_sheet_takes_several(floor):
    ready = plan_print(floor.only(floor.tag_id[:1]), paper("A3"), each=True)
    assert ready.sheets >= 6
    assert ready.cut == 1


def test_a_wall_is_printed_as_it_is_seen_from_the_front(tmp_path):
    """Facing -y, W's x to the right and z up; places are read back from page text in W."""
    R = geo.matrix_from_rpy(0.5 * np.pi, 0.0, 0.0)  # T's z along -y
    q = geo.quat_from_matrix(R).tolist()
    tags = [{"id": i, "size": 0.05, "p": [0.3 + 0.12 * i, 2.0, 1.1 + 0.05 * i], "q": q}
            for i in range(2)]  # fmt: skip
    wall = map_from_dict({"family": "tag36h11", "tags": tags}, "wall")
    printed(wall, tmp_path / "w.pdf", paper("A3"), index=False)
    (page,) = pages(tmp_path / "w.pdf", 120)
    ids, px = detect(page.image, "tag36h11")
    order = np.argsort(ids)
    assert ids[order].tolist() == [0, 1]
    first, second = page.mm(px[order]).mean(axis=1)
    np.testing.assert_allclose(second - first, [120.0, 50.0], atol=BAR_MM)
    assert "z 1." in page.text


@pytest.mark.parametrize(
    ("family", "bits"), [("tag36h11", 1), ("tag25h9", 1), ("tagCircle21h7", 1), ("tag36h11", 2)]
)
def test_other_families_print_at_their_size_too(tmp_path, family, bits):
    turns = [[1, 0, 0, 0], [0.9659258, 0, 0, 0.258819]]  # the second turned by 30 degrees
    tags = [{"id": i, "size": 0.06, "p": [0.15 * i, 0.01 * i, 0.0], "q": q}
            for i, q in enumerate(turns)]  # fmt: skip
    some = map_from_dict({"family": family, "border_bits": bits, "tags": tags}, "some")
    printed(some, tmp_path / "s.pdf", paper("A3"), index=False)
    (page,) = pages(tmp_path / "s.pdf", 150)
    if bits == 2:
        from tagvo.detect.aruco import ArucoDetector

        found = ArucoDetector(some.family, border_bits=2).detect(page.image)
        ids, px, bar = found.tag_id, found.corners_px, 0.25  # it is no better than half a pixel
    else:
        ids, px = detect(page.image, family)
        bar = BAR_MM
    assert sorted(ids.tolist()) == [0, 1]
    mm = page.mm(px[np.argsort(ids)])
    mm += border_corners(some)[0].mean(axis=0) - mm[0].mean(axis=0)
    for tag_id in (0, 1):
        assert np.linalg.norm(mm[tag_id] - border_corners(some)[tag_id], axis=-1).max() < bar


def test_some_tags_alone_keep_their_distances(floor, tmp_path):
    few = floor.only(floor.tag_id[[-1, -2, -14]])
    printed(few, tmp_path / "f.pdf", paper("A0"), index=False)
    (page,) = pages(tmp_path / "f.pdf", 100)
    ids, px = detect(page.image)
    assert sorted(ids.tolist()) == sorted(few.tag_id.tolist())
    truth = border_corners(few)
    moved = [page.mm(c) - truth[i] for i, c in zip(ids.tolist(), px, strict=True)]
    assert np.ptp(np.concatenate(moved), axis=0).max() < BAR_MM


def test_a_slightly_uneven_floor_is_printed_flat_and_says_so(floor):
    p_WT = floor.p_WT.copy()
    p_WT[0, 2] = 0.008
    ready = plan_print(replace(floor, p_WT=p_WT), paper("A0"))
    assert ready.flattened == pytest.approx(0.008, abs=3e-4)


def test_the_same_map_gives_the_same_bytes(floor, tmp_path):
    for name in ("a.pdf", "b.pdf"):
        printed(floor, tmp_path / name, paper("A1"))
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_a_print_that_fails_leaves_the_old_file(floor, tmp_path):
    path = tmp_path / "p.pdf"
    path.write_bytes(b"old")
    ready = plan_print(floor, paper("A1"))

    def step():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_print(ready, path, step=step)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_title_of_other_letters_prints(floor, tmp_path):
    ready = plan_print(floor, paper("A0"), title="Halle Süd 地図")
    draw_print(ready, tmp_path / "t.pdf")
    assert "Halle Süd ??" in pages(tmp_path / "t.pdf", 20, [0])[0].text


def test_without_reportlab_the_error_says_what_to_install(floor, monkeypatch):
    for name in [n for n in sys.modules if n.startswith("reportlab")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "reportlab", None)
    with pytest.raises(MapError, match=r"needs reportlab.*pip install 'tagvio\[print\]'"):
        plan_print(floor, paper("A4"))


@pytest.mark.parametrize(
    "sheet_paper", [paper("A4", margin=0.09), paper("A4", overlap=0.2), roll(0.06)]
)
def test_paper_without_room_is_refused(floor, sheet_paper):
    with pytest.raises(MapError, match=r"leave no room; \d+ x \d+ mm do"):
        plan_print(floor, sheet_paper)


def test_the_map_is_not_changed_by_printing(floor):
    before = map_to_dict(floor)
    plan_print(floor, paper("A3"), each=True)
    assert map_to_dict(floor) == before
