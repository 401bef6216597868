import subprocess
import sys
from pathlib import Path

import pytest

from vio.daemon.memory import clean_spans, give_back

SMAPS = """\
1000-3000 r-xp 00000000 08:01 7    /opt/lib/libllvmlite.so
Rss:                   8 kB
Anonymous:             0 kB
Swap:                  0 kB
SwapPss:               0 kB
3000-4000 r--p 00002000 08:01 7    /opt/lib/libllvmlite.so
Anonymous:             4 kB
Swap:                  0 kB
4000-5000 rw-p 00003000 08:01 7    /opt/lib/libllvmlite.so
Anonymous:             0 kB
Swap:                  0 kB
5000-6000 r-xp 00000000 08:01 8    /opt/lib/libc.so
Anonymous:             0 kB
Swap:                  0 kB
6000-9000 rw-p 00000000 00:00 0
Anonymous:             0 kB
Swap:                  0 kB
9000-b000 r--p 00004000 08:01 7    /opt/my libs/libllvmlite.so
Anonymous:             0 kB
Swap:                  0 kB
b000-c000 r--p 00006000 08:01 7    /opt/my libs/libllvmlite.so
Anonymous:             0 kB
Swap:                  4 kB
"""


def test_only_clean_pages_of_the_named_file_are_given_back():
    spans = list(clean_spans(SMAPS.splitlines(), "libllvmlite"))
    assert spans == [(0x1000, 0x2000), (0x9000, 0x2000)]
    assert list(clean_spans(SMAPS.splitlines(), "no_such_library")) == []


@pytest.mark.skipif(not Path("/proc/self/smaps").exists(), reason="no /proc/self/smaps")
def test_the_compiler_still_compiles_after_its_pages_were_given_back():
    code = """
import numba
from vio.daemon.memory import give_back
from vio.localize.stopwatch import resident_mb
twice = numba.njit(lambda x: 2 * x)
assert twice(2) == 4
before = resident_mb()
give_back("libllvmlite")
after = resident_mb()
assert twice(2.5) == 5.0, "compiled anew for floats"
print(before - after)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) > 10.0


def test_without_proc_nothing_happens(monkeypatch):
    def gone(*_, **__):
        raise FileNotFoundError

    monkeypatch.setattr(Path, "read_text", gone)
    give_back("libllvmlite")
