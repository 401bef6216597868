"""Configuration: the shipped files say what they claim; every wrong key or value is named."""

from pathlib import Path
from typing import Literal

import numpy as np
import pytest
import yaml
from pydantic import BaseModel, Field

from tagvo.camera.calibration import load_camera
from tagvo.config import TagvoConfig, load_tagvo_config
from tagvo.errors import ConfigError
from vio.config import Config, load_config
from vio.config.describe import commented_yaml, keys
from vio.sim.scenario import Scenario

CONFIGS = Path(__file__).parents[3] / "configs"
PAPER = {  # the paper's columns: select, outliers, weights, mean
    "JBT": ("JBT", "none", "W2", "QL2"),
    "ALL-notOR": ("ALL", "none", "W2", "QL2"),
    "ALL-OR": ("ALL", "iqr", "W2", "QL2"),
    "TBS-notOR": ("TBS", "none", "W2", "QL2"),
    "TBS-OR": ("TBS", "iqr", "W2", "QL2"),
    "TBS-OR-W1-CL2": ("TBS", "iqr", "W1", "CL2"),
    "TBS-OR-W2-CL2": ("TBS", "iqr", "W2", "CL2"),
    "TBS-OR-W1-QL2": ("TBS", "iqr", "W1", "QL2"),
    "NEW": ("TBS", "iqr", "W2", "QL2"),
}


def leaves(data, path=()):
    """Every key of a nested mapping as a dotted name, with its value."""
    if isinstance(data, dict):
        return {k: v for key in data for k, v in leaves(data[key], (*path, key)).items()}
    return {".".join(path): data}


def test_arena_yaml_holds_every_key_at_its_default():
    written = leaves(yaml.safe_load((CONFIGS / "arena.yaml").read_text()))
    assert written == leaves(Config().model_dump(mode="json"))
    assert load_config(CONFIGS / "arena.yaml") == Config()


def test_the_daemons_example_loads_and_names_files_that_are_there():
    path = CONFIGS / "daemon.yaml"
    daemon = load_config(path).daemon
    assert (CONFIGS / daemon.map).is_file()
    assert (CONFIGS / daemon.calibration).is_file()


def test_every_key_is_told():
    assert {k.name for k in keys(Config)} >= set(leaves(Config().model_dump()))


@pytest.mark.parametrize("model", [Config, Scenario])
def test_every_key_says_what_it_means_where_it_is_defined(model):
    told = list(keys(model))
    assert len(told) > 100
    assert [k.name for k in told if len(k.meaning.split()) < 2] == []
    assert [k.name for k in told if k.section is None and not k.allowed] == []


def test_arena_yaml_is_written_from_the_models():
    written = (CONFIGS / "arena.yaml").read_text(encoding="utf-8")
    assert written == commented_yaml(Config), "configs/arena.yaml: run tools/write_docs.py"


class Inner(BaseModel):
    """A section."""

    on: bool = Field(default=True, description="whether it is on")


class Outer(BaseModel):
    """Every sort of key."""

    word: Literal["off", "on"] = Field(default="off", description="a word that YAML takes for bool")
    share: float | None = Field(default=None, ge=0.0, lt=1.0, description="a share or nothing")
    names: tuple[str, ...] = Field(default=("a", "b"), description="a list")
    rows: tuple[tuple[float, ...], ...] = Field(default=((1.0, 2.0),), description="a matrix")
    must: str = Field(description="a key without default")
    inner: Inner = Field(default=Inner(), description="a section")
    maybe: Inner | None = Field(default=None, description="a section or nothing")
    many: tuple[Inner, ...] = Field(default=(), description="sections in a list")


def test_a_model_tells_its_keys():
    assert [(k.name, k.default, k.allowed) for k in keys(Outer)] == [
        ("word", '"off"', "off, on"),
        ("share", "null", "≥ 0, < 1 or null"),
        ("names", "[a, b]", "list"),
        ("rows", "[[1.0, 2.0]]", "list"),
        ("must", "needed", "text"),
        ("inner", "", "a section"),
        ("inner.on", "true", "true, false"),
        ("maybe", "null", "a section or null"),
        ("maybe.on", "true", "true, false"),
        ("many", "[]", "list of sections"),
        ("many[].on", "true", "true, false"),
    ]
    text = commented_yaml(Outer, "# head\n")
    assert text.startswith('# head\nword: "off" # a word')
    assert "rows: # a matrix\n  - [1.0, 2.0]\n" in text
    assert "inner: # a section\n  on: true # whether it is on\n" in text
    assert yaml.safe_load(text)["word"] == "off"


