"""Gives back memory that a flight no longer needs: the compiler's own code, once all is compiled.

LLVM lies in the process because Numba loads compiled kernels through it. After the warm-up nothing
runs in it; its pages are as they are in the file, and come back by themselves if it does.
"""

import ctypes
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

_DONTNEED = 4  # of madvise(2)
_HEAD = re.compile(r"^([0-9a-f]+)-([0-9a-f]+) (\S+) \S+ \S+ \d+\s*(.*)$")


def clean_spans(smaps: Iterable[str], name: str) -> Iterator[tuple[int, int]]:
    """Start and length [bytes] of what is mapped of files called so and is just as in the file.

    smaps: lines of /proc/PID/smaps. Relocated pages are read-only too, but differ from the file
    (they count as anonymous, and as swap once they are there): their spans stay.
    """
    span, own = None, 0
    for line in smaps:
        head = _HEAD.match(line)
        if head is not None:
            start, end, rights, path = head.groups()
            fits = name in Path(path).name and "w" not in rights
            span, own = (int(start, 16), int(end, 16) - int(start, 16)) if fits else None, 0
        elif line.startswith("Anonymous:"):
            own = int(line.split()[1])
        elif line.startswith("Swap:") and span is not None:  # stands below Anonymous
            if own + int(line.split()[1]) == 0:
                yield span
            span = None


def give_back(name: str) -> None:
    """Drop the clean pages of libraries of this name; nothing where the system has no such call."""
    try:
        madvise = ctypes.CDLL(None).madvise
        lines = Path("/proc/self/smaps").read_text(encoding="utf-8").splitlines()
    except (OSError, AttributeError):
        return
    for start, length in list(clean_spans(lines, name)):
        madvise(ctypes.c_void_p(start), ctypes.c_size_t(length), _DONTNEED)
