"""Whether the map's metres and the accelerometer's sign are those of the motion, gravity unknown.

Over two steps h1, h2 between three frames the velocity drops out; with F the force's share
    (p_c - p_b) / h2 - (p_b - p_a) / h1 = k F + G (h1 + h2) / 2
    F = D2 / h2 + V1 - D1 / h1     V, D: R_WI (f - b), integrated once and twice over a step
where p is the IMU in W. k is the map's metres per metre, G = k g: the map's scale where k is not 1,
the accelerometer's sign where it is negative. Nothing here reads a clock or keeps state.
"""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.setup_check.findings import Finding
from vio.setup_check.hypotheses import StatedRig, Turns, attitudes

_CHAIN_S = 1e-6  # a pair that ends where the next begins
_BIAS = 0.3  # [m/s^2] prior of the accelerometer's bias
_HUBER = 2.0  # sigmas
_G = 9.81  # [m/s^2]
_G_OFF = 0.1  # share by which k g may differ from it: beyond, the accelerometer's scale is wrong
_LEAST_ROWS = 12  # a half: 5 s of steps of 0.4 s
# Noise of F makes k too small by the square of its share in the accelerations.
_NOISE_SHARE = 0.12  # healthy logs that pass: k 0.97 to 1.03; hovering ones have 0.2 to 0.4
_SIGN_NOISE_SHARE = 0.25  # a sign needs less; a negated real log has 0.11
_SIGN_SIGMAS = 6.0  # a negated real log has 50
_SIGMAS = 3.0
_NAMED, _CERTAIN = np.log(1.1), np.log(1.15)  # healthy logs: 0.97 to 1.03
_AGREE = np.log(1.1)  # of two halves; 1.8 times too large: 1.818 and 1.843


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Turns with the camera's places at both ends: p_WC (k, 2, 3) [m], in the map's metres."""

    turns: Turns
    p_WC: Array


@dataclass(frozen=True, slots=True)
class Scale:
    """k: the map's metres per metre, with its sigma; g [m/s^2]: size of the gravity found.

    noise_share: rms of what is left over that of the accelerations that tell.
    """

    k: float
    sigma: float
    g: float
    noise_share: float


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """y (m, 3) = k F (m, 3) + G h (m,) - B (m, 3, 3) b, as above; all [m/s], h [s]."""

    y: Array
    F: Array
    B: Array
    h: Array

    def __len__(self) -> int:
        return len(self.h)

    def part(self, rows: slice) -> "Differences":
        """Some of the rows."""
        return Differences(self.y[rows], self.F[rows], self.B[rows], self.h[rows])


def _forces(path: Path, rig: StatedRig) -> tuple[Array, Array, Array, Array]:
    """V, D (k, 3): force over each pair in W, integrated once and twice; the same of R_WI."""
    turns = path.turns
    q = attitudes(turns.t_s, turns.gyro)
    k = len(turns.a_s)
    V, D = np.zeros((k, 3)), np.zeros((k, 3))
    RV, RD = np.zeros((k, 3, 3)), np.zeros((k, 3, 3))
    t_imu = turns.t_s - rig.offset_s
    R_WI = turns.R_WC @ rig.R_CI
    for i in range(k):
        a, b = turns.a_s[i], turns.b_s[i]
        lo, hi = np.searchsorted(t_imu, [a, b])
        if lo < 1 or hi >= len(t_imu) or hi - lo < 2:
            V[i] = np.nan
            continue
        rows = slice(lo - 1, hi + 1)
        t = np.clip(t_imu[rows], a, b)
        back = geo.conjugate_quat(q[lo - 1])
        R = R_WI[i] @ geo.matrix_from_quat(geo.multiply_quat(back[None], q[rows]))
        end = R_WI[i] @ rig.R_CI.T @ geo.exp(turns.phi_C[i]) @ rig.R_CI
        slip = geo.log(R[-1].T @ end)
        R = R @ geo.exp((t - a)[:, None] / (b - a) * slip)
        f = np.einsum("nij,nj->ni", R, turns.accel[rows])
        dt = np.diff(t)
        mean_f, mean_R = 0.5 * (f[1:] + f[:-1]), 0.5 * (R[1:] + R[:-1])
        left = b - 0.5 * (t[1:] + t[:-1])
        V[i], RV[i] = dt @ mean_f, np.einsum("n,nij->ij", dt, mean_R)
        D[i], RD[i] = (dt * left) @ mean_f, np.einsum("n,nij->ij", dt * left, mean_R)
    return V, D, RV, RD


def differences(path: Path, rig: StatedRig, p_CI: Array) -> Differences:
    """One row at each of the m places where two pairs meet; p_CI (3,) [m]."""
    turns = path.turns
    V, D, RV, RD = _forces(path, rig)
    h = turns.b_s - turns.a_s
    lever = np.stack([turns.R_WC @ p_CI, turns.R_WC @ geo.exp(turns.phi_C) @ p_CI], axis=1)
    ok = np.asarray(np.isfinite(V).all(axis=-1))
    apart: Array = np.abs(turns.b_s[:-1] - turns.a_s[1:])
    i = np.flatnonzero((apart < _CHAIN_S) & ok[:-1] & ok[1:])
    j = i + 1

    def second(p: Array) -> Array:
        v_i, v_j = (p[n, 1] - p[n, 0] for n in (i, j))
        return np.asarray(v_j / h[j, None] - v_i / h[i, None])

    F = D[j] / h[j, None] + V[i] - D[i] / h[i, None] - second(lever)
    B = RD[j] / h[j, None, None] + RV[i] - RD[i] / h[i, None, None]
    return Differences(second(path.p_WC), F, B, 0.5 * (h[i] + h[j]))


def doubled(path: Path) -> Path:
    """Every two pairs that meet as one: places tell accelerations by the square of the step."""
    turns, kept, k = path.turns, [], 0
    while k + 1 < len(turns.a_s):
        meet = abs(turns.b_s[k] - turns.a_s[k + 1]) < _CHAIN_S
        if meet:
            kept.append(k)
        k += 2 if meet else 1
    i = np.array(kept, dtype=np.int64)
    first, second = geo.exp(turns.phi_C[i]), geo.exp(turns.phi_C[i + 1])
    joined = Turns(
        turns.a_s[i], turns.b_s[i + 1], geo.log(first @ second), turns.sigma[i], turns.R_WC[i],
        turns.t_s, turns.gyro, turns.accel,
    )  # fmt: skip
    return Path(joined, np.stack([path.p_WC[i, 0], path.p_WC[i + 1, 1]], axis=1))


def estimate_scale(found: Differences) -> Scale:
    """k, G and the accelerometer's bias by least squares, robust; sigma from what is left."""
    m = len(found)
    A = np.zeros((m, 3, 7))
    A[:, :, 0], A[:, :, 1:4] = found.F, found.h[:, None, None] * np.eye(3)
    A[:, :, 4:] = -found.B
    w, var = np.ones(m), 1e-6
    x, information = np.zeros(7), np.eye(7)
    for _ in range(8):
        # the columns of b are those of k b: their prior grows with k
        prior = np.diag([0.0] * 4 + [var / (_BIAS * max(abs(x[0]), 1.0)) ** 2] * 3)
        information = np.einsum("m,mij,mik->jk", w, A, A) + prior
        x = np.linalg.solve(information, np.einsum("m,mij,mi->j", w, A, found.y))
        left = found.y - A @ x
        size = np.linalg.norm(left, axis=-1) / np.sqrt(3.0)
        w = np.minimum(1.0, _HUBER * max(float(np.median(size)), 1e-9) / np.maximum(size, 1e-12))
        var = float(np.sum(w[:, None] * left**2)) / (3 * m - 7)
    force = found.F / found.h[:, None]
    moved = float(np.sqrt(np.mean(np.sum((force - force.mean(axis=0)) ** 2, axis=-1))))
    noise = np.sqrt(var) / float(np.mean(found.h)) / max(abs(x[0]), 1e-9)
    return Scale(
        float(x[0]),
        float(np.sqrt(var * np.linalg.inv(information)[0, 0])),
        float(np.linalg.norm(x[1:4])) / max(abs(float(x[0])), 1e-9),
        float(noise / max(moved, 1e-9)),
    )


