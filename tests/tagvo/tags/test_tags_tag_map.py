"""Bad maps in, one line out; what a good map says of its tags; round trips through its file."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from numpy.testing import assert_allclose, assert_array_equal
from simulated import ARENA, arena
from strategies import seeds

from tagvo import geometry as geo
from tagvo.errors import MapError
from tagvo.tags.families import FAMILIES, family_named
from tagvo.tags.tag_map import load_map, map_from_dict, map_to_yaml, save_map

GOOD = {
    "family": "tag36h11",
    "tags": [
        {"id": 3, "size": 0.2, "p": [0.0, 0.0, 0.0], "q": [1.0, 0.0, 0.0, 0.0]},
        {"id": 7, "size": 0.1, "p": [1.0, 0.0, 0.0], "q": [1.0, 0.0, 0.0, 0.0]},
    ],
}
GONE = object()


def changed(path, value):
    data = copy.deepcopy(GOOD)
    at = data
    for key in path[:-1]:
        at = at[key]
    if value is GONE:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return data


FAULTS = [
    (("family",), GONE, "m: `family` is missing"),
    (("family",), "tag99", "m family: unknown 'tag99'; choose one of tagStandard41h12, "),
    (("family",), None, "m family: unknown None; choose one of"),
    (("sizekind",), "border", "m: unknown 'sizekind'; choose one of family, size_kind, sigma"),
    (("size_kind",), "inner", "m size_kind: unknown 'inner'; choose one of border, total"),
    (("border_bits",), 0, "m border_bits: 0; a whole number from 1 to 4 is needed"),
    (("border_bits",), True, "m border_bits: True; a whole number from 1 to 4"),
    (("border_bits",), 1.5, "m border_bits: 1.5; a whole number from 1 to 4"),
    (("tags",), GONE, "m: the map has no tags"),
    (("tags",), [], "m: the map has no tags"),
    (("tags",), {"0": 1}, "m: the map has no tags"),
    (("tags", 1), 5, "m tags[1]: 5; a mapping with id, size, p and q is needed"),
    (("tags", 1, "yaw"), 5, "m tags[1]: unknown 'yaw'; choose one of id, size, p, q, sigma"),
    (("tags", 1, "size"), GONE, "m tags[1]: `size` is missing"),
    (("tags", 1, "id"), "7", "m tags[1] id: '7'; a whole number is needed"),
    (("tags", 1, "id"), True, "m tags[1] id: True; a whole number is needed"),
    (("tags", 1, "id"), 587, "m tag 587: not an id of tag36h11; 0 to 586 are"),
    (("tags", 1, "id"), -1, "m tag -1: not an id of tag36h11"),
    (("tags", 1, "id"), 3, "m: tag 3 stands twice (tags[0] and tags[1])"),
    (("tags", 1, "size"), 0, "m tag 7 size: 0; a positive number of metres is needed"),
    (("tags", 1, "size"), "big", "m tag 7 size: 'big'; a positive number"),
    (("tags", 1, "size"), float("inf"), "m tag 7 size: inf; a positive number"),
    (("tags", 1, "p"), [0, 1], "m tag 7 p: [0, 1]; a list of 3 finite numbers is needed"),
    (("tags", 1, "p"), [0, 1, float("nan")], "m tag 7 p: [0, 1, nan]; a list of 3 finite"),
    (("tags", 1, "p"), 5, "m tag 7 p: 5; a list of 3 finite numbers is needed"),
    (("tags", 1, "q"), [1, 0, 0], "m tag 7 q: [1, 0, 0]; a list of 4 finite numbers"),
    (("tags", 1, "q"), [1, 1, 0, 0], "m tag 7 q: [1, 1, 0, 0] is no rotation (norm 1.414)"),
    (("tags", 1, "q"), [0, 0, 0, 0], "m tag 7 q: [0, 0, 0, 0] is no rotation (norm 0)"),
    (("sigma",), 0.1, "m sigma: 0.1; a mapping with xy, z, yaw_deg, tilt_deg is needed"),
    (("sigma",), {"yaw": 1}, "m sigma: unknown 'yaw'; choose one of xy, z, yaw_deg, tilt_deg"),
    (("sigma",), {"xy": -1}, "m sigma xy: -1; a number of at least 0 is needed"),
    (("tags", 1, "sigma"), {"z": "a"}, "m tag 7 sigma z: 'a'; a number of at least 0"),
    (("gravity",), [0, 0, -1], "m gravity: [0, 0, -1]; {dir: [x, y, z], sigma_deg: 1} is needed"),
    (("gravity",), {"sigma_deg": 1}, "m gravity: {'sigma_deg': 1}; {dir:"),
    (("gravity",), {"dir": [0, 0, 0]}, "m gravity dir: the vector is zero"),
    (("gravity",), {"dir": [0, 0, -1], "sigma_deg": 0}, "m gravity sigma_deg: 0; a positive"),
]


@pytest.mark.parametrize(("path", "value", "message"), FAULTS)
def test_each_fault_is_told_in_one_line(path, value, message):
    with pytest.raises(MapError) as err:
        map_from_dict(changed(path, value), "m")
    assert str(err.value).startswith(message)
    assert "\n" not in str(err.value)


@pytest.mark.parametrize("text", ["", "- 1\n", "family: [\n", "tags: 5\n"])
def test_a_file_that_is_no_map_is_named(tmp_path, text):
    path = tmp_path / "tagmap.yaml"
    path.write_text(text)
    with pytest.raises(MapError, match=r"tagmap\.yaml"):
        load_map(path)


def test_a_missing_file_a_folder_and_bytes_are_named(tmp_path):
    with pytest.raises(MapError, match="no such file"):
        load_map(tmp_path / "none.yaml")
    with pytest.raises(MapError, match="is a folder"):
        load_map(tmp_path)
    (tmp_path / "x.yaml").write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(MapError, match="not a text file"):
        load_map(tmp_path / "x.yaml")


def test_total_sizes_become_border_sizes():
    total = map_from_dict(GOOD | {"size_kind": "total"}, "m")
    assert_allclose(total.size, np.array([0.2, 0.1]) * 8 / 10)
    assert_allclose(total.total_size, [0.2, 0.1])
    kalibr = map_from_dict(GOOD | {"size_kind": "total", "border_bits": 2}, "m")
    assert_allclose(kalibr.size, np.array([0.2, 0.1]) * 10 / 12)
    wide = map_from_dict(changed(("family",), "tagStandard41h12") | {"size_kind": "total"}, "m")
    assert_allclose(wide.size, np.array([0.2, 0.1]) * 5 / 9)


def test_classes_levels_rows_and_corners():
    tag_map = arena()
    assert_allclose(tag_map.classes, [0.0575, 0.115, 0.23, 0.46])
    assert_allclose(sorted(set(np.round(tag_map.level, 9))), [0, 1, 2, 3])
    assert_array_equal(tag_map.rows(tag_map.tag_id), np.arange(len(tag_map)))
    assert_array_equal(tag_map.rows(np.array([-1, 2_000_000])), [-1, -1])
    assert tag_map.rows(np.zeros(0, dtype=np.int64)).shape == (0,)
    for i in (0, 30, len(tag_map) - 1):
        half = tag_map.size[i] / 2
        flat = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
        expected = flat @ tag_map.R_WT[i].T + tag_map.p_WT[i]
        assert_allclose(tag_map.corners_W[i], expected, atol=1e-12)


def test_sigmas_in_degrees_become_radians_by_tag_and_by_map():
    data = changed(("tags", 1, "sigma"), {"xy": 0.01, "tilt_deg": 2.0})
    tag_map = map_from_dict(data | {"sigma": {"yaw_deg": 1.0}}, "m")
    yaw, tilt = np.radians(1.0), np.radians(0.1)
    assert_allclose(tag_map.laying_sigma[0], [0.002, 0.002, 0.001, tilt, tilt, yaw])
    wide = np.radians(2.0)
    assert_allclose(tag_map.laying_sigma[1], [0.01, 0.01, 0.001, wide, wide, yaw])


def test_gravity_is_made_a_unit_vector():
    tag_map = map_from_dict(GOOD | {"gravity": {"dir": [0, 0, -9.81]}}, "m")
    assert tag_map.gravity.dir == (0.0, 0.0, -1.0)
    assert tag_map.gravity.sigma_deg == 1.0


def test_only_some_tags():
    tag_map = arena()
    few = tag_map.only(np.array([5, 2]))
    assert_array_equal(few.tag_id, [5, 2])
    assert_allclose(few.p_WT, tag_map.p_WT[tag_map.rows(np.array([5, 2]))])
    with pytest.raises(MapError, match="no tag 9999 on this map"):
        tag_map.only(np.array([2, 9999]))


@given(seeds)
def test_what_is_written_is_read_again(seed):
    rng = np.random.default_rng(seed)
    n, family = int(rng.integers(1, 6)), rng.choice(sorted(FAMILIES))
    tags = [
        {
            "id": int(i),
            "size": float(rng.uniform(0.01, 2.0)),
            "p": rng.normal(0, 10, 3).tolist(),
            "q": geo.quat_from_matrix(geo.exp(rng.normal(0, 2, 3))).tolist(),
            **({"sigma": {"xy": 0.03, "tilt_deg": 5.0}} if rng.random() < 0.3 else {}),
        }
        for i in rng.permutation(family_named(family, "t").ids)[:n]
    ]
    kind = str(rng.choice(["border", "total"]))
    data = {"family": str(family), "size_kind": kind, "border_bits": int(rng.integers(1, 5))}
    tag_map = map_from_dict(data | {"tags": tags, "gravity": {"dir": [0, 1, 0]}}, "m")
    again = map_from_dict(yaml.safe_load(map_to_yaml(tag_map)), "m")
    for name in ("tag_id", "size", "p_WT", "R_WT", "sigma"):
        assert_allclose(getattr(again, name), getattr(tag_map, name), atol=2e-9, err_msg=name)
    assert again.gravity == tag_map.gravity
    assert (again.family, again.size_kind, again.border_bits) == (
        tag_map.family, tag_map.size_kind, tag_map.border_bits
    )  # fmt: skip


def test_saving_replaces_the_file_whole(tmp_path):
    path = tmp_path / "folder" / "tagmap.yaml"
    save_map(load_map(ARENA), path)
    save_map(load_map(path), path)
    assert_allclose(load_map(path).R_WT, arena().R_WT, atol=1e-9)
    assert [p.name for p in path.parent.iterdir()] == ["tagmap.yaml"]


def test_a_changed_copy_finds_its_own_rows():
    tag_map = arena()
    reversed_map = replace(
        tag_map, tag_id=tag_map.tag_id[::-1], size=tag_map.size[::-1], p_WT=tag_map.p_WT[::-1],
        R_WT=tag_map.R_WT[::-1], sigma=tag_map.sigma[::-1],
    )  # fmt: skip
    assert_array_equal(reversed_map.rows(tag_map.tag_id[:1]), [len(tag_map) - 1])


@pytest.mark.parametrize("name", ["tag36h11", "TAG36H11", "DICT_APRILTAG_36h11"])
def test_families_by_any_of_their_names(name):
    assert family_named(name, "t").name == "tag36h11"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"sigma": {"xy": 1e20}}, "sigma xy: 1e+20; at most 10 metres"),
        ({"sigma": {"tilt_deg": 46}}, "sigma tilt_deg: 46; at most 45 degrees"),
        (
            {"gravity": {"dir": [0, 0, -1], "sigma_deg": 0}},
            "sigma_deg: 0; a positive number of degrees",
        ),
    ],
)
def test_sigmas_have_bounds_in_their_units(keys, said):
    data = {
        "family": "tag36h11",
        "tags": [{"id": 0, "size": 0.1, "p": [0, 0, 0], "q": [1, 0, 0, 0]}],
    }
    with pytest.raises(MapError) as caught:
        map_from_dict({**data, **keys}, "m")
    assert said in str(caught.value)
