"""Finds tags that lie elsewhere than the map says, by all that a flight saw of them.

Cameras and tags are moved together until the corners fit best (a bundle adjustment linearised
where the cameras were measured). Each tag is held where the map has it by how well it was laid,
with a heavy tail: one that was moved goes, and its neighbours stay. A lens or a map that is off
everywhere bends the whole, so a tag is judged by how it lies among those that are seen with it, and
by how well the others of this map do.
"""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.tags.tag_map import TagMap
from vio.evaluate.tag_sightings import Sightings

_SYSTEMATIC_PX = 0.5  # what lens and rolling shutter leave, the same in frames near in time
_FEWEST = 5  # frames that must have seen a tag before it is judged
_MOST_TAGS = 400  # the most seen; the matrix grows with their square
_STEPS = 8
_TAIL = 4.0  # degrees of freedom of the laying errors' distribution
_SIGHTING_CHI2 = 26.12  # as the joint pose's robust loss
_SIGMAS = 5.5
_RIDGE, _LOCAL_STEPS = 0.02, 5  # how much a neighbourhood must agree on to count as turned
_LEAST_M = 0.01  # smaller disagreements are nobody's concern


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """What was found of k tags.

    row (k,) in the map; offset_W (k, 3) [m]: where the tag lies, among those seen with it, less
    where the map has it; sigma_W (k, 3) [m] of that for a tag that is as well laid as the map says,
    or as the others of this map are; distance (k,) in sigmas; frames (k,): how many saw it;
    suspect (k,): too far, and by too many sigmas.
    """

    row: IntArray
    offset_W: Array
    sigma_W: Array
    distance: Array
    frames: IntArray
    suspect: BoolArray


def judge_tags(seen: Sightings, tag_map: TagMap) -> Judgement:
    """Where each tag seen often enough lies against the map; none may be."""
    rows, frames = np.unique(seen.row, return_counts=True)
    often = np.flatnonzero(frames >= _FEWEST)
    often = often[np.argsort(-frames[often], kind="stable")[:_MOST_TAGS]]
    rows, frames = rows[np.sort(often)], frames[np.sort(often)]
    if len(rows) < 2:
        return _nothing()
    kept = np.isin(seen.row, rows)
    tag, camera = np.searchsorted(rows, seen.row[kept]), seen.frame[kept]
    _, camera = np.unique(camera, return_inverse=True)
    r, Jc, Jt = _linearised(seen, kept, tag_map)
    laying = _laying(tag_map, rows)
    offset_T, cov_T = _solve(r, Jc, Jt, tag, camera, laying)
    R_WT = tag_map.R_WT[rows]
    together = _together(tag, camera, len(rows))
    alone_W = among(np.einsum("kij,kj->ki", R_WT, offset_T), tag_map.p_WT[rows], together)
    alone_T = np.einsum("kji,kj->ki", R_WT, alone_W)
    usual = 1.4826 * np.median(np.abs(alone_T), axis=0)  # of a normal distribution: its sigma
    total = cov_T + np.maximum(laying[:, :3], usual)[:, :, None] ** 2 * np.eye(3)
    distance = np.sqrt(np.einsum("ki,kij,kj->k", alone_T, np.linalg.inv(total), alone_T))
    suspect = (distance > _SIGMAS) & (np.linalg.norm(alone_T, axis=-1) > _LEAST_M)
    sigma_W = np.sqrt(np.einsum("kij,kjl,kil->ki", R_WT, total, R_WT))
    return Judgement(rows, alone_W, sigma_W, distance, frames, suspect)


