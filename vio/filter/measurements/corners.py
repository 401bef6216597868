"""Tag corners as a measurement: eight reprojection residuals a tag, gated tag by tag.

Each tag's residuals see the error xi of the camera pose (`measurements.camera`) through the
projection (`tagvo.kernels.tag_residual`, as in the joint pose); their covariance is the corners'
noise plus the tag's laying errors, marginalised. What the accepted tags know of xi is gathered in
information form; one six-row correction applies it.
Derivation: docs/filter/measurements.md; against all corners stacked: test_filter_corners.py.
"""

import numpy as np

from tagvo.config import IntrinsicsErrorConfig
from tagvo.geometry import Array
from tagvo.kernels.jit import njit
from tagvo.kernels.linalg import (
    add_product_t,
    add_square,
    add_t_product,
    add_t_times,
    cholesky,
    forward,
    multiply,
    square,
    times_ht,
    times_p,
)
from tagvo.kernels.tag_residual import (
    SYSTEMATIC,
    TagBatch,
    residual_covariance,
    systematic_shift,
    tag_rows,
)
from tagvo.records import Observations
from tagvo.tags.tag_map import TagMap
from vio.filter import state as at
from vio.filter.adaptive_noise import Trust
from vio.filter.measurements import kinds
from vio.filter.measurements.camera import camera_jacobian, camera_pose
from vio.filter.update import GATE_8, add_pose_bias, downdate

_SHAPES = ((3, 3), (3,), (4, 3), (6,), (4, 2), (4, 2, 2), (4,), (8, SYSTEMATIC))  # of TagBatch
NUMBERS = int(sum(np.prod(shape) for shape in _SHAPES))  # a tag


def pack(
    seen: Observations,
    tag_map: TagMap,
    centre_px: Array,
    floor: IntrinsicsErrorConfig,
    max_tags: int,
) -> Array | None:
    """The tags of a frame as a row of the history: at most max_tags, the largest first.

    centre_px (2,): principal point; floor: the calibration's errors, common to all tags. Tags whose
    corners or noise are not finite are left out; None: no tag is left.
    """
    tags = TagBatch(
        tag_map.R_WT[seen.row],
        tag_map.p_WT[seen.row],
        tag_map.corners_T[seen.row],
        tag_map.laying_sigma[seen.row],
        seen.corners_n,
        seen.J_px_n,
        seen.sigma_px,
        systematic_shift(seen.corners_px - centre_px, floor.focal_rel, floor.principal_px),
    )
    finite = np.all([np.isfinite(a).reshape(len(seen), -1).all(axis=1) for a in tags], axis=0)
    keep = np.flatnonzero(finite)
    quads = seen.corners_n[keep]
    a, b = quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    keep = keep[np.argsort(-area, kind="stable")[:max_tags]]
    if not len(keep):
        return None
    head = np.array([kinds.CORNERS, float(len(keep)), float(seen.camera)])
    return np.concatenate([head, *(a[keep].ravel() for a in tags)])


@njit
def unpack(z: Array, k: int) -> TagBatch:
    """Views of the payload z of k tags; z may be longer."""
    a = 0
    R_WT = z[a : a + 9 * k].reshape((k, 3, 3))
    a += 9 * k
    p_WT = z[a : a + 3 * k].reshape((k, 3))
    a += 3 * k
    corners_T = z[a : a + 12 * k].reshape((k, 4, 3))
    a += 12 * k
    laying = z[a : a + 6 * k].reshape((k, 6))
    a += 6 * k
    corners_n = z[a : a + 8 * k].reshape((k, 4, 2))
    a += 8 * k
    J_px_n = z[a : a + 16 * k].reshape((k, 4, 2, 2))
    a += 16 * k
    sigma_px = z[a : a + 4 * k].reshape((k, 4))
    a += 4 * k
    shift_px = z[a : a + 8 * SYSTEMATIC * k].reshape((k, 8, SYSTEMATIC))
    return TagBatch(R_WT, p_WT, corners_T, laying, corners_n, J_px_n, sigma_px, shift_px)


@njit
def _tag_distance(rows: Array, S: Array, B: Array, P_xi: Array, inflation: float) -> float:
    """Squared Mahalanobis length of a tag's residual under J P_xi J^T + k (S + B B^T).

    rows (8, 7): [r, J]; S (8, 8) lower; B (8, 3).
    """
    J, total, JP = rows[:, 1:], S.copy(), np.empty((8, 6))
    add_square(B, total)
    total *= inflation
    multiply(J, P_xi, JP)
    add_product_t(JP, J, total)
    if not cholesky(total):
        return np.inf
    y = rows[:, 0].copy()
    forward(total, y.reshape((8, 1)))
    d = square(y)
    return d if d >= 0.0 else np.inf


