"""Whether camera, IMU and map are set up as their files say: turn against turn, force against up.

Between two frames the camera turns by phi_C and the IMU by phi_I (rotation vectors). Where the
files are right
    phi_C = R_CI phi_I + dt b        R_CI: T_cam_imu's rotation, b: the gyro's bias
with the IMU's stamps moved by the time offset, and the mean specific force points up in W. What is
found instead names the mistake. Nothing here reads a clock or keeps state.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray
from vio.setup_check.findings import Finding, axes_words

_ENOUGH_RAD = np.radians(30.0)  # of turning, on two axes, in each window: the verdict's own rule
_SIGMAS2 = 9.0  # 3 sigma
_CERTAIN_RAD = np.radians(30.0)  # a rotation that no calibration error explains
_NAMED_RAD = np.radians(6.0)  # four sigmas of the filter's prior of 1.5 deg
_OFFSET_S = 0.05  # above the lag of any IMU filter met so far (11.5 ms) and the prior's 30 ms
_TILT_CERTAIN_RAD, _TILT_NAMED_RAD = np.radians(20.0), np.radians(5.0)
_AGREE_RAD, _AGREE_S = np.radians(15.0), 0.03  # of two windows
_REACH_S, _STEP_S = 1.0, 0.01  # offsets that are tried
_BIAS_RAD_S = 0.05  # prior of the gyro's bias
_FREE_FALL = 1.0  # [m/s^2] a median force below it is no specific force
_AXES_MORE = 1.5  # times the best chi-square that a change of axes may leave
_HUBER = 2.0  # sigmas
_REWEIGHTED = 6  # how often Huber's weights are taken anew


@dataclass(frozen=True, slots=True, eq=False)
class Turns:
    """k turns of the camera between frames, in its own clock, and the IMU's n samples.

    a_s, b_s (k,): stamps of each pair [s]; phi_C (k, 3) [rad], sigma (k,) per axis; R_WC (k, 3, 3)
    at a; t_s (n,), gyro (n, 3), accel (n, 3): samples in the IMU's clock, stamps ascending.
    """

    a_s: Array
    b_s: Array
    phi_C: Array
    sigma: Array
    R_WC: Array
    t_s: Array
    gyro: Array
    accel: Array

    def window(self, rows: slice) -> "Turns":
        """Some of the pairs, with all samples."""
        return Turns(
            self.a_s[rows], self.b_s[rows], self.phi_C[rows], self.sigma[rows], self.R_WC[rows],
            self.t_s, self.gyro, self.accel,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class StatedRig:
    """What the files say: R_CI (3, 3), offset_s (t_imu = t_cam + it), up_W (3,) or None."""

    R_CI: Array
    offset_s: float
    up_W: Array | None


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Q (3, 3) in phi_C = Q phi_I + dt b at one offset, its chi-square and information (3, 3)."""

    Q: Array
    chi2: Array
    information: Array


def attitudes(t_s: Array, gyro: Array) -> Array:
    """Attitudes (n, 4) wxyz of I against its first sample, gyro (n, 3) held over each interval."""
    half = 0.25 * np.diff(t_s)[:, None] * (gyro[1:] + gyro[:-1])
    q = np.zeros((len(t_s), 4))
    q[0, 0] = 1.0
    q[1:] = geo.exp_quat(2.0 * half)
    step = 1
    while step < len(q):  # every product of 2, then 4, 8, ... neighbours
        q[step:] = geo.multiply_quat(q[:-step], q[step:])
        step *= 2
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))


def imu_turns(turns: Turns, offsets_s: Array) -> Array:
    """Turns of I over each pair at m offsets; (m, k, 3) [rad]."""
    q = attitudes(turns.t_s, turns.gyro)

    def at(t_s: Array) -> Array:
        row = np.clip(np.searchsorted(turns.t_s, t_s, side="right") - 1, 0, len(q) - 1)
        rest = np.clip(t_s - turns.t_s[row], 0.0, 0.05)
        return geo.multiply_quat(q[row], geo.exp_quat(rest[..., None] * turns.gyro[row]))

    first = geo.conjugate_quat(at(turns.a_s + offsets_s[:, None]))
    return geo.log_quat(geo.multiply_quat(first, at(turns.b_s + offsets_s[:, None])))


