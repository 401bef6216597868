"""The map check finds each fault, all of them at once, and says nothing of sound maps."""

import os
import time
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tagvo.errors import MapError
from tagvo.maps.check import check_map_data, size_classes
from tagvo.tags.tag_map import map_from_dict
from tagvo.textfile import read_yaml

DATA = os.environ.get("TAGVIO_DATA")


def tag(tag_id: int, x: float, y: float = 0.0, size: float = 0.1, deg: float = 0.0) -> dict:
    half = np.radians(deg) / 2.0
    q = [float(np.cos(half)), 0.0, 0.0, float(np.sin(half))]
    return {"id": tag_id, "size": size, "p": [x, y, 0.0], "q": q}


def sound() -> dict[str, Any]:
    return {"family": "tag36h11", "tags": [tag(i, 0.5 * i) for i in range(4)]}


def texts(data: dict[str, Any], severity: str) -> list[str]:
    return [f.text for f in check_map_data(data, "m") if f.severity == severity]


def test_sound_map_has_no_findings():
    assert check_map_data(sound(), "m") == []


def test_tags_beyond_two_metres_earn_a_word():
    data = sound()
    data["tags"] += [tag(8, 10.0, size=2.0), tag(9, 20.0, size=4.6)]
    assert texts(data, "warning") == ["m: tags 9 (4.6 m) are larger than 2 m: are sizes in metres?"]


@pytest.mark.skipif(DATA is None, reason="TAGVIO_DATA is not set")
@pytest.mark.parametrize(
    "name", ["euroc_imu_april", "mocap_aprilgrid", "tagslam_aviary", "tagslam_line5"]
)
def test_real_maps_are_clean(name):
    path = Path(DATA or "") / name / "tagmap.yaml"
    assert check_map_data(read_yaml(path), str(path)) == []


