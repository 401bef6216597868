"""One way to compile: typed `njit`, `bare` and `leaf`, which cache their machine code on disk.

Kernels are module-level functions of arrays without side effects on their inputs, except those
whose docstring names an output argument.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba

P = ParamSpec("P")
T = TypeVar("T")


_MARKS = (b"@njit", b"@bare", b"@leaf")


def drop_stale_code(roots: Iterable[Path]) -> None:
    """Forget cached machine code older than the newest kernel source below these folders.

    Numba looks at a kernel's own file alone: after an edit or a `git pull` a caller in another
    file would go on running the old callee that was compiled into it.
    """
    roots = list(roots)
    sources = [(p, p.read_bytes()) for root in roots for p in root.rglob("*.py")]
    kernels = [p for p, text in sources if any(mark in text for mark in _MARKS)]
    newest = max((p.stat().st_mtime for p in kernels), default=0.0)
    for index in (p for root in roots for p in root.rglob("__pycache__/*.nb[ic]")):
        try:
            if index.stat().st_mtime < newest:
                index.unlink()
        except OSError:  # another process was quicker, or the folder is read-only
            continue


def _without_blas() -> None:
    """Numba imports scipy.linalg (0.3 s of every start) only to see that there is a BLAS.

    No kernel of ours asks for it; one that did would have it loaded at its first call.
    """
    from numba.np import linalg

    linalg.ensure_blas = lambda: None


_without_blas()
_jit: Any = numba.njit  # its type hints do not know `_nrt`
_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
KERNELS = Path(__file__).parents[1]  # of tagvo: in any folder of it
drop_stale_code([KERNELS])


def njit(function: Callable[P, T]) -> Callable[P, T]:
    """Compile at first call, keep the machine code on disk, release the GIL while running."""
    compiled: Callable[P, T] = _jit(**_OPTIONS)(function)
    return compiled


def bare(function: Callable[P, T]) -> Callable[P, T]:
    """As `njit`, for kernels that allocate nothing and call nothing that does, which is checked.

    Numba then counts no references to the arrays that go through, which in functions of a few
    dozen operations costs several times what they do.
    """
    compiled: Callable[P, T] = _jit(**_OPTIONS, _nrt=False)(function)
    return compiled


def leaf(function: Callable[P, T]) -> Callable[P, T]:
    """As `bare`, and put into its callers whole: for the innermost functions of a loop."""
    compiled: Callable[P, T] = _jit(**_OPTIONS, _nrt=False, forceinline=True)(function)
    return compiled
