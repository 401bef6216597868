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
from vio import layout as at
from vio.frames import level_frame
from vio.intake import Interval
from vio.memory import no_memory
from vio.settings import VioConfig

_AGREE_RAD = np.radians(12.0)  # first poses whose attitudes differ more from the gyro's disagree
_AGREE_M = 0.25
_ACCELERATION = 1.0  # [m/s^2] sigma of the mean acceleration over the first poses
_STILL_BIAS_RAD_S = 3e-3


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Camera in IMU, nominal: R_IC (3, 3), p_IC (3,), time_offset_s (t_imu = t_cam + it)."""

    R_IC: Array
    p_IC: Array
    time_offset_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Begin:
    """Nominal state x (NOMINAL,) and covariance P (n, n) at t_ns; used: which poses agreed."""

    t_ns: int
    x: Array
    P: Array
    used: BoolArray


def is_still(intervals: Sequence[Interval], config: VioConfig) -> bool:
    """Whether the IMU lies still: steady readings and hardly a turn."""
    gyro = np.array([i.gyro for i in intervals])
    accel = np.array([i.accel for i in intervals])
    quiet_gyro = bool((gyro.std(axis=0) < config.start.still_gyro_rad_s).all())
    quiet_accel = bool((accel.std(axis=0) < config.start.still_accel_m_s2).all())
    return quiet_gyro and quiet_accel and bool(np.abs(gyro.mean(axis=0)).max() < 0.12)


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
    still = is_still(intervals, config)
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
    x = _nominal(R0, pvg, bias, rig)
    P = prior_covariance(config, still, None if gravity is None else gravity[1])
    return Begin(int(times[0]) - 1000, x, P, used)


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
    x[at.X_QWG : at.X_QWG + 4] = geo.quat_from_matrix(level_frame(pvg[2]))
    x[at.X_PIC : at.X_PIC + 3] = rig.p_IC
    x[at.X_RECENT :] = no_memory()
    return x


def prior_covariance(config: VioConfig, still: bool, gravity_sigma: float | None) -> Array:
    """P (n, n) at the start; at rest the velocity and the gyro bias are known better."""
    c = config.prior
    rad = np.radians
    sigma = np.zeros(at.WITH_LEVER)
    sigma[at.P : at.P + 3] = c.position_m
    sigma[at.V : at.V + 3] = 0.1 if still else c.velocity_m_s
    sigma[at.TH : at.TH + 3] = rad(c.attitude_deg)
    sigma[at.BG : at.BG + 3] = _STILL_BIAS_RAD_S if still else c.gyro_bias_rad_s
    sigma[at.BA : at.BA + 3] = c.accel_bias_m_s2
    sigma[at.EX : at.EX + 3] = rad(c.extrinsic_rotation_deg)
    sigma[at.TD] = c.time_offset_s
    sigma[at.GR : at.GR + 2] = rad(c.gravity_deg) if gravity_sigma is None else gravity_sigma
    sigma[at.BIAS : at.BIAS + 6] = 1.0
    sigma[at.LEVER : at.LEVER + 3] = c.lever_arm_m
    n = dimension(config)
    return np.diag(np.square(np.maximum(sigma[:n], 1e-9)))


def dimension(config: VioConfig) -> int:
    """Active error dimension: 21, 27 with the pose bias, 30 with the lever arm too."""
    if config.lever_arm:
        return at.WITH_LEVER
    return at.WITH_BIAS if config.pose_bias else at.BASE