def test_every_paper_variant_is_four_strings():
    assert {p.stem for p in (CONFIGS / "paper").glob("*.yaml")} == set(PAPER)
    for name, strings in PAPER.items():
        cfg = load_config(CONFIGS / "paper" / f"{name}.yaml").tagvo
        assert (cfg.select, cfg.outliers, cfg.weights, cfg.mean) == strings
        same = {"select": "TBS", "outliers": "iqr", "weights": "W2", "mean": "QL2"}
        rest = cfg.model_copy(update=same)
        assert rest == TagvoConfig(pose="fused", ambiguity="first"), name
        assert load_tagvo_config(CONFIGS / "paper" / f"{name}.yaml") == cfg


def test_arena_camera_looks_down_from_its_mount():
    camera = load_camera(CONFIGS / "cameras" / "arena.yaml")
    R_IC, p_IC = camera.R_CI.T, -camera.R_CI.T @ camera.p_CI
    np.testing.assert_allclose(p_IC, [0.10, 0.0, -0.05], atol=1e-12)
    np.testing.assert_allclose(R_IC @ [0, 0, 1], [0, 0, -1], atol=1e-12)  # looks down
    np.testing.assert_allclose(R_IC @ [0, -1, 0], [1, 0, 0], atol=1e-12)  # image top: ahead
    np.testing.assert_allclose(R_IC @ [1, 0, 0], [0, -1, 0], atol=1e-12)  # image right: right
    assert camera.resolution == (640, 480)
    assert 2 * np.degrees(np.arctan(320 / camera.intrinsics[0])) == pytest.approx(62, abs=0.5)


def test_assignments_overrule_the_file_and_the_last_one_wins(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("tagvo:\n  select: JBT\n  iqr:\n    gain: 2.0\n    floor_m: 0.01\n")
    cfg = load_config(path, ["tagvo.iqr.gain=3", "tagvo.mean=CL2", "tagvo.iqr.gain=4e0"]).tagvo
    assert (cfg.select, cfg.mean) == ("JBT", "CL2")
    assert (cfg.iqr.gain, cfg.iqr.floor_m) == (4.0, 0.01)


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("tagvo.poze=joint", ["tagvo", "unknown 'poze'", "pose, select, outliers"]),
        ("tagvo.iqr.gian=2", ["tagvo.iqr", "unknown 'gian'", "gain, quartiles, floor_m"]),
        ("tagwo.pose=joint", ["unknown 'tagwo'", "tagvo, vehicle"]),
        ("tagvo.pose=both", ["tagvo.pose", "unknown 'both'", "fused, joint"]),
        ("tagvo.iqr.gain=-1", ["tagvo.iqr.gain", "-1", "greater than 0"]),
        ("tagvo.iqr.gain=.nan", ["tagvo.iqr.gain", "nan"]),
        ("tagvo.fir_gap_s=.inf", ["tagvo.fir_gap_s", "inf", "1000000"]),
        ("tagvo.noise.corner_px=.inf", ["tagvo.noise.corner_px", "inf", "1000"]),
        ("tagvo.iqr=3", ["tagvo.iqr", "3", "mapping"]),
        ("tagvo.iqr.gain.x=1", ["tagvo.iqr.gain", "number"]),
        ("tagvo.refine=99", ["tagvo.refine", "99", "10"]),
        ("tagvo.pose", ["KEY.KEY=VALUE"]),
        ("=1", ["KEY.KEY=VALUE"]),
        ("tagvo..pose=joint", ["KEY.KEY=VALUE"]),
        ("tagvo.pose=[", ["not valid YAML"]),
        ("vehicle.T_BI=[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]", ["T_BI", "rotation"]),
        ("vehicle.T_BI=[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,2]]", ["T_BI", "0 0 0 1"]),
        ("vehicle.T_BI=[[1,0,0,.nan],[0,1,0,0],[0,0,1,0],[0,0,0,1]]", ["T_BI", "finite"]),
    ],
)
def test_a_wrong_assignment_is_named_with_what_is_allowed(assignment, says):
    with pytest.raises(ConfigError) as caught:
        load_config(None, [assignment])
    text = str(caught.value)
    assert all(part in text for part in [f"--set {assignment}", *says]), text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "empty"),
        ("- a\n", "mapping"),
        ("tagvo: 3\n", "mapping"),
        ("tagvo:\n  pose: 3\n", "fused, joint"),
        ("tagvo: [\n", "not valid YAML"),
        ("tagvo:\n  nope: 3\n", "unknown 'nope'"),
    ],
)
def test_a_wrong_file_is_named(tmp_path, content, says):
    path = tmp_path / "c.yaml"
    path.write_text(content)
    with pytest.raises(ConfigError) as caught:
        load_config(path)
    assert str(path) in str(caught.value)
    assert says in str(caught.value)


def test_a_mapping_given_twice_is_merged_not_replaced():
    cfg = load_config(None, ["tagvo={select: ALL}", "tagvo.mean=CL2"]).tagvo
    assert (cfg.select, cfg.mean) == ("ALL", "CL2")
