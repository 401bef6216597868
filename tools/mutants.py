"""Small wrong edits of the code, each of which some test must see: tests/mutants/*.patch.

A patch's first line names its tests (`# tests: FILE[::NAME] ...`). Each is applied to a copy of the
tracked files, those tests run there and have to fail. They must pass without it, which is looked at
first. Last line: `mutants N killed N survived N`; exit 1 where one survived or does not apply.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "tests/mutants"
_LONGEST_S = 900.0  # one mutant's tests, compiled anew; beyond that it hangs, which also is seen
_FAILED = 1  # pytest's exit code for tests that failed; others say that nothing was tested


def copy_tree(to: Path) -> None:
    """The tracked files, and the compiled code beside them that is still theirs: both with times.

    A patch to a kernel is newer than all compiled code, which is then dropped at import.
    """
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True)
    paths = [ROOT / name for name in listed.stdout.decode().split("\0") if name]
    cached = [p for top in ("tagvo", "vio") for p in (ROOT / top).rglob("*.nb[ic]")]
    for path in (p for p in [*paths, *cached] if p.is_file()):
        target = to / path.relative_to(ROOT)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, target)


def tests_of(patch: Path) -> list[str]:
    """The tests that the first line of a patch names."""
    head, _, names = patch.read_text().partition("\n")[0].partition("# tests:")
    if head or not names.split():
        raise SystemExit(f"{patch}: first line: {head!r}; `# tests: FILE[::NAME] ...` is needed")
    return names.split()


def run_tests(tree: Path, names: list[str]) -> tuple[int, str]:
    """pytest's exit code and the first test that failed, or its last words."""
    env = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    words = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *names]
    try:
        done = subprocess.run(words, cwd=tree, env={**env, "PYTHONPATH": str(tree)}, text=True,
                              capture_output=True, timeout=_LONGEST_S)  # fmt: skip
    except subprocess.TimeoutExpired:
        return _FAILED, f"{names[0]} (hangs)"
    lines = done.stdout.splitlines()
    failed = [line.split()[1] for line in lines if line.startswith("FAILED ")]
    return done.returncode, failed[0] if failed else (lines or done.stderr.splitlines() or [""])[-1]


def judge(patch: Path) -> tuple[bool, str]:
    """Whether the mutant is killed, and by which test."""
    names = tests_of(patch)
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder)
        copy_tree(tree)
        done = subprocess.run(["git", "apply", "--unsafe-paths", str(patch)], cwd=tree,
                              text=True, capture_output=True)  # fmt: skip
        if done.returncode != 0:
            return False, f"does not apply: {' '.join(done.stderr.split())}"
        code, test = run_tests(tree, names)
    return code == _FAILED, test


def main() -> None:
    """Judge the mutants named, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="such as 03-gap-scale; none: all")
    wanted = parser.parse_args().names
    known = {path.stem: path for path in sorted(FOLDER.glob("*.patch"))}
    unknown = [name for name in wanted if name not in known]
    if unknown:
        raise SystemExit(f"{unknown[0]}: no such mutant; choose of {', '.join(known)}")
    patches = [known[name] for name in wanted or known]
    code, test = run_tests(ROOT, sorted({name for patch in patches for name in tests_of(patch)}))
    if code != 0:
        raise SystemExit(f"without any mutant: {test}; these tests must pass first")
    killed = 0
    for patch in patches:
        dead, test = judge(patch)
        killed += dead
        print(f"{patch.stem} {f'killed by {test}' if dead else f'SURVIVED ({test})'}", flush=True)
    print(f"mutants {len(patches)} killed {killed} survived {len(patches) - killed}")
    sys.exit(killed < len(patches))


if __name__ == "__main__":
    main()
