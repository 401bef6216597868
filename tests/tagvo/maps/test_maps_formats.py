"""Other people's maps: round trips of what each format holds, and axes against known corners."""

import json
import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tagvo import geometry as geo
from tagvo.errors import MapError
from tagvo.maps.formats import FORMATS, read_map_file, write_map_file
from tagvo.maps.formats.common import HOLDABLE
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import Gravity, TagMap, load_map, save_map

DATA = os.environ.get("TAGVIO_DATA")
POSED = [name for name in FORMATS if name not in ("kalibr", "apriltag_ros2")]
SIZE = 0.16


def random_map(seed: int, family: str = "tag36h11") -> TagMap:
    """A map of 1 to 6 tags anywhere, some at the hard places: identity, half turns, gimbal lock."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 7))
    phi = rng.normal(size=(n, 3)) * rng.choice([0.0, 1e-6, 1.0, 3.0], size=(n, 1))
    R_WT = geo.exp(phi)
    R_WT[0] = geo.matrix_from_rpy(*rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi], size=3))
    return TagMap(
        FAMILIES[family],
        "border",
        int(rng.integers(1, 3)),
        rng.permutation(FAMILIES[family].ids)[:n],
        rng.choice([0.05, 0.1, SIZE, 0.23], size=n),
        rng.uniform(-20, 20, size=(n, 3)),
        R_WT,
        rng.uniform(1e-4, 0.02, size=(n, 4)),
        gravity=Gravity((0.0, 0.0, -1.0), 1.0) if seed % 2 else None,
    )


SEEDS = st.integers(0, 2**32 - 1)
PROPERTY = settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def round_trip(tag_map: TagMap, fmt: str, folder: Path, **options: object) -> TagMap:
    path = folder / "map.txt"
    write_map_file(tag_map, path, fmt)
    return read_map_file(path, **options).tag_map  # type: ignore[arg-type]


@pytest.mark.parametrize("fmt", POSED)
@PROPERTY
@given(seed=SEEDS)
def test_round_trip_keeps_what_the_format_holds(fmt, seed, tmp_path):
    before, holds = random_map(seed), FORMATS[fmt].holds
    if "size" not in holds:
        before = replace(before, size=np.full(len(before), SIZE))
    family = None if "family" in holds else before.family.name
    size = None if "size" in holds else SIZE
    after = round_trip(before, fmt, tmp_path, size=size, family=family)
    assert_allclose(after.tag_id, before.tag_id)
    assert after.family == before.family
    assert_allclose(after.p_WT, before.p_WT, atol=2e-9)
    assert_allclose(after.R_WT, before.R_WT, atol=5e-7)
    assert_allclose(after.size, before.size, atol=2e-9)
    if "sigma" in holds:
        assert_allclose(after.sigma, before.sigma, atol=2e-9)
    if "border_bits" in holds:
        assert after.border_bits == before.border_bits
    if "gravity" in holds:
        assert after.gravity == before.gravity


@PROPERTY
@given(columns=st.integers(1, 24), rows=st.integers(2, 24), spacing=st.floats(0.05, 1.0))
def test_kalibr_round_trip(columns, rows, spacing, tmp_path):
    target = {"target_type": "aprilgrid", "tagCols": columns, "tagRows": rows}
    path = tmp_path / "target.yaml"
    path.write_text(json.dumps(target | {"tagSize": 0.088, "tagSpacing": spacing}))
    board = read_map_file(path).tag_map
    after = round_trip(board, "kalibr", tmp_path)
    assert_allclose(after.corners_W, board.corners_W, atol=1e-8)
    assert len(after) == rows * columns
    assert after.border_bits == 2


@PROPERTY
@given(seed=SEEDS)
def test_ros2_round_trip_of_sizes_over_a_layout(seed, tmp_path):
    before = random_map(seed)
    layout = tmp_path / "layout.yaml"
    save_map(replace(before, size=np.full(len(before), 1.0)), layout)
    after = round_trip(before, "apriltag_ros2", tmp_path, layout=layout)
    assert_allclose(after.size, before.size, atol=2e-9)
    assert_allclose(after.p_WT, before.p_WT, atol=2e-9)
    assert after.family == before.family


@pytest.mark.parametrize("fmt", FORMATS)
def test_losses_name_what_is_there_and_not_held(fmt, tmp_path):
    board = replace(grid_map(), gravity=Gravity((0.0, 0.0, -1.0), 1.0))
    lost = " / ".join(write_map_file(board, tmp_path / "m", fmt))
    words = {"pose": "no poses", "size": "no sizes", "gravity": "no gravity"}
    for thing in HOLDABLE:
        word = words.get(thing, f"no {thing}")
        assert (word in lost) == (thing not in FORMATS[fmt].holds), (thing, lost)


def test_sound_map_written_as_its_own_format_loses_nothing(tmp_path):
    assert write_map_file(random_map(5), tmp_path / "m.yaml", "tagmap") == []


def grid_map() -> TagMap:
    n = 6
    i, j = np.arange(n) % 3, np.arange(n) // 3
    p_WT = np.stack([0.05 + 0.13 * i, 0.05 + 0.13 * j, 0.0 * i], axis=-1)
    R_WT, sigma = np.tile(np.eye(3), (n, 1, 1)), np.full((n, 4), 1e-3)
    family = FAMILIES["tag36h11"]
    return TagMap(family, "border", 2, np.arange(n), np.full(n, 0.1), p_WT, R_WT, sigma)


# ---- axes: corners TL, TR, BR, BL worked out by hand from what each project says of its tags


def corners_seen(centre, right, up, size):
    """Corners of a tag from what its onlooker calls right and up."""
    c, r, u = (np.asarray(v, dtype=float) for v in (centre, right, up))
    h = size / 2.0
    return np.stack([c - h * r + h * u, c + h * r + h * u, c + h * r - h * u, c - h * r - h * u])


def frc_tag(tag_id, x, y, z, qw, qz):
    quaternion = {"W": qw, "X": 0.0, "Y": 0.0, "Z": qz}
    pose = {"translation": {"x": x, "y": y, "z": z}, "rotation": {"quaternion": quaternion}}
    return {"ID": tag_id, "pose": pose}


# Crescendo 2024: 3 faces -x (yaw 180 deg), 7 faces +x (0), 5 faces -y (270), 1 faces 120 deg
CRESCENDO = {
    3: ((16.579342, 4.982718, 1.451102), 6.123233995736766e-17, 1.0, (0, -1, 0)),
    7: ((-0.0381, 5.547868, 1.451102), 1.0, 0.0, (0, 1, 0)),
    5: ((14.700758, 8.2042, 1.355852), -0.7071067811865475, 0.7071067811865476, (1, 0, 0)),
    1: ((15.079472, 0.245872, 1.355852), 0.5, 0.8660254037844386, (-np.sqrt(0.75), -0.5, 0)),
}


@pytest.mark.parametrize("keys", [("tags", "field"), ("field-tags", "field-dimensions")])
def test_wpilib_tags_stand_upright_and_face_where_frc_says(keys, tmp_path):
    tags = [frc_tag(i, *p, qw, qz) for i, (p, qw, qz, _) in CRESCENDO.items()]
    path = tmp_path / "2024-crescendo.json"
    path.write_text(json.dumps({keys[0]: tags, keys[1]: {"length": 16.451, "width": 8.211}}))
    tag_map = read_map_file(path, size=0.1651).tag_map
    assert tag_map.family.name == "tag36h11"
    for row, (p, _, _, right) in enumerate(CRESCENDO.values()):
        expected = corners_seen(p, right, (0, 0, 1), 0.1651)
        assert_allclose(tag_map.corners_W[row], expected, atol=1e-9)


def test_limelight_tag_is_wpilibs_seen_from_the_middle_of_the_field(tmp_path):
    transform = [-0.5, -0.866025, 0, 6.808597, 0.866025, -0.5, 0, -3.859403]
    transform += [0, 0, 1, 1.355852, 0, 0, 0, 1]
    fiducial = {"family": "apriltag3_36h11_classic", "id": 1, "size": 165.1}
    path = tmp_path / "crescendo.fmap"
    path.write_text(json.dumps({"fiducials": [fiducial | {"transform": transform, "unique": 1}]}))
    tag_map = read_map_file(path).tag_map
    (x, y, z), _, _, right = CRESCENDO[1]
    middle = (x - 16.541 / 2, y - 8.211 / 2, z)
    expected = corners_seen(middle, right, (0, 0, 1), 0.1651)
    assert_allclose(tag_map.corners_W[0], expected, atol=5e-4)


def test_apriltag_ros1_tag_on_the_floor(tmp_path):
    path = tmp_path / "tags.yaml"
    path.write_text(
        "standalone_tags: [{id: 10, size: 0.05, name: pad}]\n"
        "tag_bundles:\n"
        "- {name: floor, layout: [{id: 0, size: 0.2, x: 1, y: 2, z: 0, qw: 1, qx: 0, qy: 0, qz: 0},"
        " {id: 7, size: 0.4, x: 3, y: 0, z: 0, qw: 0, qx: 0, qy: 0, qz: 1}]}\n"
        "- {name: other, layout: [{id: 5, size: 0.1}]}\n"
    )
    imported = read_map_file(path, bundle="floor")
    corners = imported.tag_map.corners_W
    assert_allclose(corners[0], corners_seen((1, 2, 0), (1, 0, 0), (0, 1, 0), 0.2), atol=1e-12)
    assert_allclose(corners[1], corners_seen((3, 0, 0), (-1, 0, 0), (0, -1, 0), 0.4), atol=1e-12)
    assert any("1 standalone" in note for note in imported.notes)
    with pytest.raises(MapError, match="floor, other"):
        read_map_file(path)
    with pytest.raises(MapError, match=r"unknown 'flor'; choose one of floor, other"):
        read_map_file(path, bundle="flor")
    assert read_map_file(path, bundle="other").tag_map.tag_id.tolist() == [5]


def test_tagslam_tag_of_an_frc_field(tmp_path):
    # 120 degrees about (1, 1, 1), as a public conversion of an FRC tag facing +x writes it
    path = tmp_path / "poses.yaml"
    path.write_text(
        "bodies:\n- field:\n    is_static: true\n    default_tag_size: 0.1651\n    tags:\n"
        "    - id: 7\n      pose:\n        position: {x: -0.0127, y: 5.547868, z: 1.451102}\n"
        "        rotation: {x: 1.20919970, y: 1.20919970, z: 1.20920010}\n"
        "        position_noise: {x: 0.001, y: 0.002, z: 0.003}\n"
        "        rotation_noise: {x: 0.01, y: 0.02, z: 0.03}\n"
        "- rig: {is_static: false, tags: [{id: 1, size: 0.1}]}\n"
    )
    imported = read_map_file(path)
    tag_map = imported.tag_map
    expected = corners_seen((-0.0127, 5.547868, 1.451102), (0, 1, 0), (0, 0, 1), 0.1651)
    assert_allclose(tag_map.corners_W[0], expected, atol=1e-6)
    assert_allclose(tag_map.sigma[0], [0.002, 0.003, 0.03, 0.02])
    assert any("rig" in note for note in imported.notes)


def test_tagslam_body_poses_are_applied(tmp_path):
    path = tmp_path / "poses.yaml"
    body = {
        "is_static": True,
        "pose": {
            "position": {"x": 1, "y": 0, "z": 0},
            "rotation": {"x": 0, "y": 0, "z": np.pi / 2},
        },
        "tags": [
            {
                "id": 3,
                "size": 0.2,
                "pose": {
                    "position": {"x": 2, "y": 0, "z": 0},
                    "rotation": {"x": 0, "y": 0, "z": 0},
                },
            }
        ],
    }
    path.write_text(json.dumps({"bodies": [{"wall": body}]}))
    in_W = read_map_file(path).tag_map.corners_W[0]
    assert_allclose(in_W, corners_seen((1, 2, 0), (0, 1, 0), (-1, 0, 0), 0.2), atol=1e-12)
    in_body = read_map_file(path, bundle="wall").tag_map.corners_W[0]
    assert_allclose(in_body, corners_seen((2, 0, 0), (1, 0, 0), (0, 1, 0), 0.2), atol=1e-12)


def test_clover_yaw_turns_about_z_and_roll_comes_first(tmp_path):
    path = tmp_path / "map.txt"
    half_pi = np.pi / 2
    path.write_text(
        f"# id\tlength\tx\ty\tz\tyaw\tpitch\troll\n"
        f"0\t0.33\t0\t0\t0\t{half_pi}\t0\t0\n1\t0.2\t4\t0\t1\t{half_pi}\t0\t{half_pi}\n"
    )
    imported = read_map_file(path)
    corners = imported.tag_map.corners_W
    assert_allclose(corners[0], corners_seen((0, 0, 0), (0, 1, 0), (-1, 0, 0), 0.33), atol=1e-9)
    # roll 90 deg stands it up facing -y, then yaw 90 deg turns the face to +x
    assert_allclose(corners[1], corners_seen((4, 0, 1), (0, 1, 0), (0, 0, 1), 0.2), atol=1e-9)
    assert imported.tag_map.family.name == "DICT_4X4_250"


def test_fiducials_tag_on_the_ceiling_looks_down(tmp_path):
    path = tmp_path / "map.txt"
    path.write_text("301 1.0 2.0 2.5 180.0 0.0 0.0 0.0 1 302 303\n302 0 0 2.5 180 0 90 0.1 5\n")
    tag_map = read_map_file(path, size=0.14).tag_map
    expected = corners_seen((1, 2, 2.5), (1, 0, 0), (0, -1, 0), 0.14)
    assert_allclose(tag_map.corners_W[0], expected, atol=1e-12)
    turned = corners_seen((0, 0, 2.5), (0, 1, 0), (1, 0, 0), 0.14)
    assert_allclose(tag_map.corners_W[1], turned, atol=1e-12)
    with pytest.raises(MapError, match="--size"):
        read_map_file(path)


@pytest.mark.skipif(DATA is None, reason="TAGVIO_DATA is not set")
def test_kalibr_grid_is_eurocs_board(tmp_path):
    path = tmp_path / "april_6x6.yaml"
    path.write_text(
        "target_type: 'aprilgrid'\ntagCols: 6\ntagRows: 6\ntagSize: 0.088\ntagSpacing: 0.3\n"
    )
    ours, board = read_map_file(path).tag_map, load_map(Path(DATA or "") / EUROC)
    assert_allclose(ours.tag_id, board.tag_id)
    assert_allclose(ours.corners_W, board.corners_W, atol=1e-9)
    assert_allclose(ours.total_size, board.total_size)
    assert ours.border_bits == board.border_bits == 2
    lost = write_map_file(board, path, "kalibr")
    assert lost == ["Kalibr aprilgrid target holds no sigma: how well the tags were laid is lost"]


EUROC = "euroc_imu_april/tagmap.yaml"
NO_GRID = {
    "the family is tag25h9": lambda m: replace(m, family=FAMILIES["tag25h9"]),
    "border_bits is 1": lambda m: replace(m, border_bits=1),
    "the ids are not 0 to 5": lambda m: replace(m, tag_id=m.tag_id + 1),
    "differ in size": lambda m: replace(m, size=m.size * np.linspace(1, 1.1, len(m))),
    "is turned": lambda m: replace(m, R_WT=np.tile(geo.exp(np.array([0, 0, 0.01])), (6, 1, 1))),
    "a tag lies 10.00 mm off": lambda m: replace(m, p_WT=m.p_WT + 0.01 * (m.tag_id == 4)[:, None]),
    "do not make full rows": lambda m: m.only(np.arange(5)),
}


@pytest.mark.parametrize("why", NO_GRID)
def test_kalibr_refuses_what_is_no_grid_and_says_why(why, tmp_path):
    assert write_map_file(grid_map(), tmp_path / "t.yaml", "kalibr")
    with pytest.raises(MapError, match=why):
        write_map_file(NO_GRID[why](grid_map()), tmp_path / "t.yaml", "kalibr")


def test_ros2_parameters_alone_are_refused(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "apriltag:\n  ros__parameters:\n    family: Standard41h12\n    size: 0.173\n"
        "    tag: {ids: [9, 14], frames: [base, object], sizes: [0.162, 0.161]}\n"
    )
    with pytest.raises(MapError, match="no poses; give --layout"):
        read_map_file(path)
    layout = random_map(7, "tagStandard41h12")
    save_map(replace(layout, tag_id=np.arange(len(layout)) + 100), tmp_path / "layout.yaml")
    with pytest.raises(MapError, match=r"tag \d+ is not on the layout"):
        read_map_file(path, layout=tmp_path / "layout.yaml")


BAD = {
    "": "the file is empty",
    "[1, 2]": "a mapping or a table",
    "hello: world": "no tag map known here; choose one of",
    "{": "not valid YAML",
    "1 2 3": "no tag map known here",
    "0 0.3 0 0 zero 0 0 0": "row 1",
    "0.5 0.3 0 0 0 0 0 0": "row 1",
    '{"tags": [{"ID": 1}], "field": {}}': "`pose` is missing",
    '{"tags": 3, "field": {}}': "a list is needed",
    '{"fiducials": [{"family": "x"}]}': "apriltag3_36h11_classic",
    '{"fiducials": [{"family": "36h11", "transform": [1]}]}': "16 finite numbers",
    "tag_bundles: []": "no tag bundle",
    "tag_bundles: [{layout: [{id: 0, x: 1}]}]": "--size",
    "tag_bundles: [{layout: [{id: 0, size: a}]}]": "positive number of metres",
    "bodies: [{lab: {is_static: true, tags: [{id: 0}]}}]": "has a pose",
    "bodies: [{lab: {tags: []}}]": "no static body",
    "{target_type: checkerboard}": "aprilgrid is read",
    "{target_type: aprilgrid, tagCols: 0}": "tagCols",
    "family: tag36h11": "no tags",
}


@pytest.mark.parametrize("text", BAD)
def test_bad_files_are_refused_in_one_line_that_names_them(text, tmp_path):
    path = tmp_path / "bad.map"
    path.write_text(text)
    with pytest.raises(MapError) as caught:
        read_map_file(path)
    message = str(caught.value)
    assert BAD[text] in message
    assert message.startswith(str(path))
    assert "\n" not in message


@pytest.mark.parametrize("fmt", FORMATS)
@PROPERTY
@given(seed=SEEDS)
def test_damaged_files_never_crash(fmt, seed, tmp_path):
    rng = np.random.default_rng(seed)
    path = tmp_path / "map.txt"
    write_map_file(grid_map(), path, fmt)
    text = path.read_text()
    for _ in range(int(rng.integers(1, 4))):
        at, span = int(rng.integers(len(text))), int(rng.integers(0, 40))
        piece = str(rng.choice(["", "x", "-1", "{", "]", ":", "\n", "null", "1e999", "9" * 400]))
        text = text[:at] + piece + text[at + span :]
    path.write_text(text)
    for name in (None, fmt):
        with suppress(MapError):  # any other exception fails the test
            read_map_file(path, name, size=0.1)


def test_unknown_format_is_named(tmp_path):
    with pytest.raises(MapError, match=r"unknown 'vrml'; choose one of wpilib, "):
        write_map_file(grid_map(), tmp_path / "m", "vrml")


def test_family_that_contradicts_the_file_is_refused(tmp_path):
    path = tmp_path / "m.yaml"
    save_map(grid_map(), path)
    assert read_map_file(path, family="tag36h11").tag_map.family.name == "tag36h11"
    with pytest.raises(MapError, match="the file says tag36h11, --family says tag25h9"):
        read_map_file(path, family="tag25h9")
