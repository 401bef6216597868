"""The filter's start: pose, velocity and gravity's direction from the first poses and the IMU.

Only the nominal state comes from here; its prior stays wide and the same poses are then fused as
any others, so that the covariance is honest about what they share (extrinsics above all).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import PoseMeasurement
from vio.config.filter import PriorConfig, VioConfig
from vio.filter import state as at
from vio.filter.adaptive_noise import no_memory
from vio.filter.noise_model import switched_on
from vio.filter.preprocessing import Interval
from vio.frames import level_frame

_AGREE_RAD = np.radians(12.0)  # first poses whose attitudes differ more from the gyro's disagree
_AGREE_M = 0.25
_ACCELERATION = 1.0  # [m/s^2] sigma of the mean acceleration over the first poses
_STILL_BIAS_RAD_S, _STILL_SPEED_SIGMA_M_S = 3e-3, 0.1  # sigmas at rest
# slower than that is rest: errors of poses that drift look like it, and the start leaves it open
_STILL_RATE_RAD_S, _STILL_SPEED_M_S = 0.0175, 0.03
_LEAST_SCATTER_M, _LEAST_SCATTER_RAD = 2e-4, 3e-4  # of a pose, however well the others agree
_CLEAR = 4.5  # sigmas per axis of a vector's size: 1 in 5,000, three axes
_FAR = 4.0  # sigmas


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Camera in IMU, nominal: R_IC (3, 3), p_IC (3,), time_offset_s (t_imu = t_cam + it)."""

    R_IC: Array
    p_IC: Array
    time_offset_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Begin:
    """Nominal state x (NOMINAL,) and covariance P (n, n) at t_ns; used: which poses agreed.

    tilt_rad: sigma of T_cam_imu where force and the map's gravity ask for a wider one, else 0.
    """

    t_ns: int
    x: Array
    P: Array
    used: BoolArray
    tilt_rad: float = 0.0


def is_still(intervals: Sequence[Interval], config: VioConfig) -> bool:
    """Whether the IMU lies still: steady readings and hardly a turn."""
    gyro = np.array([i.gyro for i in intervals])
    accel = np.array([i.accel for i in intervals])
    quiet_gyro = bool((gyro.std(axis=0) < config.start.still_gyro_rad_s).all())
    quiet_accel = bool((accel.std(axis=0) < config.start.still_accel_m_s2).all())
    return quiet_gyro and quiet_accel and bool(np.abs(gyro.mean(axis=0)).max() < 0.12)


@dataclass(frozen=True, slots=True)
class Trend:
    """How poses move on the whole: speed [m/s] and rate [rad/s], each with its sigma."""

    speed: float
    speed_sigma: float
    rate: float
    rate_sigma: float