def _fit(phi_C: Array, phi_I: Array, dt: Array, sigma: Array, det: float) -> _Fit:
    """The rotation (det 1) or mirror (det -1) of m sets of turns; phi_I (m, k, 3)."""
    m = len(phi_I)
    w = np.broadcast_to(1.0 / sigma**2, phi_I.shape[:2]).copy()
    bias = np.zeros((m, 3))
    Q = np.broadcast_to(np.eye(3), (m, 3, 3))
    left = phi_C - phi_I
    for _ in range(_REWEIGHTED):
        y = phi_C - dt[:, None] * bias[:, None]
        U, _, Vt = np.linalg.svd(np.einsum("mk,mki,mkj->mij", w, y, phi_I))
        flip = det * np.sign(np.linalg.det(U @ Vt))
        U[:, :, 2] *= flip[:, None]
        Q = U @ Vt
        left = phi_C - np.einsum("mij,mkj->mki", Q, phi_I)
        bias = np.einsum("mk,k,mki->mi", w, dt, left)
        bias /= (np.einsum("mk,k->m", w, dt**2) + 1.0 / _BIAS_RAD_S**2)[:, None]
        left = left - dt[:, None] * bias[:, None]
        size = np.linalg.norm(left, axis=-1) / (np.sqrt(3.0) * sigma)
        scale = np.maximum(np.median(size, axis=-1, keepdims=True), 1e-9)
        w = np.minimum(1.0, _HUBER * scale / np.maximum(size, 1e-12)) / sigma**2
    chi2 = np.einsum("mk,mki,mki->m", w, left, left)
    square = np.einsum("mk,mki,mki->m", w, phi_I, phi_I)
    outer = np.einsum("mk,mki,mkj->mij", w, phi_I, phi_I)
    return _Fit(Q, chi2, square[:, None, None] * np.eye(3) - outer)


def _left(Q: Array, phi_C: Array, phi_I: Array, dt: Array, sigma: Array) -> float:
    """Chi-square that a given Q leaves, its bias free; robust as `_fit` is."""
    left = phi_C - phi_I @ Q.T
    w = dt / sigma**2
    bias = (w @ left) / (float(w @ dt) + 1.0 / _BIAS_RAD_S**2)
    left = left - dt[:, None] * bias
    size = np.linalg.norm(left, axis=-1) / (np.sqrt(3.0) * sigma)
    weight = np.minimum(1.0, _HUBER * max(float(np.median(size)), 1e-9) / np.maximum(size, 1e-12))
    return float(np.sum(weight * 3.0 * size**2))


def turning(phi: Array) -> Array:
    """How far k turns (k, 3) go in all, about each of their principal axes, descending; (3,)."""
    _, _, Vt = np.linalg.svd(phi, full_matrices=False)
    return np.sort(np.abs(phi @ Vt.T).sum(axis=0))[::-1]


def enough(turns: Turns, rig: StatedRig) -> bool:
    """Whether both halves turn by 30 degrees on two axes, by the gyro and by the camera."""
    half = len(turns.a_s) // 2
    if half < 10:
        return False
    parts = slice(0, half), slice(half, None)
    if not all(turning(turns.phi_C[rows])[1] > _ENOUGH_RAD for rows in parts):
        return False  # at rest the gyro need not be looked at
    phi_I = imu_turns(turns, np.array([rig.offset_s]))[0]
    return all(turning(phi_I[rows])[1] > _ENOUGH_RAD for rows in parts)


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """What one window says: the best offset and whether it is sure, rotation and mirror there."""

    offset_s: float
    late: bool
    mirrored: bool
    Q: Array
    turn: Array
    turn_sure: bool
    axes: Array | None


def _view(turns: Turns, rig: StatedRig) -> _View:
    offsets = rig.offset_s + np.arange(-_REACH_S, _REACH_S + 0.5 * _STEP_S, _STEP_S)
    inside = (turns.a_s + offsets[0] > turns.t_s[0]) & (turns.b_s + offsets[-1] < turns.t_s[-1])
    if inside.sum() < 10:  # a short log: less offset, more turns
        inside = (turns.a_s + rig.offset_s > turns.t_s[0]) & (
            turns.b_s + rig.offset_s < turns.t_s[-1]
        )
    phi_C, dt, sigma = turns.phi_C[inside], (turns.b_s - turns.a_s)[inside], turns.sigma[inside]
    phi = imu_turns(turns, offsets)[:, inside]
    straight, mirror = (_fit(phi_C, phi, dt, sigma, det) for det in (1.0, -1.0))
    chi2 = np.minimum(straight.chi2, mirror.chi2)
    best, file = int(np.argmin(chi2)), len(offsets) // 2
    unit = max(float(chi2[best]) / max(3 * len(dt) - 6, 1), 1.0)
    late = bool(chi2[file] - chi2[best] > max(_SIGMAS2 * unit, 0.5 * chi2[best]))
    late = late and 0 < best < len(offsets) - 1 and abs(offsets[best] - rig.offset_s) >= _OFFSET_S
    k = best if late else file
    gain = float(straight.chi2[k] - mirror.chi2[k])
    mirrored = gain > max(_SIGMAS2 * unit, 0.5 * float(mirror.chi2[k]))
    fit = mirror if mirrored else straight
    turn = geo.log(rig.R_CI.T @ fit.Q[k]) if not mirrored else np.full(3, np.nan)
    sure = not mirrored and float(turn @ fit.information[k] @ turn) > _SIGMAS2 * unit
    return _View(
        _between(offsets, chi2, best), late, mirrored, fit.Q[k], turn, sure,
        _axes(rig.R_CI, phi_C, phi[k], dt, sigma, float(fit.chi2[k]), unit),
    )  # fmt: skip


