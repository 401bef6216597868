"""Gauss-Newton on the six unknowns of a pose: normal equations row by row, and the damped step.

With residuals r, their Jacobian J and weights w:  H = sum w J^T J,  g = sum w J^T r; the step is
b = (H + D)^-1 g,  D = damping diag(H) + ridge (Levenberg and Marquardt).
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., chapter 10.
"""

from tagvo.geometry import Array
from tagvo.kernels.jit import bare, leaf
from tagvo.kernels.linalg import backward, cholesky, forward

UNKNOWNS = 6


@bare
def clear(H: Array, g: Array) -> None:
    """H (6, 6) := 0, g (6,) := 0."""
    for a in range(UNKNOWNS):
        g[a] = 0.0
        for b in range(UNKNOWNS):
            H[a, b] = 0.0


@leaf
def add_row(J: Array, r: float, w: float, H: Array, g: Array) -> None:
    """H (6, 6) += w J^T J, its lower half alone, and g (6,) += w J^T r; J (6,), weight w."""
    for a in range(UNKNOWNS):
        f = w * J[a]
        g[a] += f * r
        for b in range(a + 1):
            H[a, b] += f * J[b]


@bare
def mirror(H: Array) -> None:
    """The lower half of H (6, 6) into its upper half."""
    for a in range(UNKNOWNS):
        for b in range(a):
            H[b, a] = H[a, b]


@bare
def damped_step(H: Array, g: Array, damping: float, ridge: float, L: Array, b: Array) -> bool:
    """b (6, 1) := the step; L (6, 6): scratch. False: nothing positive to invert.

    Reads the lower half of H.
    """
    for i in range(UNKNOWNS):
        for j in range(i + 1):
            L[i, j] = H[i, j]
        L[i, i] = H[i, i] * (1.0 + damping) + ridge
        b[i, 0] = g[i]
    if not cholesky(L):
        return False
    forward(L, b)
    backward(L, b)
    return True