def trend(poses: Sequence[PoseMeasurement]) -> Trend:
    """Straight lines through poses of C by least squares, sigmas from what they leave."""
    if len(poses) < 3:
        return Trend(0.0, np.inf, 0.0, np.inf)
    t = np.array([p.t_ns - poses[0].t_ns for p in poses]) * 1e-9
    R = np.array([p.R_WC for p in poses])
    turned = geo.log(R[len(R) // 2].T @ R)
    moved = np.array([p.p_WC for p in poses])
    speed, speed_sigma = _slope(t, moved, _LEAST_SCATTER_M)
    rate, rate_sigma = _slope(t, turned, _LEAST_SCATTER_RAD)
    return Trend(speed, speed_sigma, rate, rate_sigma)


def _slope(t: Array, x: Array, least: float) -> tuple[float, float]:
    """Size of the slope of x (k, 3) over t (k,), and its sigma per axis; outliers left out once."""
    keep = np.ones(len(t), dtype=bool)
    slope, left, spread = np.zeros(3), np.zeros_like(x), 1e-9
    for _ in range(2):
        tau = t - t[keep].mean()
        spread = max(float(tau[keep] @ tau[keep]), 1e-9)
        centred = x - x[keep].mean(axis=0)
        slope = tau[keep] @ centred[keep] / spread
        left = np.linalg.norm(centred - tau[:, None] * slope, axis=1)
        keep = left <= max(3.0 * float(np.median(left)), least)
        if keep.sum() < 3:
            break
    scatter = float(np.sum(left[keep] ** 2)) / (3.0 * max(int(keep.sum()) - 2, 1))
    return float(np.linalg.norm(slope)), float(np.sqrt(max(scatter, least**2) / spread))


def moves(poses: Sequence[PoseMeasurement]) -> bool:
    """Whether poses turn or move beyond doubt: then a calm IMU is not at rest."""
    line = trend(poses)
    turns = line.rate > max(_STILL_RATE_RAD_S, _CLEAR * line.rate_sigma)
    return turns or line.speed > max(_STILL_SPEED_M_S, _CLEAR * line.speed_sigma)


class CalibrationBounds:
    """What biases and calibration can be at all: four sigmas of the widest prior."""

    def __init__(self, prior: PriorConfig, rig: Rig) -> None:
        wide = PriorConfig()  # a tighter prior of a file never makes the filter LOST
        turn = max(prior.extrinsic_rotation_deg, wide.extrinsic_rotation_deg)
        self._q_IC, self._td = geo.quat_from_matrix(rig.R_IC), rig.time_offset_s
        self._cos = float(np.cos(0.5 * _FAR * np.radians(turn)))
        self._offset_s = _FAR * max(prior.time_offset_s, wide.time_offset_s)
        self._bias = _FAR * np.repeat(
            [
                max(prior.gyro_bias_rad_s, wide.gyro_bias_rad_s),
                max(prior.accel_bias_m_s2, wide.accel_bias_m_s2),
            ],
            3,
        )

    def calibration_far(self, x: Array) -> bool:
        """Whether the camera's rotation or its time offset has left them; x (NOMINAL,)."""
        turned = abs(float(self._q_IC @ x[at.X_QIC : at.X_QIC + 4])) < self._cos
        return turned or abs(float(x[at.X_TD]) - self._td) > self._offset_s

    def implausible(self, x: Array) -> bool:
        """Whether any of them has, biases included."""
        biases = x[at.X_BG : at.X_BG + 6]
        return self.calibration_far(x) or bool((np.abs(biases) > self._bias).any())


def integrate(intervals: Sequence[Interval], times: IntArray, bias: Array) -> tuple[Array, Array]:
    """Turn R_0i (k, 3, 3) and double integral u_0i (k, 3) of R_0 f from times[0] to each time."""
    R, v, u = np.eye(3), np.zeros(3), np.zeros(3)
    now, i = int(times[0]), 0
    turns, shifts = [], []
    for t in times.tolist():
        while now < t and i < len(intervals):
            step = intervals[i]
            if step.t_ns <= now:
                i += 1
                continue
            end = min(t, step.t_ns)
            dt, w = (end - now) * 1e-9, step.gyro - bias
            a = R @ geo.exp(0.5 * dt * w) @ step.accel
            u, v, R = u + dt * v + 0.5 * dt * dt * a, v + dt * a, R @ geo.exp(dt * w)
            now = end
        turns.append(R)
        shifts.append(u)
    return np.array(turns), np.array(shifts)


def _largest_agreement(R_W0: Array) -> BoolArray:
    """The poses whose attitude at the first one's time agrees with most others; (k, 3, 3)."""
    apart = geo.angle(np.swapaxes(R_W0[:, None], -1, -2) @ R_W0[None])
    near = apart < _AGREE_RAD
    return np.asarray(near[int(near.sum(axis=1).argmax())])


def _launch(p: Array, tau: Array, u_W: Array, sigma: Array, g0: Array, g_sigma: float) -> Array:
    """Position, velocity and gravity (3, 3) by least squares of p = p0 + v tau + g tau^2/2 + u."""
    A = np.stack([np.ones_like(tau), tau, 0.5 * tau**2], axis=-1) / sigma[:, None]
    A = np.vstack([A, [[0.0, 0.0, 1.0 / g_sigma]]])
    b = np.vstack([(p - u_W) / sigma[:, None], g0[None] / g_sigma])
    return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


def _free_fall(p_WI: Array, tau: Array, u_W: Array) -> tuple[Array, float]:
    """Position, velocity and gravity (3, 3) by poses and IMU alone; sigma of gravity [m/s^2]."""
    A = np.stack([np.ones_like(tau), tau, 0.5 * tau**2], axis=-1)
    fit = np.linalg.lstsq(A, p_WI - u_W, rcond=None)[0]
    left = p_WI - u_W - A @ fit
    scatter = np.sqrt(np.sum(left**2) / max(3 * (len(tau) - 3), 1))
    spread = np.linalg.pinv(A.T @ A)[2, 2]
    return np.asarray(fit), float(max(scatter, 5.0 * _LEAST_SCATTER_M) * np.sqrt(spread))


def _tilt_sigma(g_W: Array, gravity: tuple[Array, float], sigma: float, config: VioConfig) -> float:
    """The likeliest sigma [rad] of T_cam_imu's tilt by the gravity found (3,) and the map's.

    An angle between the two of which the poses' scatter (sigma [m/s^2]), the map's own sigma and
    the accelerometer's bias explain a part: sigma^2 = angle^2 / 2 - the rest, two axes. It tells a
    file that is further off than its prior before anything is built on it.
    """
    g, prior = config.gravity_m_s2, config.prior
    cos = float(g_W @ gravity[0]) / max(float(np.linalg.norm(g_W)), 1e-9)
    angle = float(np.arccos(np.clip(cos, -1.0, 1.0)))
    rest = np.square([sigma / g, gravity[1], prior.accel_bias_m_s2 / g])
    return float(np.sqrt(max(0.5 * angle**2 - float(rest.sum()), 0.0)))


def begin(
    poses: Sequence[PoseMeasurement],
    intervals: Sequence[Interval],
    rig: Rig,
    config: VioConfig,
    gravity: tuple[Array, float] | None,
) -> Begin | None:
    """A start from these poses, or None where they do not agree with the IMU or each other.

    gravity: direction (3,) in W and sigma [rad] where the map knows it.
    """
    shift = round(rig.time_offset_s * 1e9)
    times = np.array([p.t_ns + shift for p in poses], dtype=np.int64)
    still = is_still(intervals, config) and not moves(poses)
    bias = np.mean([i.gyro for i in intervals], axis=0) if still else np.zeros(3)
    turns, shifts = integrate(intervals, times, bias)
    R_WI = np.array([p.R_WC for p in poses]) @ rig.R_IC.T
    R_W0 = R_WI @ np.swapaxes(turns, -1, -2)
    used = _largest_agreement(R_W0)
    if used.sum() < max(3, 0.6 * len(poses)):
        return None
    R0 = geo.project_to_so3(R_W0[used].mean(axis=0))
    p_WI = np.array([p.p_WC for p in poses]) - R_WI @ rig.p_IC
    sigma = np.sqrt([max(np.trace(p.cov[:3, :3]) / 3.0, 1e-6) for p in poses])
    tau, u_W = (times - times[0]) * 1e-9, shifts @ R0.T
    g = config.gravity_m_s2
    force = R0 @ np.mean([i.accel for i in intervals], axis=0) if still else _mean_force(u_W, tau)
    g0, g_sigma = -force * g / max(float(np.linalg.norm(force)), 1e-9), _ACCELERATION
    if gravity is not None:
        g0, g_sigma = gravity[0] * g, max(gravity[1], 1e-3) * g
    elif still:
        g_sigma = 0.02 * g
    for _ in range(2):
        pvg = _launch(p_WI[used], tau[used], u_W[used], sigma[used], g0, g_sigma)
        expected = pvg[0] + tau[:, None] * pvg[1] + 0.5 * tau[:, None] ** 2 * pvg[2] + u_W
        miss = np.linalg.norm(p_WI - expected, axis=1)
        used = used & (miss < np.maximum(_AGREE_M, 4.0 * sigma))
        if used.sum() < max(3, 0.6 * len(poses)):
            return None
    tilt = 0.0
    if gravity is not None:
        free, g_free_sigma = _free_fall(p_WI[used], tau[used], u_W[used])
        tilt = _tilt_sigma(free[2], gravity, g_free_sigma, config)
        if tilt <= np.radians(config.prior.extrinsic_rotation_deg):
            tilt = 0.0
        pvg = np.vstack([free[:2], gravity[0][None] * g]) if tilt else pvg
    x = _nominal(R0, pvg, bias, rig)
    P = prior_covariance(config, still, None if gravity is None else gravity[1])
    ex = slice(at.EX, at.EX + 3)
    P[ex, ex] = np.maximum(P[ex, ex], tilt**2 * np.eye(3))
    if still:  # the poses vouch for no turn beyond what they can tell
        line = trend(poses)
        slow = min(float(np.hypot(line.rate, line.rate_sigma)), config.prior.gyro_bias_rad_s)
        P[at.BG : at.BG + 3, at.BG : at.BG + 3] += np.eye(3) * slow**2
    return Begin(int(times[0]) - 1000, x, P, used, tilt)


def _mean_force(u_W: Array, tau: Array) -> Array:
    """Mean specific force over the poses, from its double integral (k, 3) by least squares."""
    A = np.stack([tau, 0.5 * tau**2], axis=-1)
    return np.asarray(np.linalg.lstsq(A, u_W, rcond=None)[0][1])


def _nominal(R_WI: Array, pvg: Array, gyro_bias: Array, rig: Rig) -> Array:
    x = np.zeros(at.NOMINAL)
    x[at.X_P : at.X_P + 3], x[at.X_V : at.X_V + 3] = pvg[0], pvg[1]
    x[at.X_Q : at.X_Q + 4] = geo.quat_from_matrix(R_WI)
    x[at.X_BG : at.X_BG + 3] = gyro_bias
    x[at.X_QIC : at.X_QIC + 4] = geo.quat_from_matrix(rig.R_IC)
    x[at.X_TD] = rig.time_offset_s
    x[at.X_QWL : at.X_QWL + 4] = geo.quat_from_matrix(level_frame(pvg[2]))
    x[at.X_PIC : at.X_PIC + 3] = rig.p_IC
    x[at.X_RECENT :] = no_memory()
    return x


def prior_covariance(config: VioConfig, still: bool, gravity_sigma: float | None) -> Array:
    """P (n, n) at the start; at rest the velocity and the gyro bias are known better."""
    known = {} if gravity_sigma is None else {"q_WL_hat": gravity_sigma}
    if still:
        known |= {"v_WI": _STILL_SPEED_SIGMA_M_S, "b_g": _STILL_BIAS_RAD_S}
    sigma = np.concatenate([
        np.full(b.error, known.get(b.name, _prior(b, config)))
        for b in at.BLOCKS
        if not b.switch or b.switch in switched_on(config)
    ])  # fmt: skip
    return np.diag(np.square(np.maximum(sigma, 1e-9)))


def _prior(block: at.Block, config: VioConfig) -> float:
    """A block's sigma at the start, angles in radians."""
    if isinstance(block.prior, float):
        return block.prior
    value = float(getattr(config.prior, block.prior))
    return float(np.radians(value)) if block.prior.endswith("_deg") else value
