"""A filter that is no use is named as such, and a healthy one never."""

import json

import numpy as np
import pytest
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
