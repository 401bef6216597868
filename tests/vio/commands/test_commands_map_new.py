"""`tagvio map new`, `views` and `print`: what they write and say, and how they refuse."""

import re
from contextlib import contextmanager

import pytest
import yaml
from cli_calls import tagvio
from scans import detect, pages

from tagvo.maps.printing.cutting import PAPERS
from tagvo.tags.tag_map import load_map
from vio.commands.map import new
from vio.commands.map.printing import PaperName

SMALL = ("--size", "1.2,1.5", "--sizes", "0.23,0.115,0.0575", "--steps", "30")


@pytest.fixture
def hall(tmp_path):
    path = tmp_path / "hall.yaml"
    done = tagvio("map", "new", path, *SMALL)
    assert done.code == 0, done.err
    return path


def objective(text):
    return float(re.search(r"objective ([\d.]+)", text).group(1))


def test_new_writes_a_map_and_says_what_is_seen_of_it(tmp_path):
    path = tmp_path / "deep" / "hall.yaml"
    done = tagvio("map", "new", path, *SMALL)
    assert (done.code, done.err) == (0, "")
    tag_map = load_map(path)
    assert f"{len(tag_map)} tags of tagStandard41h12, ids 0 to {len(tag_map) - 1}" in done.out
    assert "border 57.5 mm, total 103.5 mm" in done.out
    assert len(re.findall(r"^  \d\.\d\d m ", done.out, re.MULTILINE)) == 12
    data = yaml.safe_load(path.read_text())
    assert data["gravity"] == {"dir": [0.0, 0.0, -1.0], "sigma_deg": 1.0}
    assert data["sigma"] == {"xy": 0.002, "z": 0.001, "yaw_deg": 0.3, "tilt_deg": 0.1}
    views = tagvio("map", "views", path)
    assert views.code == 0
    assert objective(views.out) == objective(done.out)
    assert tagvio("map", "check", path).code == 0


def test_the_command_in_the_map_makes_the_same_map_again(hall, tmp_path):
    text = hall.read_text()
    words = re.search(r"Made by: tagvio (map new .*)", text).group(1).split()
    again = tmp_path / "again.yaml"
    assert tagvio(*words[:2], again, *words[2:]).code == 0
    assert again.read_text() == text
    other = tmp_path / "other.yaml"
    assert tagvio(*words[:2], other, *words[2:], "--seed", "7").code == 0
    assert other.read_text() != text


def test_ctrl_c_ends_the_search_and_keeps_the_best_so_far(tmp_path, monkeypatch):
    asked = []

    @contextmanager
    def at_once():
        yield lambda: bool(asked.append(1)) or len(asked) > 5

    monkeypatch.setattr(new, "gently", at_once)
    done = tagvio("map", "new", tmp_path / "m.yaml", *SMALL[:-2])
    assert done.code == 130
    assert "stopped by Ctrl-C; the map is the best so far" in done.err
    assert len(asked) == 7
    assert len(load_map(tmp_path / "m.yaml")) > 80


