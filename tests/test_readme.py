"""README tells the truth: its commands run, its options exist, its Python works, its links lead."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TAGVIO = [sys.executable, "-c", "from vio.cli import main; main()"]


def blocks(kind: str) -> list[str]:
    """Contents of the fenced blocks of one kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", README, re.DOTALL | re.MULTILINE)


def console_lines() -> list[str]:
    """Commands of the console blocks, without their prompts and outputs."""
    return [line[2:] for b in blocks("console") for line in b.splitlines() if line[:2] == "$ "]


def tagvio_calls(lines: list[str]) -> list[list[str]]:
    """The words after `tagvio` of each command of that name, wherever it is installed."""
    calls = [part for line in lines for part in line.split("&&")]
    words = [shlex.split(call) for call in calls]
    return [w[1:] for w in words if Path(w[0]).name == "tagvio"]


def inline_calls() -> list[list[str]]:
    """Commands in backquotes within the text and the tables."""
    found = re.findall(r"`(tagvio [^`]*)`", README)
    return tagvio_calls(found)


def run(words, cwd):
    env = {**os.environ, "COLUMNS": "100"}
    done = subprocess.run(
        [*TAGVIO, *words], cwd=cwd, env=env, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"tagvio {' '.join(words)}: {done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """A folder that looks like a clone to the commands, and may be written to."""
    folder = tmp_path_factory.mktemp("clone")
    (folder / "configs").symlink_to(ROOT / "configs")
    return folder


def check_demo(folder, output):
    """What `tagvio demo --quick` leaves and says."""
    from vio.sources.flight_log.log import FlightLog

    log = FlightLog.open(folder / "log")
    assert (log.frame_count, len(log.truth), log.warnings) == (61, 401, [])
    rms = {}
    for name in ("new", "joint"):
        content = json.loads((folder / name / "comparison.json").read_text())
        assert (content["frames"]["total"], content["frames"]["with_pose"]) == (61, 61)
        rms[name] = content["estimators"]["vo"]["capture"]["position_rmse_m"]
        assert content["estimators"]["vo"]["capture"]["coverage"] == 1.0
        for file in ("report.html", "run.json", "vo.tum"):
            assert (folder / name / file).stat().st_size > 100
        assert json.loads((folder / name / "run.json").read_text())["setup"] == []
    assert rms["joint"] < rms["new"] < 0.02
    held, live = (content["estimators"][name]["now"] for name in ("vo", "vio"))
    assert content["frames"]["fused"] > 50
    assert live["coverage"] > 0.8
    assert live["position_rmse_m"] < 0.5 * held["position_rmse_m"]
    assert 0.02 < live["nees_pose"] < 3.0
    first, second = output.strip().splitlines()[-2:]
    assert f"the joint pose is {1e3 * rms['joint']:.1f} mm" in first
    assert f"the paper's {1e3 * rms['new']:.1f} mm" in first
    assert f"the last joint pose held is {1e3 * held['position_rmse_m']:.1f} mm" in second
    assert f"the filter (vio) {1e3 * live['position_rmse_m']:.1f} mm" in second


def test_commands_run_one_after_the_other(clone):
    calls = tagvio_calls(console_lines())
    assert len(calls) >= 8
    for words in calls:
        out = run([*words, "--quick"] if words[0] == "demo" else words, clone)
        if words[0] == "demo":
            check_demo(clone / "demo", out)
        if words[:2] == ["map", "check"]:
            assert out in README, "README shows another output of `map check`"
    files = ("demo/joint/report.html", "out/vo.tum", "out/comparison.json", "map.png", "hall.pdf")
    for made in files:
        assert (clone / made).stat().st_size > 0, made


def test_every_option_is_known_to_its_command(clone):
    calls = tagvio_calls(console_lines()) + inline_calls()
    helps: dict[tuple[str, ...], str] = {}
    for words in calls:
        names = tuple(words[: 2 if words[0] == "map" else 1])
        if names not in helps:
            helps[names] = run([*names, "--help"], clone)
        options = {w for w in words if w.startswith("-")} - {"--help"}
        missing = [o for o in options if not re.search(rf"{o}\b", helps[names])]
        assert missing == [], f"tagvio {' '.join(words)}"
    assert len(helps) >= 6


@pytest.mark.skipif("TAGVIO_DATA" not in os.environ, reason="TAGVIO_DATA is not set: no real logs")
def test_measured_commands_run(clone):
    calls = {tuple(w) for w in inline_calls() if any("$TAGVIO_DATA" in word for word in w)}
    assert calls
    for words in sorted(calls):
        run([w.replace("$TAGVIO_DATA", os.environ["TAGVIO_DATA"]) for w in words], clone)


def test_python_blocks_run(clone):
    codes = blocks("python")
    assert codes
    for code in codes:
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=clone, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        assert "(6, 6)" in done.stdout


def test_the_yaml_block_is_a_map_that_loads():
    from tagvo.tags.tag_map import map_from_dict
    from tagvo.textfile import parse_yaml

    (text,) = blocks("yaml")
    assert len(map_from_dict(parse_yaml(text, "README"), "README")) == 1


def test_readme_ci_and_the_check_script_are_of_one_mind():
    ci = (ROOT / ".ci" / "run").read_text()
    install = "pip install -e '.[test]'"
    first, second = console_lines()[:2]
    assert install in first
    assert second == "tools/check"
    assert "pip install -q -e '.[test]'" in ci
    assert re.search(r"^tools/check$", ci, re.MULTILINE)
    assert install in (ROOT / "tools" / "check").read_text()
    assert all(os.access(ROOT / script, os.X_OK) for script in ("tools/check", ".ci/run"))


def test_links_and_named_files_exist():
    links = re.findall(r"\]\((?!https?:)([^)#]+)\)", README)
    named = re.findall(r"`((?:tools|configs|tests)/[\w./-]+)`", README)
    assert links
    assert named
    assert [path for path in links + named if not (ROOT / path).exists()] == []


def test_configuration_keys_of_the_table_exist():
    from vio.config import load_config

    rows = re.findall(r"^\| `((?:tagvo|vio)\.[\w.]+)` \| ([^|]+) \|", README, re.MULTILINE)
    assert len(rows) >= 12
    for key, values in rows:
        for value in re.findall(r"`([\w.]+)`", values):
            load_config(None, [f"{key}={value}"])
