"""README and docs tell the truth: their commands run, their options exist, their Python works.

The demo's log is made once a run, whoever needs it first; each section's commands are a test of
their own, so that workers share them. Commands run in this process: a process of their own would
load compiled code for 3 s each; what a process adds is tested in test_commands_cli and test_daemon.
"""

import contextlib
import io
import json
import os
import re

import pytest
from cli_calls import tagvio
from doc_pages import (
    PAGES,
    ROOT,
    Chain,
    blocks,
    chains,
    console_lines,
    tagvio_calls,
    text_of,
    written_calls,
)
from once import once

README = text_of(ROOT / "README.md")
# Commands whose run is another test: test_commands_cli.test_warmup_says_how_long_it_took.
ELSEWHERE = [["warmup"]]


@contextlib.contextmanager
def user_in(folder):
    """Within it the process is a user's: in a folder, on a terminal of 100 columns."""
    with contextlib.chdir(folder), pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "100")
        yield


def run(words, folder):
    with user_in(folder):
        done = tagvio(*words)
    assert done.code == 0, f"tagvio {' '.join(words)}: {done.err}"
    return done.out


@pytest.fixture(scope="session")
def demo(tmp_path_factory):
    """The folder where `tagvio demo --quick` has run, and what it said; once for all workers."""

    def make(shared):
        output = run(["demo", "--out", "demo", "--quick"], shared)
        (shared / "said").write_text(output, encoding="utf-8")

    return once(tmp_path_factory, "readme", make)


@pytest.fixture
def clone(tmp_path, demo):
    """A folder that looks like a clone to the commands, with the demo in it, to be written to."""
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    (tmp_path / "demo").symlink_to(demo / "demo")
    return tmp_path


def test_the_demo_leaves_and_says_what_readme_shows(demo):
    from vio.sources.flight_log.log import FlightLog

    folder, output = demo / "demo", (demo / "said").read_text(encoding="utf-8")
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


def sections():
    """What there is to run: of README what no other page has, of each page its sections."""
    every = chains()
    elsewhere = [line for c in every if c.page.name != "README.md" for line in c.lines]
    once = [
        Chain(c.page, c.heading, tuple(line for line in c.lines if line not in elsewhere))
        if c.page.name == "README.md"
        else c
        for c in every
    ]
    return [c for c in once if tagvio_calls(c.lines)]


MAKES = {  # words of a command -> what it leaves, be it empty where no tag of interest was seen
    "run": ("vo.tum", "vio.tum", "run.json"),
    "compare": ("comparison.json", "evaluation.json", "report.html"),
    "simulate": ("mav0/imu0/data.csv", "truth_rig.yaml"),
}


@pytest.mark.parametrize("section", sections(), ids=str)
def test_commands_of_a_section_run_one_after_the_other(section, clone):
    for words in tagvio_calls(section.lines):
        if words[0] == "demo":
            assert words == ["demo", "--out", "demo"]  # with --quick the fixture's own call
            assert (clone / "demo/joint/report.html").stat().st_size > 0
            continue
        if words in ELSEWHERE:
            continue
        out = run(words, clone)
        if words[:2] == ["map", "check"]:
            assert out in text_of(section.page), "the page shows another output of `map check`"
        folder = words[words.index("--out") + 1] if "--out" in words else "."
        for made in MAKES.get(words[0], ()):
            assert (clone / folder / made).is_file(), made
        for made in (w for w in words if w.endswith((".pdf", ".png", ".fmap"))):
            assert (clone / made).stat().st_size > 0, made


def test_each_command_block_of_readme_and_docs_is_run():
    ran = [line for section in sections() for line in section.lines]
    written = [line for page in PAGES for line in console_lines(text_of(page)) if "tagvio" in line]
    assert [line for line in written if line not in ran] == []
    assert len({tuple(words) for words in tagvio_calls(ran)}) >= 12


def names_of(words):
    """The command that help is asked for: `map check`, `run`; () for tagvio itself."""
    head = [w for w in words[:2] if not w.startswith("-")]
    return tuple(head[: 2 if head[:1] == ["map"] else 1])


def test_every_option_is_known_to_its_command(tmp_path):
    helps = {}
    for words in written_calls():
        names = names_of(words)
        if names not in helps:
            done = tagvio(*names, "--help")
            assert done.code == 0, f"tagvio {' '.join(names)}: {done.err}"
            helps[names] = done.out
        options = {w for w in words if re.match(r"--?[a-z]", w)} - {"--help", "--version"}
        missing = [o for o in options if not re.search(rf"{o}\b", helps[names])]
        assert missing == [], f"tagvio {' '.join(words)}"
    assert len(helps) >= 15


@pytest.mark.skipif("TAGVIO_DATA" not in os.environ, reason="TAGVIO_DATA is not set: no real logs")
@pytest.mark.parametrize(
    "words",
    sorted({tuple(w) for w in written_calls() if any("$TAGVIO_DATA" in word for word in w)}),
    ids=" ".join,
)
def test_measured_commands_run(words, tmp_path):
    run([w.replace("$TAGVIO_DATA", os.environ["TAGVIO_DATA"]) for w in words], tmp_path)


PYTHON = [(page, i) for page in PAGES for i, _ in enumerate(blocks(text_of(page), "python"))]


@pytest.mark.parametrize(("page", "i"), PYTHON, ids=lambda v: getattr(v, "stem", str(v)))
def test_python_blocks_run(page, i, clone):
    code, out = blocks(text_of(page), "python")[i], io.StringIO()
    with user_in(clone), contextlib.redirect_stdout(out):
        exec(compile(code, f"{page}, block {i}", "exec"), {"__name__": "__main__"})
    assert "(6, 6)" in out.getvalue()


def test_readme_has_a_python_example():
    assert blocks(README, "python")


def test_the_yaml_block_is_a_map_that_loads():
    from tagvo.tags.tag_map import map_from_dict
    from tagvo.textfile import parse_yaml

    (text,) = blocks(text_of(ROOT / "docs/reference/files.md"), "yaml")
    assert len(map_from_dict(parse_yaml(text, "files.md"), "files.md")) == 1


def test_readme_ci_and_the_check_script_are_of_one_mind():
    ci = (ROOT / ".ci" / "run").read_text()
    check = (ROOT / "tools" / "check").read_text()
    install = "pip install -e '.[test]'"
    first, second = console_lines(README)[:2]
    assert install in first
    assert second == "tools/check"
    assert "pip install -q --no-compile -e '.[test]'" in ci
    assert re.search(r"^tools/check$", ci, re.MULTILINE)
    assert install in check
    assert 'mkdocs" build --strict' in check
    assert all(os.access(ROOT / script, os.X_OK) for script in ("tools/check", ".ci/run"))


def test_readme_is_short():
    assert len(README.splitlines()) <= 150