@njit
def linearize(
    x: Array, P_xi: Array, tags: TagBatch, trust: Trust, A: Array, b: Array, X: Array
) -> tuple[int, float]:
    """What the accepted tags know of xi and of the calibration's errors, in information form.

    A = sum J^T S^-1 J / k    b = sum J^T S^-1 r / k    X = sum J^T S^-1 B / k
    A (6, 6), b (6,), X (6, 3) are written; P_xi (6, 6): how well xi is known before. Returns how
    many tags were accepted, and a mean NIS of all as of 6 degrees of freedom.
    """
    R_WC, p_WC = np.empty((3, 3)), np.empty(3)
    rows, L, S, small = np.empty((8, 7)), np.empty((8, 6)), np.zeros((8, 8)), np.empty((16, 3))
    camera_pose(x, R_WC, p_WC)
    A[:] = 0.0
    b[:] = 0.0
    X[:] = 0.0
    used, total, seen, share = 0, 0.0, 0, 1.0 / trust.inflation
    for t in range(len(tags.sigma_px)):
        if not tag_rows(R_WC, p_WC, tags, t, rows, L, small):
            continue
        residual_covariance(L, tags.laying[t], tags.sigma_px[t], S)
        B = tags.shift_px[t].copy()
        d = _tag_distance(rows, S, B, P_xi, trust.inflation)
        if d < np.inf:
            total += d
            seen += 1
        if d > GATE_8 * trust.gate or not cholesky(S):
            continue
        forward(S, rows)
        forward(S, B)
        used += 1
        J = rows[:, 1:]
        add_t_product(J, J, share, A)
        add_t_times(J, share * rows[:, 0], b)
        add_t_product(J, B, share, X)
    return used, (total / seen * 0.75 if seen > 0 else np.inf)


@njit
def _whiten(y: Array, X: Array, inflation: float, y_white: Array) -> None:
    """y_white (6,) := y (6, 1) of covariance 1 + k X X^T, whitened, without inflation."""
    L, out = np.eye(6), y * np.sqrt(inflation)
    add_square(X * np.sqrt(inflation), L)
    if cholesky(L):
        forward(L, out)
        y_white[:] = out[:, 0]


@njit
def update(
    x: Array, P: Array, w: Array, z: Array, trust: Trust, y_white: Array, layout: at.Layout
) -> tuple[int, float]:
    """Correct by the tags of a frame, a whole row z; what became of it, and a NIS as of 6 dof.

    With A = C C^T the accepted tags say  C^-1 b = C^T xi + C^-1 X e + white noise, e the
    calibration's errors in sigmas; so H = C^T d xi / d state, S = H P H^T + 1 + k C^-1 X X^T C^-T.
    w (3,) gyro then; the pose bias has the share of positions: corners do not tell them apart;
    y_white (6,) receives the innovation, bias and all, whitened by its own noise.
    """
    n, share, tags = P.shape[0], trust.slow_position, unpack(z[kinds.HEAD :], int(z[kinds.COUNT]))
    H, M, P_xi = np.empty((6, n)), np.empty((6, n)), np.empty((6, 6))
    A, b, X = np.empty((6, 6)), np.empty(6), np.empty((6, SYSTEMATIC))
    camera_jacobian(x, w, H, layout)
    times_p(H, P, M)
    times_ht(M, H, P_xi)
    used, nis = linearize(x, P_xi, tags, trust, A, b, X)
    if used == 0:
        return kinds.REJECTED, nis
    for i in range(len(A)):
        A[i, i] *= 1.0 + 1e-12
    if not cholesky(A):
        return kinds.SINGULAR, nis
    y = b.copy().reshape((6, 1))
    forward(A, y)
    forward(A, X)
    _whiten(y, X, trust.inflation, y_white)
    U, S, r = np.zeros((6, n)), np.empty((6, 6)), y[:, 0].copy()
    for k in range(len(A)):  # U = C^T H
        for i in range(k + 1):
            for j in range(n):
                U[i, j] += A[k, i] * H[k, j]
    if share > 0.0:
        scale = np.full(6, np.sqrt(share / trust.inflation))
        add_pose_bias(x, np.eye(6), scale, U, r, layout)
    times_p(U, P, M)
    times_ht(M, U, S)
    for i in range(len(S)):
        S[i, i] += 1.0 - share
    add_square(X * np.sqrt(trust.inflation), S)
    good = cholesky(S) and downdate(x, P, S, M, r, layout)
    return (kinds.ACCEPTED if good else kinds.SINGULAR), nis
