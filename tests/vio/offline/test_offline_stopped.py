"""A run that is stopped says how far it came, and is judged up to there alone."""

import json
from contextlib import contextmanager

import pytest
from cli_calls import tagvio, write_true_log
from flying_log import write_flying_log


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write_true_log(tmp_path_factory.mktemp("log"))


@pytest.fixture(scope="module")
def flying(tmp_path_factory):
    return write_flying_log(tmp_path_factory.mktemp("flying"), 3.0)


@pytest.fixture
def ctrl_c(monkeypatch):
    """Makes Ctrl-C come when a command has asked for it so often."""

    def after(asked: int, module: str) -> None:
        count = iter(range(10**9))

        @contextmanager
        def gently():
            yield lambda: next(count) >= asked

        monkeypatch.setattr(f"{module}.gently", gently)

    return after


def comparison(out):
    return json.loads((out / "comparison.json").read_text())


def test_compare_is_judged_up_to_where_it_was_stopped(flying, tmp_path, ctrl_c):
    ctrl_c(400, "vio.offline.replay")
    done = tagvio("compare", flying, "--out", tmp_path)
    assert done.code == 130
    assert "stopped by Ctrl-C after 1.9 of 3.0 s" in done.err
    content = comparison(tmp_path)
    assert content["interrupted"] is True
    assert json.loads((tmp_path / "evaluation.json").read_text())["interrupted"] is True
    now = content["estimators"]["vo"]["now"]
    assert now["position_max_m"] < 0.3  # held over the second that was not run, it is metres off
    assert now["n"] <= 20


def test_run_says_how_far_it_came(log, tmp_path, ctrl_c):
    ctrl_c(5, "vio.offline.replay")
    done = tagvio("run", log, "--out", tmp_path)
    assert done.code == 130
    assert "stopped by Ctrl-C after 0.2 of 0.6 s" in done.err
    assert json.loads((tmp_path / "run.json").read_text())["interrupted"] is True


def test_convert_says_how_far_it_came(log, tmp_path, ctrl_c):
    ctrl_c(2, "vio.commands.convert")
    done = tagvio("convert", log, "--out", tmp_path / "out")
    assert done.code == 130
    assert "stopped by Ctrl-C after 3 of 12 frames" in done.err


def test_what_ends_by_itself_is_not_stopped(log, tmp_path):
    done = tagvio("compare", log, "--out", tmp_path)
    assert done.code == 0
    assert "stopped" not in done.err
    assert "interrupted" not in comparison(tmp_path)
    assert json.loads((tmp_path / "evaluation.json").read_text())["interrupted"] is False


def test_skipping_the_whole_log_is_refused(log, tmp_path):
    done = tagvio("compare", log, "--out", tmp_path, "--skip", "100")
    assert done.code == 1
    assert "--skip 100" in done.err
    assert "lasts 0.6 s; fewer are needed" in done.err
    assert not (tmp_path / "comparison.json").exists()
