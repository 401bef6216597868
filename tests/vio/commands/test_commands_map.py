"""`tagvio map`: what it prints, how it exits, and that its help costs no heavy import."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tagvo.errors import MapError
from tagvo.maps.formats import FORMATS
from tagvo.tags.tag_map import load_map
from vio.commands.map import MapFormat, app

DATA = os.environ.get("TAGVIO_DATA")
SOUND = """\
family: tagStandard41h12
gravity: {dir: [0, 0, -1], sigma_deg: 1}
tags:
  - {id: 0, size: 0.1, p: [0, 0, 0], q: [1, 0, 0, 0]}
  - {id: 1, size: 0.2, p: [0.5, 0, 0], q: [1, 0, 0, 0]}
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "tagmap.yaml"
    file.write_text(SOUND)
    return file


def run(*words: object):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_formats_of_the_command_are_those_of_the_library():
    assert {fmt.value for fmt in MapFormat} == set(FORMATS)


def test_check_prints_both_sizes_and_exits_0(path):
    result = run("check", path)
    assert result.exit_code == 0, result.output
    assert "border 100 mm, total 180 mm: 1 tags" in result.output
    assert "border 200 mm, total 360 mm: 1 tags" in result.output
    assert "0 errors, 0 warnings" in result.output


def test_check_exits_0_with_warnings(path):
    path.write_text(SOUND.replace("p: [0.5, 0, 0]", "p: [0.2, 0, 0]"))
    result = run("check", path)
    assert result.exit_code == 0
    assert "warning: " in result.output
    assert "0 errors, 1 warnings" in result.output


def test_check_prints_every_error_and_exits_1(path):
    path.write_text(SOUND.replace("size: 0.2", "size: -1").replace("q: [1, 0, 0, 0]", "q: [2, 0]"))
    result = run("check", path)
    assert result.exit_code == 1
    assert result.output.count("error: ") == 3
    assert "3 errors, 0 warnings" in result.output


def test_check_shows_the_sizes_of_a_map_whose_tags_overlap(path):
    path.write_text(SOUND.replace("p: [0.5, 0, 0]", "p: [0.1, 0, 0]"))
    result = run("check", path)
    assert result.exit_code == 1
    assert "total 360 mm" in result.output


@pytest.mark.skipif(DATA is None, reason="TAGVIO_DATA is not set")
def test_check_of_eurocs_board():
    result = run("check", Path(DATA or "") / "euroc_imu_april" / "tagmap.yaml")
    assert result.exit_code == 0
    assert "border 88 mm, total 105.6 mm: 36 tags" in result.output


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_show_writes_a_picture(path, tmp_path, suffix):
    out = tmp_path / f"map{suffix}"
    assert run("show", path, "--out", out).exit_code == 0
    assert out.stat().st_size > 10_000


def test_convert_there_and_back_with_losses_said(path, tmp_path):
    out, back = tmp_path / "tags.yaml", tmp_path / "back.yaml"
    result = run("convert", path, out, "--to", "apriltag_ros1")
    assert result.exit_code == 0, result.output
    for lost in ("no family: tagStandard41h12", "no sigma", "no gravity"):
        assert f"{lost}" in result.output
    result = run("convert", out, back, "--family", "tagStandard41h12")
    assert result.exit_code == 0, result.output
    assert load_map(back).size.tolist() == [0.1, 0.2]


def test_convert_guesses_the_format_of_fmap(path, tmp_path):
    assert run("convert", path, tmp_path / "m.fmap").exit_code == 0
    fiducials = json.loads((tmp_path / "m.fmap").read_text())["fiducials"]
    assert [f["size"] for f in fiducials] == [100.0, 200.0]


def test_known_errors_propagate_to_the_cli(path, tmp_path):
    out = tmp_path / "field.json"
    assert run("convert", path, out, "--to", "wpilib").exit_code == 0
    result = run("convert", out, tmp_path / "back.yaml")
    assert isinstance(result.exception, MapError)
    assert "--size" in str(result.exception)
    result = run("check", tmp_path / "nowhere.yaml")
    assert isinstance(result.exception, MapError)
    assert "no such file" in str(result.exception)


@pytest.mark.parametrize(
    "words",
    [
        ("convert", "a.yaml", "b.txt"),
        ("convert", "a.yaml", "b.yaml", "--to", "vrml"),
        ("convert", "a.yaml", "b.yaml", "--size", "-1"),
        ("show", "a.yaml", "--out", "a.pdf"),
        ("check",),
        ("paint",),
    ],
)
def test_wrong_usage_exits_2(words):
    assert run(*words).exit_code == 2


def test_help_shows_examples_and_imports_nothing_heavy():
    for command in ("check", "show", "convert"):
        assert f"tagvio map {command}" in run(command, "--help").output
    code = (
        "import sys, vio.commands.map; heavy = {'numpy', 'cv2', 'scipy', 'matplotlib', 'yaml'}"
        "; assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[3])
