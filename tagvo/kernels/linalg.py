"""Small dense linear algebra: Cholesky factors, triangular solves, products that skip zeros.

By loops: BLAS costs a start 0.3 s, and products of six rows more than they do. Source: Golub and
Van Loan, Matrix Computations, chapter 4.
"""

import math

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, njit


@bare
def cholesky(A: Array) -> bool:
    """Lower factor of a symmetric (n, n) in its lower triangle, in place; False: not positive."""
    n = A.shape[0]
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] * A[j, k]
        if not (d > 0.0 and d < 1e300):
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
    identity(out)
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
def times_p(H: Array, P: Array, M: Array) -> None:
    """M (m, n) := H P, skipping what is zero in H."""
    m, n = H.shape
    for i in range(m):
        for j in range(n):
            M[i, j] = 0.0
        for c in range(n):
            h = H[i, c]
            if h != 0.0:
                for j in range(n):
                    M[i, j] += h * P[c, j]


@bare
def times_ht(M: Array, H: Array, S: Array) -> None:
    """S (m, m) := M H^T, skipping what is zero in H; exactly symmetric."""
    m, n = H.shape
    for i in range(m):
        for k in range(i, m):
            S[i, k] = 0.0
    for k in range(m):
        for c in range(n):
            h = H[k, c]
            if h != 0.0:
                for i in range(k + 1):
                    S[i, k] += M[i, c] * h
    for i in range(m):
        for k in range(i):
            S[i, k] = S[k, i]


@bare
def subtract_square(P: Array, M: Array) -> None:
    """P (n, n) -= M^T M; all rows of M at once where there are six: three times as fast."""
    m, n = M.shape
    for i in range(n):
        if m == 6:
            a, b, c, d, e, f = M[0, i], M[1, i], M[2, i], M[3, i], M[4, i], M[5, i]
            for j in range(n):
                P[i, j] -= (
                    (a * M[0, j] + b * M[1, j])
                    + (c * M[2, j] + d * M[3, j])
                    + (e * M[4, j] + f * M[5, j])
                )
        else:
            for k in range(m):
                a = M[k, i]
                for j in range(n):
                    P[i, j] -= a * M[k, j]


@bare
def identity(out: Array) -> None:
    """out (n, n) := 1."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = 1.0 if i == j else 0.0


@bare
def copy(A: Array, out: Array) -> None:
    """out (n, m) := A."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = A[i, j]


@bare
def assign(v: Array, out: Array) -> None:
    """out (n,) := v."""
    for i in range(out.shape[0]):
        out[i] = v[i]


@bare
def add_times(A: Array, v: Array, out: Array) -> None:
    """out (n,) += A v; A (n, m), v (m,)."""
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            out[i] += A[i, k] * v[k]


@bare
def subtract_times(A: Array, v: Array, out: Array) -> None:
    """out (n,) -= A v; A (n, m), v (m,)."""
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            out[i] -= A[i, k] * v[k]


@bare
def add_t_times(A: Array, v: Array, out: Array) -> None:
    """out (m,) += A^T v; A (n, m), v (n,)."""
    for i in range(A.shape[1]):
        for k in range(A.shape[0]):
            out[i] += A[k, i] * v[k]


@bare
def add_scaled(v: Array, s: float, out: Array) -> None:
    """out (n,) += s v."""
    for i in range(len(out)):
        out[i] += s * v[i]


@bare
def scale(v: Array, s: float) -> None:
    """v (n,) *= s."""
    for i in range(len(v)):
        v[i] *= s


@bare
def dot(v: Array, w: Array) -> float:
    """v^T w; (n,)."""
    s = 0.0
    for i in range(len(v)):
        s += v[i] * w[i]
    return s


@bare
def square(v: Array) -> float:
    """v^T v; v (n,)."""
    s = 0.0
    for i in range(len(v)):
        s += v[i] * v[i]
    return s


@bare
def add_t_product(A: Array, B: Array, s: float, out: Array) -> None:
    """out (n, m) += s A^T B; A (k, n), B (k, m)."""
    for k in range(A.shape[0]):
        for i in range(A.shape[1]):
            a = s * A[k, i]
            for j in range(B.shape[1]):
                out[i, j] += a * B[k, j]


@bare
def add_product_t(A: Array, B: Array, out: Array) -> None:
    """out (n, m) += A B^T; A (n, k), B (m, k)."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            for k in range(A.shape[1]):
                out[i, j] += A[i, k] * B[j, k]


@bare
def symmetrize(A: Array) -> None:
    """A (n, n) := the mean of A and A^T."""
    for i in range(A.shape[0]):
        for j in range(i):
            A[i, j] = A[j, i] = 0.5 * (A[i, j] + A[j, i])


@bare
def is_finite(A: Array) -> bool:
    """Whether every element of A (n, m) is a finite number."""
    for i in range(A.shape[0]):
        for j in range(A.shape[1]):
            if not math.isfinite(A[i, j]):
                return False
    return True


@bare
def determinant(A: Array) -> float:
    """Of A (3, 3)."""
    a = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    b = A[1, 0] * A[2, 2] - A[1, 2] * A[2, 0]
    c = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    return float(A[0, 0] * a - A[0, 1] * b + A[0, 2] * c)


@bare
def largest_eigenvalue(A: Array) -> float:
    """Of a symmetric A (3, 3), by the cosine of a third of an angle."""
    mean = (A[0, 0] + A[1, 1] + A[2, 2]) / 3.0
    a, b, c = A[0, 0] - mean, A[1, 1] - mean, A[2, 2] - mean
    d, e, f = A[0, 1], A[0, 2], A[1, 2]
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * (d * d + e * e + f * f)) / 6.0)
    if spread <= 0.0:
        return float(mean)
    half = 0.5 * (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / spread**3
    return float(mean + 2.0 * spread * math.cos(math.acos(min(max(half, -1.0), 1.0)) / 3.0))
