"""MEF, the paper's multi-tag estimate fusion: weighted means of positions and of rotations."""

from collections.abc import Callable

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import njit
from tagvo.kernels.so3 import matrix_into, quaternion

_QUARTER_TURN = float(np.cos(np.pi / 4.0))  # |q_i . q_j| of two rotations 90 degrees apart


def _w1(level: Array) -> Array:
    return np.asarray(4.0**level)


def _w2(level: Array) -> Array:
    return np.asarray(2.0**level)


def _uniform(level: Array) -> Array:
    return np.ones(len(level))


WEIGHT: dict[str, Callable[[Array], Array]] = {"W1": _w1, "W2": _w2, "uniform": _uniform}


@njit
def _aligned_sum(q: Array, w: Array) -> tuple[Array, float]:
    """Sum of w q with every q turned to the hemisphere of the heaviest; least |q_i . q_j|."""
    n, reference = len(q), np.argmax(w)
    total, closest = np.zeros(4), 1.0
    for i in range(n):
        dot = 0.0
        for k in range(4):
            dot += q[i, k] * q[reference, k]
        sign = 1.0 if dot >= 0.0 else -1.0
        for k in range(4):
            total[k] += sign * w[i] * q[i, k]
        for j in range(i):
            dot = 0.0
            for k in range(4):
                dot += q[i, k] * q[j, k]
            closest = min(closest, abs(dot))
    return total, closest


@njit
def _quaternions(R: Array) -> Array:
    q = np.empty((len(R), 4))
    for i in range(len(R)):
        quaternion(R[i], q[i])
    return q


def chordal_mean(q: Array, w: Array) -> tuple[Array, tuple[str, ...]]:
    """CL2: top eigenvector of sum w q q^T; q (n, 4) wxyz, w (n,) -> (4,), flags."""
    _, vectors = np.linalg.eigh((q * w[:, None]).T @ q)
    mean = vectors[:, -1]
    return np.where(mean[0] < 0.0, -mean, mean), ()


def quaternion_mean(q: Array, w: Array) -> tuple[Array, tuple[str, ...]]:
    """QL2: normalised weighted sum of sign-aligned quaternions (paper, eq. minimum).

    q (n, 4) wxyz, w (n,) -> (4,), flags. The heaviest quaternion is the sign reference. Two
    rotations 90 degrees apart or more void the closed form: CL2 then, flagged `wide_spread`.
    """
    total, closest = _aligned_sum(q, w)
    if closest <= _QUARTER_TURN:
        return chordal_mean(q, w)[0], ("wide_spread",)
    mean = total / np.sqrt(total @ total)
    return (-mean if mean[0] < 0.0 else mean), ()


MEAN: dict[str, Callable[[Array, Array], tuple[Array, tuple[str, ...]]]] = {
    "QL2": quaternion_mean,
    "CL2": chordal_mean,
}


def fuse(p: Array, R: Array, weights: Array, mean: str) -> tuple[Array, Array, tuple[str, ...]]:
    """Weighted mean pose: p (n, 3), R (n, 3, 3), weights (n,) -> p (3,), R (3, 3), flags.

    Paper, section Multi-tags Estimate Fusion; the position sum is divided by the weights' sum.
    """
    q, flags = MEAN[mean](_quaternions(R), weights)
    R_mean = np.empty((3, 3))
    matrix_into(R_mean, *q.tolist())
    return (weights @ p) / weights.sum(), R_mean, flags