def test_options_of_new_reach_the_map(tmp_path):
    path = tmp_path / "m.yaml"
    words = ("--family", "tag36h11", "--size", "0.8,0.8", "--sizes", "0.2,0.1", "--shares", "1,1",
             "--quiet-zone", "0.02", "--first-id", "30", "--heights", "0.5,0.5", "--steps", "5",
             "--min-px", "30", "--tiles", "1,1")  # fmt: skip
    done = tagvio("map", "new", path, *words)
    assert done.code == 0, done.err
    tag_map = load_map(path)
    assert tag_map.family.name == "tag36h11"
    assert tag_map.tag_id.min() == 30
    assert set(tag_map.size.tolist()) == {0.2, 0.1}
    assert "border at least 30 px" in done.out
    assert done.out.count(" m  ") == 1  # one height


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--family", "tag36h11"), ["1199 tags", "tag36h11 has 587 (0 to 586)"]),
        (("--first-id", "2000"), ["604 tags", "115 are left"]),
        (("--size", "0.5,0.5"), ["0.828 m printed", "no room"]),
        (("--family", "tag99"), ["--family", "'tag99'", "tagStandard41h12"]),
        (("--camera", "nowhere.yaml"), ["nowhere.yaml", "no such file"]),
    ],
)
def test_new_refuses_in_one_line_and_writes_nothing(tmp_path, words, said):
    done = tagvio("map", "new", tmp_path / "m.yaml", *words)
    assert done.code == 1
    assert done.err.count("\n") == 1
    for word in said:
        assert word in done.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ("new", "m.yaml", "--size", "3"),
        ("new", "m.yaml", "--sizes", "a,b"),
        ("new", "m.yaml", "--heights", "2,1"),
        ("new", "m.yaml", "--tiles", "1.5,2"),
        ("new", "m.yaml", "--quiet-zone", "-1"),
        ("new",),
        ("views",),
        ("print", "m.yaml", "m.svg"),
        ("print", "m.yaml", "m.pdf", "--paper", "B5"),
        ("print", "m.yaml", "m.pdf", "--only-tags", "a"),
        ("print", "m.yaml"),
    ],
)
def test_wrong_usage_exits_2(tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    assert tagvio("map", *words).code == 2
    assert list(tmp_path.iterdir()) == []


def test_views_of_several_maps_stand_below_one_another(hall):
    done = tagvio("map", "views", hall, "configs/maps/arena.yaml", "--heights", "0.5,0.5")
    assert done.code == 0
    assert done.out.count("objective") == 2
    assert "configs/maps/arena.yaml: 408 tags" in done.out


def test_print_writes_pages_that_decode(hall, tmp_path):
    out = tmp_path / "hall.pdf"
    done = tagvio("map", "print", hall, out, "--paper", "a1", "--turn", "portrait")
    assert (done.code, done.err) == (0, "")
    tag_map = load_map(hall)
    assert f"{len(tag_map)} tags on " in done.out
    assert "actual size (100 %)" in done.out
    index, *sheets = pages(out, 60)
    assert hall.name in index.text
    assert f"; {len(sheets) + 1} pages" in done.out
    found = {i for page in sheets for i in detect(page.image)[0].tolist()}
    assert len(found) > 0.8 * len(tag_map)
    assert found <= set(tag_map.tag_id.tolist())


def test_print_takes_a_roll_some_tags_and_each(hall, tmp_path):
    out = tmp_path / "hall.pdf"
    done = tagvio("map", "print", hall, out, "--roll", "914", "--no-index", "--title", "Hall 2")
    assert done.code == 0
    assert all("Hall 2" in page.text for page in pages(out, 10))
    assert "a roll of 914 mm" in done.out
    done = tagvio("map", "print", hall, out, "--each", "--only-tags", "40,41", "--no-ids")
    assert done.code == 0
    assert "2 tags on 2 sheets of A4, one tag each; 3 pages" in done.out
    done = tagvio("map", "print", hall, out, "--only-tags", "9999")
    assert done.code == 1
    assert "no tag 9999" in done.err


def test_print_says_when_ids_have_no_room(tmp_path):
    path, out = tmp_path / "m.yaml", tmp_path / "m.pdf"
    assert tagvio("map", "new", path, *SMALL, "--quiet-zone", "0").code == 0
    done = tagvio("map", "print", path, out)
    assert done.code == 0
    assert re.search(r"\d+ tags have no white for an id beside them", done.err)


def test_papers_of_the_command_are_those_of_the_library():
    assert {name.value for name in PaperName} == set(PAPERS)


@pytest.mark.parametrize("name", ["new", "views", "print"])
def test_help_teaches_with_an_example(name):
    done = tagvio("map", name, "--help")
    assert done.code == 0
    assert f"tagvio map {name}" in done.out
