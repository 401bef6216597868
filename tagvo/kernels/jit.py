"""One way to compile: a typed `njit` that caches on disk, and small dense algebra for kernels.

Kernels are module-level functions of arrays without side effects on their inputs, except those
whose docstring names an output argument.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numba
import numpy as np

from tagvo.geometry import Array

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


@bare
def cholesky(A: Array) -> bool:
    """Lower factor of a symmetric (n, n) in its lower triangle, in place; False: not positive."""
    n = A.shape[0]
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] * A[j, k]
        if not d > 0.0:
            return False
        d = np.sqrt(d)
        A[j, j] = d
        for i in range(j + 1, n):
            v = A[i, j]
            for k in range(j):
                v -= A[i, k] * A[j, k]
            A[i, j] = v / d
    return True


@bare
def forward(L: Array, b: Array) -> None:
    """Solve L x = b in place of b (n, m); L lower."""
    n, m = b.shape
    for i in range(n):
        for k in range(i):
            f = L[i, k]
            for j in range(m):
                b[i, j] -= f * b[k, j]
        inv = 1.0 / L[i, i]
        for j in range(m):
            b[i, j] *= inv


@bare
def backward(L: Array, b: Array) -> None:
    """Solve L^T x = b in place of b (n, m); L lower."""
    n, m = b.shape
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            f = L[k, i]
            for j in range(m):
                b[i, j] -= f * b[k, j]
        inv = 1.0 / L[i, i]
        for j in range(m):
            b[i, j] *= inv


@njit
def inverse_spd(A: Array, out: Array) -> bool:
    """Inverse of a symmetric positive (n, n) into `out`; False (and out undefined) otherwise."""
    n = A.shape[0]
    L = A.copy()
    if not cholesky(L):
        return False
    for i in range(n):
        for j in range(n):
            out[i, j] = 1.0 if i == j else 0.0
    forward(L, out)
    backward(L, out)
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (out[i, j] + out[j, i])
            out[i, j] = mean
            out[j, i] = mean
    return True


@bare
def multiply(A: Array, B: Array, out: Array) -> None:
    """A B into `out` (n, m); by loops: BLAS costs a start 0.3 s and small products more."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            v = 0.0
            for k in range(A.shape[1]):
                v += A[i, k] * B[k, j]
            out[i, j] = v


@bare
def add_square(D: Array, P: Array) -> None:
    """P (n, n) += D D^T, in place."""
    for i in range(D.shape[0]):
        for j in range(D.shape[0]):
            v = 0.0
            for k in range(D.shape[1]):
                v += D[i, k] * D[j, k]
            P[i, j] += v


@bare
def rotated(R: Array, phi: Array, out: Array) -> None:
    """R Exp(phi) into `out` (3, 3); phi (3,) [rad]."""
    t2 = phi[0] * phi[0] + phi[1] * phi[1] + phi[2] * phi[2]
    if t2 < 1e-8:
        a, b = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0
    else:
        t = np.sqrt(t2)
        a, b = np.sin(t) / t, (1.0 - np.cos(t)) / t2
    x, y, z = phi[0], phi[1], phi[2]
    e00, e11, e22 = 1 - b * (y * y + z * z), 1 - b * (x * x + z * z), 1 - b * (x * x + y * y)
    e01, e10 = b * x * y - a * z, b * x * y + a * z
    e02, e20 = b * x * z + a * y, b * x * z - a * y
    e12, e21 = b * y * z - a * x, b * y * z + a * x
    for i in range(3):
        r0, r1, r2 = R[i, 0], R[i, 1], R[i, 2]
        out[i, 0] = r0 * e00 + r1 * e10 + r2 * e20
        out[i, 1] = r0 * e01 + r1 * e11 + r2 * e21
        out[i, 2] = r0 * e02 + r1 * e12 + r2 * e22


@bare
def quaternion(R: Array, q: Array) -> None:
    """Unit quaternion wxyz of a rotation matrix (3, 3) into q (4,); its sign is free (Shepperd)."""
    t = R[0, 0] + R[1, 1] + R[2, 2]
    k = 0  # the largest component: w, or x, y, z
    largest = t
    for i in range(3):
        if R[i, i] > largest:
            k, largest = i + 1, R[i, i]
    if k == 0:
        q[0] = 1.0 + t
        q[1], q[2], q[3] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    else:
        i, j, m = k - 1, k % 3, (k + 1) % 3
        q[0] = R[m, j] - R[j, m]
        q[1 + i] = 1.0 + R[i, i] - R[j, j] - R[m, m]
        q[1 + j], q[1 + m] = R[j, i] + R[i, j], R[m, i] + R[i, m]
    norm = np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] /= norm


@njit
def rotation(q: Array) -> Array:
    """Rotation matrix (3, 3) of a unit quaternion wxyz (4,)."""
    w, x, y, z = q
    R = np.empty((3, 3))
    R[0, 0], R[1, 1], R[2, 2] = (
        1 - 2 * (y * y + z * z),
        1 - 2 * (x * x + z * z),
        1 - 2 * (x * x + y * y),
    )
    R[0, 1], R[1, 0] = 2 * (x * y - w * z), 2 * (x * y + w * z)
    R[0, 2], R[2, 0] = 2 * (x * z + w * y), 2 * (x * z - w * y)
    R[1, 2], R[2, 1] = 2 * (y * z - w * x), 2 * (y * z + w * x)
    return R
