"""What one outlying corner of a lone tag hides: the pose takes most of its shift, residuals little.

With 8 numbers and 6 parameters a misfit says that a corner is off, not which, and each of the four
explains all of it. Of a shift s_c [px] of corner c the residual shows S D_c s_c (S = I - J P J^T,
P = (J^T J)^-1, D_c: whitened unit shifts), the pose G_c s_c = P J^T D_c s_c. So
    s_c = N_c^-1 D_c^T r,   N_c = D_c^T S D_c + 1 / sigma_s^2
and the covariance gains the mean over c of G_c s_c s_c^T G_c^T + G_c N_c^-1 G_c^T.
"""

from dataclasses import replace

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.kernels.tag_residual import TagBatch
from tagvo.pose.joint import JointPose

_UNLIKELY = 9.2  # chi-square, 2 dof, 99 %: a misfit below it is noise
_SHIFT_PX = 30.0  # sigma of an outlying corner: no decoder takes a tag that is bent further


def corner_rows(R_WC: Array, p_WC: Array, tags: TagBatch) -> tuple[Array, Array]:
    """Whitened residual (8,) of the first tag's corners and its Jacobian (8, 6) by the pose.

    The pose's six: p_WC in W, right rotation in C.
    """
    p_W = tags.corners_T[0] @ tags.R_WT[0].T + tags.p_WT[0]
    p_C = (p_W - p_WC) @ R_WC
    z = p_C[:, 2]
    ahead = p_C[:, :2] / z[:, None]
    to_image = np.zeros((4, 2, 3))  # d (x / z, y / z) / d p_C
    to_image[:, 0, 0] = to_image[:, 1, 1] = 1.0 / z
    to_image[:, :, 2] = -ahead / z[:, None]
    by_pose = np.concatenate([np.broadcast_to(-R_WC.T, (4, 3, 3)), geo.hat(p_C)], axis=-1)
    white = tags.J_px_n[0] / tags.sigma_px[0][:, None, None]
    r = np.einsum("cij,cj->ci", white, tags.corners_n[0] - ahead).ravel()
    return r, (white @ to_image @ by_pose).reshape(8, 6)


def with_hidden_shift(joint: JointPose, tags: TagBatch) -> tuple[JointPose, float]:
    """The joint pose of a lone tag, wider where its corners do not fit a square seen anywhere.

    tags: the batch of that one tag. Also by how much its chi-squares are too large (1: they are
    not): so much less they tell of its other planar solution. A pose that failed, or whose corners
    fit, comes back as it is.
    """
    if not np.isfinite(joint.cov).all():
        return joint, 1.0
    r, J = corner_rows(joint.R_WC, joint.p_WC, tags)
    P = np.linalg.pinv(J.T @ J, hermitian=True)
    left = r - J @ (P @ (J.T @ r))
    misfit = float(left @ left)
    if not misfit > _UNLIKELY:
        return joint, 1.0
    hidden = np.zeros((6, 6))
    for corner in range(4):
        D = np.zeros((8, 2))
        D[2 * corner, 0] = D[2 * corner + 1, 1] = 1.0 / tags.sigma_px[0][corner]
        G = P @ (J.T @ D)
        C = np.linalg.inv(D.T @ D - D.T @ J @ G + np.eye(2) / _SHIFT_PX**2)
        e = G @ (C @ (D.T @ left))
        hidden += 0.25 * (np.outer(e, e) + G @ C @ G.T)
    return replace(joint, cov=joint.cov + hidden), 0.5 * misfit
