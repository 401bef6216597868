"""Every reader survives damaged inputs: a part of what tools/fuzz.py does, with a fixed seed."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("pyulog")
FUZZ = Path(__file__).parents[3] / "tools/fuzz.py"


def fuzz(*words) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(FUZZ), *map(str, words)]
    # image libraries print bytes of the damaged file
    return subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=300)


def test_no_reader_falls_over_damaged_inputs():
    done = fuzz("--inputs", 12_000, "--seed", 14)
    assert done.returncode == 0, done.stderr[-2000:]
    last = done.stdout.splitlines()[-1]
    assert last.startswith("inputs 12")
    assert last.endswith("tracebacks 0 hangs 0 over_memory 0")


def test_the_fuzzer_sees_a_traceback_a_hang_and_a_death(tmp_path):
    """A reader that does all of it on purpose, so that the zeros above mean something."""
    code = f"""
import sys; sys.path[:0] = [{str(FUZZ.parent)!r}]
import os, time, fuzz
from fuzz_inputs import Reader
from pathlib import Path
fuzz.MEMORY_KB = 50 * 1024
fuzz.watch()
good = b"0" * 50
def read(path, harm):
    if path.read_bytes() != good:
        harm()
def fill(): return len(bytes(range(256)) * (1 << 19))
faults = {{"traceback": lambda: 1 / 0, "hang": lambda: time.sleep(9), "over_memory": fill}}
folder = Path({str(tmp_path)!r})
for name, harm in faults.items():
    fuzz.HANG_S = 0.05 if name == "hang" else 5.0
    found = fuzz.batch(Reader("x", "x", [good], lambda p: read(p, harm)), "1", 3, folder, None)
    assert found[name] > 0, (name, found)
died = Reader("x", "x", [good], lambda p: read(p, lambda: os._exit(9)))
assert fuzz.in_child(died, "1", 9, folder, None)["traceback"] == 1
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
