"""A filter that is no use is named as such, and a healthy one never."""

import json
import shutil

import numpy as np
import pytest
import yaml
from cli_calls import tagvio
from flying_log import write_flying_log


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    return write_flying_log(tmp_path_factory.mktemp("flying"), 4.0)


def rewrite(path, change):
    """The rows of a CSV file of numbers below its header, changed; stamps stay exact."""
    head, *rows = path.read_text().splitlines()
    cells = [row.split(",") for row in rows]
    values = change(np.array([[float(x) for x in row[1:7]] for row in cells]))
    lines = [
        ",".join([row[0], *map(repr, v.tolist())]) for row, v in zip(cells, values, strict=True)
    ]
    path.write_text("\n".join([head.split(",arrival")[0], *lines]) + "\n")


def warnings_of(log, out, *words):
    done = tagvio("run", log, "--out", out, *words)
    assert done.code == 0, done.err
    return " ".join(json.loads((out / "run.json").read_text())["warnings"])


@pytest.mark.parametrize("words", [(), ("--blackout", "3,1"), ("--every", "2")])
def test_a_healthy_filter_is_not_doubted(flying, tmp_path, words):
    assert "not to be trusted" not in warnings_of(flying, tmp_path, *words)


def test_a_filter_that_keeps_starting_anew_is_named(tmp_path):
    log = write_flying_log(tmp_path, 4.0)
    rewrite(log / "mav0/imu0/data.csv", lambda v: v * [1, 1, 1, -1, -1, -1])
    said = warnings_of(log, tmp_path / "out", "--force")
    assert "the filter started anew" in said
    assert "samples while frames gave poses" in said
    assert "vio is not to be trusted" in said


def with_camera(log, out, **keys):
    """A copy of the log with another camera file."""
    shutil.copytree(log, out)
    path = out / "camchain-imucam.yaml"
    chain = yaml.safe_load(path.read_text())
    chain["cam0"].update(keys)
    path.write_text(yaml.safe_dump(chain))
    return out


def test_a_camera_file_of_another_lens_does_not_fit(flying, tmp_path):
    lens = {"distortion_model": "radtan", "distortion_coeffs": [0.2, 0.0, 0.0, 0.0]}
    other = with_camera(flying, tmp_path / "log", intrinsics=[500.0, 500.0, 320.0, 200.0], **lens)
    said = warnings_of(other, tmp_path / "out", "--vo-only")
    assert "camchain-imucam.yaml: in " in said
    assert "intrinsics or lens distortion are not this camera's" in said
    assert "this camera's" not in warnings_of(flying, tmp_path / "right", "--vo-only")


def test_corners_beyond_the_camera_files_image_are_named_with_both_sizes(flying, tmp_path):
    other = with_camera(flying, tmp_path / "log", resolution=[320, 240])
    said = warnings_of(other, tmp_path / "out", "--vo-only")
    assert "outside the camera file's 320x240 pixels (they fill 6" in said
    assert "of another camera or resolution?" in said