def among(offset_W: Array, p_WT: Array, together: Array) -> Array:
    """Offsets (k, 3) [m] less what moves each tag's company as one: a shift, a turn, a scale.

    p_WT (k, 3) [m]; together (k, k): in how many frames two tags were seen together. Neighbours
    that themselves lie elsewhere than the rest count little.
    """
    out = np.empty_like(offset_W)
    for k in range(len(offset_W)):
        near = np.flatnonzero((together[k] > 0) & (np.arange(len(offset_W)) != k))
        out[k] = offset_W[k]
        if not len(near):
            continue
        away = p_WT[near] - p_WT[k]
        A = np.zeros((len(near), 3, 7))  # d offset / d [shift, turn, scale] at the tag
        A[:, :, :3], A[:, :, 3:6], A[:, :, 6] = np.eye(3), -geo.hat(away), away
        weight = together[k, near] / together[k, near].sum()
        reach = float(np.sqrt(np.mean(away**2))) + 1e-9
        ridge = _RIDGE * np.diag([0.0, 0.0, 0.0, *(reach**2 * np.ones(4))])
        for _ in range(_LOCAL_STEPS):
            W = A * weight[:, None, None]
            normal = np.einsum("nri,nrj->ij", W, A) + ridge
            common = np.linalg.solve(normal, np.einsum("nri,nr->i", W, offset_W[near]))
            rest = np.linalg.norm(offset_W[near] - A @ common, axis=-1)
            scale = 2.0 * float(np.median(rest)) + 1e-9
            weight = together[k, near] / together[k, near].sum() / (1.0 + (rest / scale) ** 2)
        out[k] -= common[:3]
    return out


def _together(tag: IntArray, camera: IntArray, k: int) -> Array:
    """In how many frames each two tags were seen; (k, k)."""
    seen = np.zeros((int(camera.max()) + 1, k))
    seen[camera, tag] = 1.0
    return np.asarray(seen.T @ seen)


def _nothing() -> Judgement:
    none = np.zeros(0, dtype=np.int64)
    return Judgement(
        none, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), none, np.zeros(0, dtype=bool)
    )


def _laying(tag_map: TagMap, rows: IntArray) -> Array:
    """Sigmas of [x, y, z, tilt, tilt, yaw] in T; (k, 6)."""
    xy, z, yaw, tilt = tag_map.sigma[rows].T
    return np.asarray(np.maximum(np.stack([xy, xy, z, tilt, tilt, yaw], axis=-1), 1e-6))


def _linearised(seen: Sightings, kept: BoolArray, tag_map: TagMap) -> tuple[Array, Array, Array]:
    """Whitened residuals (m, 8), and d prediction / d camera and / d tag (m, 8, 6).

    Camera: [p in W, right rotation in C]; tag: [p in T, right rotation in T].
    """
    row, frame = seen.row[kept], seen.frame[kept]
    R_CW = np.swapaxes(seen.R_WC[frame], -1, -2)
    R_WT, X = tag_map.R_WT[row], tag_map.corners_T[row]
    R_CT = R_CW @ R_WT
    p_CT = np.einsum("mij,mj->mi", R_CW, tag_map.p_WT[row] - seen.p_WC[frame])
    x_C = np.einsum("mij,mcj->mci", R_CT, X) + p_CT[:, None]
    z = np.maximum(x_C[..., 2], 1e-3)
    n = x_C[..., :2] / z[..., None]
    d_n = np.zeros((*x_C.shape[:2], 2, 3))  # d normalised / d x_C
    d_n[..., 0, 0] = d_n[..., 1, 1] = 1.0 / z
    d_n[..., :, 2] = -n / z[..., None]
    J_px = seen.J_px_n[kept]
    d_px = J_px @ d_n
    sigma = np.hypot(seen.sigma_px[kept], _SYSTEMATIC_PX)[..., None]
    r = np.einsum("mcij,mcj->mci", J_px, seen.corners_n[kept] - n) / sigma
    camera = (-R_CW[:, None], geo.hat(x_C))
    tag = (R_CT[:, None], -R_CT[:, None] @ geo.hat(X))
    m = len(row)
    Jc, Jt = (
        np.concatenate([d_px @ p, d_px @ turn], axis=-1).reshape(m, 8, 6)
        / np.repeat(sigma[..., 0], 2, axis=1)[..., None]
        for p, turn in (camera, tag)
    )
    behind = (x_C[..., 2] <= 1e-3).any(axis=-1)
    for array in (r, Jc, Jt):
        array[behind] = 0.0
    return r.reshape(m, 8), Jc, Jt