def _between(x: Array, y: Array, k: int) -> float:
    """Where the parabola through y at k and its neighbours is least."""
    if not 0 < k < len(x) - 1:
        return float(x[k])
    bend = y[k - 1] - 2.0 * y[k] + y[k + 1]
    return float(x[k] + 0.5 * (x[1] - x[0]) * (y[k - 1] - y[k + 1]) / max(float(bend), 1e-12))


SIGNED_AXES: tuple[Array, ...] = tuple(
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)


def _axes(
    R_CI: Array, phi_C: Array, phi_I: Array, dt: Array, sigma: Array, best: float, unit: float
) -> Array | None:
    """The one exchange of the IMU's axes that explains the turns as well as anything; or None."""
    left = [_left(R_CI @ S, phi_C, phi_I, dt, sigma) for S in SIGNED_AXES]
    order = np.argsort(left)
    S, chi2 = SIGNED_AXES[order[0]], left[order[0]]
    clear = left[order[1]] - chi2 > _SIGMAS2 * unit
    fits = chi2 < _AXES_MORE * best + _SIGMAS2 * unit
    return S if clear and fits and not np.array_equal(S, np.eye(3)) else None


def mean_force(turns: Turns, R_CI: Array, offset_s: float) -> tuple[Array, float]:
    """Mean specific force in W (3,) [m/s^2] if I sits so in C, and its sigma per axis."""
    t = turns.a_s + offset_s
    sums = np.vstack([np.zeros(3), np.cumsum(0.5 * (turns.accel[1:] + turns.accel[:-1])
                                             * np.diff(turns.t_s)[:, None], axis=0)])  # fmt: skip
    dt = turns.b_s - turns.a_s

    def at(when: Array) -> Array:
        return np.stack([np.interp(when, turns.t_s, sums[:, i]) for i in range(3)], axis=-1)

    f_I = (at(t + dt) - at(t)) / dt[:, None]
    R_WC = turns.R_WC @ geo.exp(0.5 * turns.phi_C)
    f_W = np.einsum("kij,jl,kl->ki", R_WC, R_CI, f_I)
    inside = (t >= turns.t_s[0]) & (t + dt <= turns.t_s[-1])
    f_W = f_W[inside] if inside.any() else f_W
    spread = float(np.sqrt(np.mean(f_W.var(axis=0)) / len(f_W)))
    return f_W.mean(axis=0), max(spread, 0.05)


def check_gravity(
    turns: Turns, rig: StatedRig, R_CI: Array | None = None
) -> tuple[float, float] | None:
    """Angle [rad] of the mean force from the map's up, with its sigma; None: the map knows none."""
    if rig.up_W is None:
        return None
    force, sigma = mean_force(turns, rig.R_CI if R_CI is None else R_CI, rig.offset_s)
    size = float(np.linalg.norm(force))
    if size < _FREE_FALL:
        return None
    cos = float(np.clip(force @ rig.up_W / size, -1.0, 1.0))
    return float(np.arccos(cos)), sigma / size


def check_force(accel: Array) -> Finding | None:
    """An IMU without specific force; accel (n, 3)."""
    size = float(np.median(np.linalg.norm(accel, axis=-1)))
    if size > _FREE_FALL:
        return None
    return Finding(
        "no_specific_force",
        f"the IMU shows no specific force (median {size:.2g} m/s^2; 9.8 is needed): accelerometer"
        " on another topic, or gravity taken out",
        size,
        certain=True,
    )


def check_setup(turns: Turns, rig: StatedRig) -> list[Finding]:
    """What two windows of these turns agree on that is set up otherwise than the files say.

    Empty where they do not turn enough (`enough`), but for gravity, which needs no turning.
    """
    half = len(turns.a_s) // 2
    halves = [turns.window(slice(0, half)), turns.window(slice(half, None))]
    found: list[Finding] = []
    axes: Array | None = None
    explained = False
    if enough(turns, rig):
        views = [_view(part, rig) for part in halves]
        whole = _view(turns, rig)
        late = _late(views, whole, rig)
        found += late
        found += (turned := [] if late else _turned(views, whole, turns, rig))
        axes = whole.axes
        explained = bool(turned)
    if not explained:
        found += _tilted(halves, turns, rig, axes)
    return found