FAULTS = {
    "stands 2 times": lambda d: d["tags"].append(tag(2, 9.0)),
    "not an id of tag36h11": lambda d: d["tags"][1].update(id=587),
    "id: 'a'": lambda d: d["tags"][1].update(id="a"),
    "size: 0": lambda d: d["tags"][1].update(size=0),
    "size: -0.1": lambda d: d["tags"][1].update(size=-0.1),
    "size: nan": lambda d: d["tags"][1].update(size=float("nan")),
    "is no rotation": lambda d: d["tags"][1].update(q=[1.002, 0, 0, 0]),
    "p: [0, 0]": lambda d: d["tags"][1].update(p=[0, 0]),
    "`q` is missing": lambda d: d["tags"][1].pop("q"),
    "unknown 'qq'": lambda d: d["tags"][1].update(qq=1),
    "sigma xy: -1": lambda d: d["tags"][1].update(sigma={"xy": -1}),
    "tags[1]: 7": lambda d: d["tags"].__setitem__(1, 7),
    "no tags": lambda d: d.update(tags=[]),
    "no tags; ": lambda d: d.update(tags={"a": 1}),
    "family: unknown 'tag37'": lambda d: d.update(family="tag37"),
    "`family` is missing": lambda d: d.pop("family"),
    "size_kind: unknown": lambda d: d.update(size_kind="whole"),
    "border_bits: 0": lambda d: d.update(border_bits=0),
    "gravity": lambda d: d.update(gravity={"dir": [0, 0, 0]}),
    "unknown 'tagz'": lambda d: d.update(tagz=[]),
    "unknown 'zz'": lambda d: d.update(sigma={"zz": 1}),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found(fault):
    data = sound()
    FAULTS[fault](data)
    found = texts(data, "error")
    assert any(fault in text for text in found), found
    with pytest.raises(MapError):  # and the loader agrees that it is one
        map_from_dict(data, "m")


def test_all_faults_are_listed_not_the_first_alone():
    data = sound()
    names = ["stands 2 times", "unknown 'tagz'", "size_kind: unknown", "unknown 'zz'"]
    for name in names:
        FAULTS[name](data)
    data["tags"][0] |= {"size": -1, "q": [1, 1, 0, 0]}
    data["tags"][3]["id"] = 9999
    found = texts(data, "error")
    for name in [*names, "size: -1", "is no rotation", "tag 9999: not an id"]:
        assert any(name in text for text in found), (name, found)


def test_rotation_off_by_less_than_a_thousandth_is_one():
    data = sound()
    data["tags"][1]["q"] = [1.0009, 0, 0, 0]
    assert check_map_data(data, "m") == []


@pytest.mark.parametrize(
    ("gap", "severity"),  # between the centres of tags of border 0.1, total 0.125
    [(0.0999, "error"), (0.1001, "warning"), (0.12, "warning"), (0.125, None), (0.2, None)],
)
def test_overlap_of_borders_is_an_error_and_of_margins_a_warning(gap, severity):
    data = {"family": "tag36h11", "tags": [tag(0, 0.0), tag(1, gap)]}
    found = check_map_data(data, "m")
    assert [f.severity for f in found] == ([severity] if severity else [])
    assert all(f.tag_ids == (0, 1) for f in found)


def test_overlap_is_exact_for_turned_tags():
    # a square turned by 45 degrees reaches 0.0707 along x but its edge passes (0.05, 0.05) free
    beside = {"family": "tag36h11", "tags": [tag(0, 0, deg=45), tag(1, 0.1, 0.1)]}
    assert texts(beside, "error") == []
    across = {"family": "tag36h11", "tags": [tag(0, 0, deg=45), tag(1, 0.115, 0.0)]}
    assert len(texts(across, "error")) == 1


def test_overlap_needs_one_surface_and_one_side():
    above = {"family": "tag36h11", "tags": [tag(0, 0), tag(1, 0)]}
    above["tags"][1]["p"][2] = 0.05
    assert check_map_data(above, "m") == []
    back_to_back = {"family": "tag36h11", "tags": [tag(0, 0), tag(1, 0)]}
    back_to_back["tags"][1]["q"] = [0, 1, 0, 0]
    assert check_map_data(back_to_back, "m") == []
    corner = {"family": "tag36h11", "tags": [tag(0, 0), tag(1, 0)]}
    corner["tags"][1]["q"] = [0.5**0.5, 0.5**0.5, 0, 0]
    assert check_map_data(corner, "m") == []


def test_total_sizes_are_understood():
    tags = [tag(0, 0.0, size=0.125), tag(1, 0.12, size=0.125)]
    data = {"family": "tag36h11", "size_kind": "total", "tags": tags}
    assert [f.severity for f in check_map_data(data, "m")] == ["warning"]


def clipped_area(a: np.ndarray, b: np.ndarray) -> float:
    """Area common to two convex polygons, both anticlockwise (Sutherland and Hodgman)."""
    polygon = list(a)
    for start, end in zip(b, np.roll(b, -1, axis=0), strict=True):
        edge = end - start
        side = [edge[0] * (q - start)[1] - edge[1] * (q - start)[0] for q in polygon]
        kept = []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if side[i] >= 0:
                kept.append(polygon[i])
            if (side[i] >= 0) != (side[j] >= 0):
                share = side[i] / (side[i] - side[j])
                kept.append(polygon[i] + share * (polygon[j] - polygon[i]))
        polygon = kept
        if not polygon:
            return 0.0
    x, y = np.array(polygon).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_overlap_agrees_with_polygon_clipping(seed):
    rng = np.random.default_rng(seed)
    tags = [
        tag(
            i, *rng.uniform(0, 0.5, 2), size=float(rng.choice([0.05, 0.1])), deg=rng.uniform(0, 360)
        )
        for i in range(6)
    ]
    tag_map = map_from_dict({"family": "tag36h11", "tags": tags}, "m")
    squares = tag_map.corners_W[:, ::-1, :2]  # TL, TR, BR, BL run clockwise
    expected = {
        (i, j): clipped_area(squares[i], squares[j]) for i in range(6) for j in range(i + 1, 6)
    }
    findings = check_map_data({"family": "tag36h11", "tags": tags}, "m")
    found = {f.tag_ids for f in findings if f.severity == "error"}
    assert {pair for pair, area in expected.items() if area > 1e-5} <= found
    assert found <= {pair for pair, area in expected.items() if area > 0.0}


def test_sizes_that_differ_by_total_over_border_are_suspected():
    tags = [tag(0, 0, size=0.1), tag(1, 1, size=0.1), tag(2, 2, size=0.18)]
    (finding,) = check_map_data({"family": "tagStandard41h12", "tags": tags}, "m")
    assert finding.severity == "warning"
    assert finding.tag_ids == (2,)
    assert "0.1 m" in finding.text
    assert "0.18 m" in finding.text


@pytest.mark.parametrize(("bits", "suspect"), [(1, 0.125), (2, 0.12)])
def test_border_bits_change_the_suspected_factor(bits, suspect):
    tags = [tag(0, 0), tag(1, 1, size=suspect)]
    data = {"family": "tag36h11", "border_bits": bits, "tags": tags}
    assert len(texts(data, "warning")) == 1
    data["border_bits"] = 3 - bits
    assert texts(data, "warning") == []


def test_the_papers_classes_are_not_suspected():
    sizes = [0.0575, 0.115, 0.23, 0.46]
    tags = [tag(i, 2.0 * i, size=s) for i, s in enumerate(sizes)]
    data = {"family": "tagStandard41h12", "tags": tags}
    assert check_map_data(data, "m") == []
    classes = size_classes(map_from_dict(data, "m"))
    assert [c.border for c in classes] == pytest.approx(sizes)
    assert [c.total for c in classes] == pytest.approx([1.8 * s for s in sizes])
    assert [c.count for c in classes] == [1, 1, 1, 1]


def test_two_thousand_tags_take_little_time():
    tags = [tag(i, 0.2 * (i % 50), 0.2 * (i // 50)) for i in range(2000)]
    start = time.perf_counter()
    assert check_map_data({"family": "tagStandard41h12", "tags": tags}, "m") == []
    assert time.perf_counter() - start < 2.0


JUNK = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=6,
)


@settings(max_examples=150, deadline=None)
@given(JUNK, st.sampled_from(["family", "size_kind", "sigma", "gravity", "border_bits", "tags"]))
def test_junk_in_the_header_never_crashes(junk, key):
    data = sound() | {key: junk}
    check_map_data(data, "m")


@settings(max_examples=150, deadline=None)
@given(JUNK, st.sampled_from(["id", "size", "p", "q", "sigma", "z"]))
def test_junk_in_a_tag_never_crashes_and_the_loader_agrees(junk, key):
    data = deepcopy(sound())
    data["tags"][1][key] = junk
    errors = texts(data, "error")
    try:
        map_from_dict(data, "m")
    except MapError:
        assert errors
    else:
        assert all("overlap" in text for text in errors)
