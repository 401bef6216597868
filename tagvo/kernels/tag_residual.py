"""What one tag's corners say of the camera's pose: whitened residual, Jacobian, systematics.

The residual of a tag has the covariance S = diag(sigma_px^2) + L Sigma L^T, where Sigma is how well
the tag was laid and L how a laying error moves its corners in the image (Woodbury would give the
same; 8 x 8 is small). Intrinsics errors are common to all tags and travel apart, as B.
"""

from typing import NamedTuple

import numpy as np

from tagvo.geometry import Array, IntArray
from tagvo.kernels import projection
from tagvo.kernels.jit import bare, njit
from tagvo.kernels.linalg import add_square, cholesky, inverse_spd

SYSTEMATIC = 3  # focal length, principal point u, principal point v


class TagBatch(NamedTuple):
    """All that the kernels need of n observed tags.

    R_WT (n, 3, 3), p_WT (n, 3), corners_T (n, 4, 3), laying (n, 6): from the map; corners_n
    (n, 4, 2), J_px_n (n, 4, 2, 2), sigma_px (n, 4): as in Observations; shift_px (n, 8, 3): of the
    corners by one sigma of each error common to all tags, see `systematic_shift`.
    """

    R_WT: Array
    p_WT: Array
    corners_T: Array
    laying: Array
    corners_n: Array
    J_px_n: Array
    sigma_px: Array
    shift_px: Array


@bare
def tag_rows(
    R_WC: Array, p_WC: Array, tags: TagBatch, i: int, rows: Array, L: Array, small: Array
) -> bool:
    """Residual and Jacobians of tag i at a camera pose, before whitening.

    Writes rows (8, 7): [r, d pixel / d [p_WC in W, right rotation in C]] and L (8, 6):
    d pixel / d laying error in T; small (16, 3): scratch. False: a corner is not in front of the
    camera.
    """
    R_WT, p_WT, X = tags.R_WT[i], tags.p_WT[i], tags.corners_T[i]
    R_CT, p_CT, x_C, A = small[:3], small[3], small[4:8], small[8:]
    for a in range(3):
        p_CT[a] = 0.0
        for b in range(3):
            p_CT[a] += R_WC[b, a] * (p_WT[b] - p_WC[b])
            R_CT[a, b] = R_WC[0, a] * R_WT[0, b] + R_WC[1, a] * R_WT[1, b] + R_WC[2, a] * R_WT[2, b]
    front = projection.residual(
        R_CT, p_CT, X, tags.corners_n[i], tags.J_px_n[i], rows[:, 0], A, x_C
    )
    projection.camera_jacobian(A, R_WC, x_C, rows[:, 1:])
    projection.tag_jacobian(A, R_CT, X, L)
    return front


@bare
def residual_covariance(L: Array, laying: Array, sigma_px: Array, S: Array) -> None:
    """S (8, 8), its lower triangle; L (8, 6), laying (6,) sigmas [m, rad], sigma_px (4,)."""
    for i in range(8):
        for j in range(i + 1):
            S[i, j] = 0.0
    for k in range(6):
        variance = laying[k] * laying[k]
        for i in range(8):
            v = L[i, k] * variance
            for j in range(i + 1):
                S[i, j] += v * L[j, k]
    for i in range(8):
        S[i, i] += sigma_px[i // 2] * sigma_px[i // 2]


@bare
def residual_factor(L: Array, laying: Array, sigma_px: Array, factor: Array) -> bool:
    """Cholesky factor (8, 8) of S; False: S is not positive."""
    residual_covariance(L, laying, sigma_px, factor)
    return cholesky(factor)


@njit
def systematic_shift(offset_px: Array, focal_rel: float, principal_px: float) -> Array:
    """Shift of the corners by one sigma of [focal, principal u, principal v] [px]; (n, 8, 3).

    offset_px (n, 4, 2): corners less the principal point; focal_rel: sigma of the focal length as a
    share of it; principal_px: of either coordinate of the principal point.
    """
    out = np.zeros((len(offset_px), 8, SYSTEMATIC))
    for n in range(len(offset_px)):
        for c in range(4):
            for i in range(2):
                out[n, 2 * c + i, 0] = offset_px[n, c, i] * focal_rel
                out[n, 2 * c + i, 1 + i] = principal_px
    return out


@njit
def mean_covariance(
    R_WC: Array, p_WC: Array, tags: TagBatch, used: IntArray, weight: Array
) -> Array:
    """Covariance (6, 6) of the weighted mean of per-tag poses, at the mean pose.

    P = sum w_i^2 (H_i^-1 + G_i Sigma_i G_i^T) + D D^T over the used tags (k,), weight (k,) summing
    to 1: H_i the information of the corners alone, by which per-tag poses are solved, G_i their
    shift by the tag's laying error, D the mean's shift by one sigma of each systematic error;
    [p_WC in W, right rotation in C]. NaN where a tag lies behind the camera or is seen edge-on.
    """
    rows, L = np.empty((8, 7)), np.empty((8, 6))
    H, H_inv, gain, small = np.empty((6, 6)), np.empty((6, 6)), np.empty(8), np.empty((16, 3))
    P, D, G = np.zeros((6, 6)), np.zeros((6, SYSTEMATIC)), np.empty((6, 6))
    for at in range(len(used)):
        i, w = used[at], weight[at]
        good = tag_rows(R_WC, p_WC, tags, i, rows, L, small)
        B = tags.shift_px[i]
        for k in range(8):
            rows[k] /= tags.sigma_px[i, k // 2]
        accumulate(rows[:, 1:], H)
        if not (inverse_spd(H, H_inv) and good):
            P[:] = np.nan
            return P
        for a in range(6):
            for k in range(8):
                gain[k] = 0.0
                for b in range(6):
                    gain[k] += H_inv[a, b] * rows[k, 1 + b]
                gain[k] /= tags.sigma_px[i, k // 2]
            for b in range(6):
                G[a, b] = 0.0
                for k in range(8):
                    G[a, b] += gain[k] * L[k, b]
                G[a, b] *= tags.laying[i, b]
            for c in range(SYSTEMATIC):
                for k in range(8):
                    D[a, c] += w * gain[k] * B[k, c]
        for a in range(6):
            for b in range(6):
                v = H_inv[a, b]
                for c in range(6):
                    v += G[a, c] * G[b, c]
                P[a, b] += w * w * v
    add_square(D, P)
    return P


@bare
def accumulate(J: Array, H: Array) -> None:
    """H = J^T J; J (8, 6) -> H (6, 6)."""
    for a in range(6):
        for b in range(a + 1):
            v = 0.0
            for k in range(8):
                v += J[k, a] * J[k, b]
            H[a, b] = v
            H[b, a] = v