def check_scale(path: Path, rig: StatedRig, p_CI: Array) -> tuple[list[Finding], bool]:
    """What two halves agree on of the map's scale and the force's sign, and whether they tell.

    p_CI (3,) [m]: the IMU in the camera. The axes, turns and clocks must be right: T_cam_imu is
    used as the files have it.
    """
    found = differences(doubled(path), rig, p_CI)
    half = len(found) // 2
    if half < _LEAST_ROWS:
        return [], False
    parts = [found.part(rows) for rows in (slice(0, half), slice(half, None), slice(None))]
    scales = [estimate_scale(part) for part in parts]
    shares = [s.noise_share for s in scales]
    if max(shares) < _SIGN_NOISE_SHARE and all(s.k < -_SIGN_SIGMAS * s.sigma for s in scales):
        text = ("specific force is against the motion that the tags show: the accelerometer's sign"
                " is wrong (at rest specific force points up)")  # fmt: skip
        return [Finding("gravity", text, 180.0, certain=True)], True
    if max(shares) > _NOISE_SHARE or min(s.k for s in scales) <= 0.0:
        return [], False
    logs = [np.log(s.k) for s in scales]
    least = min(abs(x) - _SIGMAS * s.sigma / s.k for x, s in zip(logs, scales, strict=True))
    whole = scales[2]
    agree = abs(logs[0] - logs[1]) < _AGREE
    if least < _NAMED or not agree or abs(whole.g / _G - 1.0) > _G_OFF:
        return [], True
    return [_wrong_metres(whole, bool(least > _CERTAIN))], True


_UNITS = ((1e2, "centimetres for metres"), (1e3, "millimetres for metres"),
          (1.0 / 0.3048, "feet for metres"))  # fmt: skip


def _wrong_metres(scale: Scale, certain: bool) -> Finding:
    meant = next((what for k, what in _UNITS if abs(np.log(scale.k / k)) < _NAMED), None)
    why = meant or "all sizes and places, or the camera's focal length"
    text = (f"the map's metres are {scale.k:.3g} times those of the IMU's motion (sigma"
            f" {scale.sigma:.2g}): {why}?")  # fmt: skip
    return Finding("size_kind", text, scale.k, certain)