def _late(views: Sequence[_View], whole: _View, rig: StatedRig) -> list[Finding]:
    apart = abs(views[0].offset_s - views[1].offset_s)
    if not (whole.late and all(v.late for v in views) and apart <= _AGREE_S):
        return []
    by = whole.offset_s - rig.offset_s
    return [
        Finding(
            "time_offset",
            f"the IMU's stamps are {1e3 * by:+.0f} ms off the camera's beyond timeshift_cam_imu"
            f" {1e3 * rig.offset_s:.1f} ms (t_imu = t_cam + shift)",
            by,
            certain=True,
        )
    ]


def _turned(views: Sequence[_View], whole: _View, turns: Turns, rig: StatedRig) -> list[Finding]:
    if whole.axes is not None and all(
        v.axes is not None and np.array_equal(v.axes, whole.axes) for v in views
    ):
        return [_exchanged(whole.axes, whole.Q, turns, rig)]
    if whole.mirrored and all(v.mirrored for v in views):
        text = "the gyro turns as a mirror image of the camera: one axis of it, or of T_cam_imu"
        return [Finding("mirrored", text + ", has the wrong sign", -1.0, certain=True)]
    if whole.mirrored or any(v.mirrored for v in views):
        return []
    angle = float(np.linalg.norm(whole.turn))
    agree = float(geo.angle(views[0].Q.T @ views[1].Q)) < _AGREE_RAD
    sure = whole.turn_sure and all(v.turn_sure for v in views)
    if not (agree and sure and angle > _NAMED_RAD):
        return []
    axis = ", ".join(f"{x:.1f}" for x in whole.turn / angle)
    text = f"T_cam_imu is turned by {np.degrees(angle):.1f} deg about ({axis}) of the IMU"
    text += _if_inverse(whole.Q, rig)
    return [
        Finding("cam_imu_rotation", text, float(np.degrees(angle)), certain=angle > _CERTAIN_RAD)
    ]


def _if_inverse(Q: Array, rig: StatedRig) -> str:
    """A word where the rotation found, Q (3, 3), is the inverse of the one in the files."""
    is_it = float(geo.angle(rig.R_CI @ Q)) < _NAMED_RAD
    return ": this is T_imu_cam, the inverse" if is_it else ""


def _exchanged(S: Array, Q: Array, turns: Turns, rig: StatedRig) -> Finding:
    """An exchange of axes, S (3, 3), with Q (3, 3) the camera's turn of the IMU's that was found.

    About z, force tells T_cam_imu's from the IMU's no better.
    """
    angle = float(np.degrees(geo.angle(S))) if np.linalg.det(S) > 0.0 else -1.0
    inverse = _if_inverse(Q, rig)
    if inverse and np.linalg.det(S) > 0.0:
        text = f"T_cam_imu is turned by {angle:.0f} deg{inverse}"
        return Finding("cam_imu_rotation", text, angle, certain=True)
    if np.linalg.det(S) > 0.0 and S[2, 2] == 1.0:
        text = f"T_cam_imu is turned by {angle:.0f} deg about z of the IMU (or the IMU's x and y)"
        return Finding("cam_imu_rotation", text, angle, certain=True)
    words = axes_words(S)
    tilt = check_gravity(turns, rig, rig.R_CI @ S)
    both = tilt is None or tilt[0] < _TILT_CERTAIN_RAD
    who = "the IMU's axes are not those of T_cam_imu" if both else "the gyro's axes are wrong"
    return Finding("imu_axes", f"{who}: {words}", angle, certain=True)


def _tilted(
    halves: Sequence[Turns], turns: Turns, rig: StatedRig, axes: Array | None
) -> list[Finding]:
    angles = [check_gravity(part, rig) for part in (*halves, turns) if len(part.a_s) >= 10]
    if len(angles) < 3 or any(a is None for a in angles):
        return []
    first, second, whole = (a for a in angles if a is not None)
    if abs(first[0] - second[0]) > _AGREE_RAD or axes is not None:
        return []
    least = max(_TILT_NAMED_RAD, 3.0 * whole[1])
    if min(first[0], second[0], whole[0]) < least:
        return []
    deg = float(np.degrees(whole[0]))
    why = "T_cam_imu tilted, or the map's gravity wrong"
    if deg > 150.0:
        why = "the accelerometer's sign (at rest specific force points up), or FRD for FLU"
    text = f"specific force points {deg:.0f} deg from the map's up: {why}"
    return [Finding("gravity", text, deg, certain=bool(whole[0] > _TILT_CERTAIN_RAD))]


def moving(phi: Array) -> BoolArray:
    """Which turns are finite and of frames that belong together; (k, 3) -> (k,)."""
    return np.asarray(np.isfinite(phi).all(axis=-1) & (np.linalg.norm(phi, axis=-1) < 2.5))
