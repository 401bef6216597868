"""The mutants' patches fit today's code, and the tests that they name are there; `tools/mutants.py`
runs them."""

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PATCHES = sorted((ROOT / "tests/mutants").glob("*.patch"))


def test_there_are_fourteen():
    assert len(PATCHES) == 14


@pytest.mark.parametrize("patch", PATCHES, ids=lambda p: p.stem)
def test_a_mutant_applies_and_names_a_test_that_is_there(patch):
    if not (ROOT / ".git").exists():
        pytest.skip("no git here")
    done = subprocess.run(["git", "apply", "--check", str(patch)], cwd=ROOT, capture_output=True,
                          text=True)  # fmt: skip
    assert done.returncode == 0, done.stderr
    head, names = patch.read_text().split("\n", 1)[0].split(": ", 1)
    assert head == "# tests"
    for name in names.split():
        file, _, test = name.partition("::")
        assert f"def {test}" in (ROOT / file).read_text()
