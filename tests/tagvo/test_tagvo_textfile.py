"""Values of YAML and JSON as PyYAML has them, quick for large maps, nothing that deceives."""

import os
from pathlib import Path

import pytest
import yaml

from tagvo import textfile
from tagvo.errors import TagvoError
from tagvo.textfile import parse_json, parse_yaml, read_json, read_yaml

CONFIGS = sorted((Path(__file__).parents[2] / "configs").rglob("*.yaml"))
PLAIN = [
    "1", "-0", "017", "0x1f", "1_000", "1.5", "-.5", "1.", "1e-3", "1.0e+3", "1.5e3", ".inf",
    ".nan", "yes", "off", "null", "~", "", "2026-01-02", "12:30:45", "1.2.3", "'1'", '"yes"',
    "[1, [2], {}]",
    "{a: {b: [1, c]}, 3: 2, yes: no}", "- a\n- b: 1\n  c: [x]", "a: |\n  text\n  more", "=1", "+7",
]  # fmt: skip


@pytest.mark.parametrize("text", PLAIN)
def test_values_are_those_of_a_safe_loader(text):
    assert repr(parse_yaml(text, "w")) == repr(yaml.load(text, textfile._Loader))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_our_own_files_are_read_as_they_were(path):
    text = path.read_text()
    assert parse_yaml(text, "w") == yaml.load(text, textfile._Loader)


REFUSED = {
    "a: 1\nb: 2\na: 3": "w line 3: not valid YAML (the key 'a' twice in one mapping",
    "t: [{id: 1, id: 2}]": "w line 1: not valid YAML (the key 'id' twice in one mapping",
    "a: &x 1\nb: *x": "line 2: not valid YAML (an alias",
    "a: !!python/none x": "a tag (!)",
    "<<: {a: 1}": "a merge key (<<)",
    "a: 1\n---\nb: 2": "line 2: not valid YAML (a second document",
    "? [1, 2]\n: 3": "a key that is a list or a mapping",
    "[" * 150: "brackets more than 100 deep",
    "a: 2026-99-99": "not valid YAML",
}


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_what_deceives_is_refused_with_its_line(text):
    with pytest.raises(TagvoError) as caught:
        parse_yaml(text, "w")
    assert REFUSED[text] in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_key_that_stands_twice_in_json_is_refused():
    assert parse_json('{"a": 1, "b": {"a": 2}}', "w") == {"a": 1, "b": {"a": 2}}
    with pytest.raises(TagvoError, match="the key 'a' stands twice"):
        parse_json('{"b": {"a": 1, "a": 2}}', "w")


@pytest.mark.parametrize("read", [read_yaml, read_json])
def test_a_file_beyond_all_use_is_refused_before_it_is_read(tmp_path, read):
    path = tmp_path / "huge"
    path.touch()
    os.truncate(path, 10**12)  # sparse: reading it would end this process
    with pytest.raises(TagvoError, match="1000000 MB; at most 32 MB are read"):
        read(path)


def test_a_large_map_is_read_without_a_tree_of_nodes(monkeypatch):
    monkeypatch.setattr(
        textfile._Loader, "resolve", lambda *_: pytest.fail("a number was resolved")
    )
    rows = "".join(f"- [{i}, {i}.25, -0.5, 1.0e-3]\n" for i in range(100))
    assert parse_yaml(rows, "w")[7] == [7, 7.25, -0.5, 1e-3]