def _solve(
    r: Array, Jc: Array, Jt: Array, tag: IntArray, camera: IntArray, laying: Array
) -> tuple[Array, Array]:
    """Offsets (k, 3) of the tags in T and their covariances (k, 3, 3).

    Reweighted: sightings that fit nowhere, and the map's word on tags that have clearly moved.
    """
    from scipy.linalg import cho_factor, cho_solve

    k, f = len(laying), int(camera.max()) + 1
    order = np.argsort(camera, kind="stable")
    groups = np.split(order, np.flatnonzero(np.diff(camera[order])) + 1)
    weight, hold = np.ones(len(r)), np.ones(k)
    for _ in range(_STEPS):
        W = Jc * weight[:, None, None]
        a, c = np.einsum("mri,mr->mi", W, r), np.einsum("mri,mr,m->mi", Jt, r, weight)
        B = np.einsum("mri,mrj->mij", W, Jt)
        Hc = np.zeros((f, 6, 6))
        np.add.at(Hc, camera, np.einsum("mri,mrj->mij", W, Jc))
        inverse = np.asarray(np.linalg.inv(Hc + 1e-9 * np.eye(6)), dtype=float)
        ac = np.zeros((f, 6))
        np.add.at(ac, camera, a)
        S, g = _reduced(Jt, weight, c, B, inverse, ac, tag, groups, k)
        prior = (hold[:, None] / laying**2).reshape(-1)
        factor = cho_factor(S + np.diag(prior))
        y = cho_solve(factor, g).reshape(k, 6)
        left = np.zeros((f, 6))
        np.add.at(left, camera, np.einsum("mij,mj->mi", B, y[tag]))
        xi = np.einsum("fij,fj->fi", inverse, ac - left)
        rest = r - np.einsum("mri,mi->mr", Jt, y[tag]) - np.einsum("mri,mi->mr", Jc, xi[camera])
        chi2 = np.einsum("mr,mr->m", rest, rest)
        weight = 1.0 / (1.0 + chi2 / _SIGHTING_CHI2)
        hold = (_TAIL + 6.0) / (_TAIL + np.sum((y / laying) ** 2, axis=-1))
    dof = max(8.0 * weight.sum() - 6.0 * (f + k), 1.0)
    spread = max(1.0, float((weight * chi2).sum()) / dof)
    cov = cho_solve(factor, np.eye(6 * k)).reshape(k, 6, k, 6)
    own = cov[np.arange(k), :3, np.arange(k), :3]
    return y[:, :3], spread * own


def _reduced(
    Jt: Array, weight: Array, c: Array, B: Array, inverse: Array, ac: Array, tag: IntArray,
    groups: list[IntArray], k: int,
) -> tuple[Array, Array]:  # fmt: skip
    """Normal matrix (6k, 6k) and vector (6k,) of the tags, the cameras eliminated (Schur)."""
    S, sums = np.zeros((6 * k, 6 * k)), np.zeros((k, 6))
    diagonal = np.zeros((k, 6, 6))
    np.add.at(diagonal, tag, np.einsum("mri,mrj,m->mij", Jt, Jt, weight))
    np.add.at(sums, tag, c)
    at = (6 * np.arange(k))[:, None] + np.arange(6)
    S[at[:, :, None], at[:, None, :]] = diagonal
    g = sums.reshape(-1)
    for i, rows in enumerate(groups):
        columns = at[tag[rows]].reshape(-1)
        wide = np.concatenate(B[rows], axis=-1)  # (6, 6 n)
        S[np.ix_(columns, columns)] -= wide.T @ inverse[i] @ wide
        g[columns] -= wide.T @ (inverse[i] @ ac[i])
    return S, g
