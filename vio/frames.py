"""The one place of NED and FRD: from the map's frame and I to what a flight controller expects.

W, the map's frame, may hang anywhere; L is W turned level by the gravity estimate (z up, x ahead);
N is the local north-east-down frame with the same origin; B is the vehicle's body (forward, left,
up); F is the same body as forward, right, down.
"""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.records import NavState

FLIP = np.array([1.0, -1.0, -1.0])  # FLU to FRD and back
RELEVEL_RAD = float(np.radians(0.5))  # in the air: a reset there costs more than a smaller tilt
ON_GROUND_RAD = float(np.radians(0.1))  # disarmed: 0.5 deg sent a pose 4 cm off at 5 m in SITL
_CERTAIN = 4.0  # sigmas
_STANDS = 0.9  # an axis with more than this share along gravity is vertical
_FLOAT32 = 3.4e38


def level_frame(down_W: Array, axis: int | None = None) -> Array:
    """R_WL (3, 3): z of L against gravity, x the map's x made level (its y, where x stands).

    down_W (3,) gravity in W; axis: 0 or 1 to have the map's x or y whatever stands.
    """
    z = -down_W / np.linalg.norm(down_W)
    x = np.zeros(3)
    x[_axis(z) if axis is None else axis] = 1.0
    x = x - z * (x @ z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _axis(z_W: Array) -> int:
    return 0 if abs(z_W[0]) < _STANDS else 1


@dataclass(frozen=True, slots=True, eq=False)
class Levelling:
    """The map made level: R_LW (3, 3); axis: which of the map's axes is x of L (0: x, 1: y)."""

    R_LW: Array
    axis: int


def levelled(down_W: Array, axis: int | None = None) -> Levelling:
    """The levelling by a gravity direction (3,) in W of any length."""
    kept = _axis(down_W / np.linalg.norm(down_W)) if axis is None else axis
    return Levelling(level_frame(down_W, kept).T, kept)


def tilt(levelling: Levelling, down_W: Array) -> float:
    """Angle [rad] between the levelling's vertical and a gravity direction (3,) in W."""
    down_L = levelling.R_LW @ down_W
    return float(np.arctan2(np.hypot(down_L[0], down_L[1]), -down_L[2]))


def relevelled(
    levelling: Levelling, down_W: Array, sigma_rad: float = 0.0, least_rad: float = RELEVEL_RAD
) -> tuple[Levelling, bool]:
    """The levelling to go on with, and whether it is another one.

    Only where gravity's direction has moved by more than least_rad, and by more than four times its
    sigma: while it is still being learnt, each new levelling would only bring the next. The
    heading's axis stays, unless it has come to stand.
    """
    if tilt(levelling, down_W) <= max(least_rad, _CERTAIN * sigma_rad):
        return levelling, False
    stands = abs(down_W[levelling.axis]) > 0.99 * np.linalg.norm(down_W)
    return levelled(down_W, None if stands else levelling.axis), True


def ned_from_level(heading_rad: float) -> Array:
    """R_NL (3, 3), where the x of L has this compass heading."""
    c, s = np.cos(heading_rad), np.sin(heading_rad)
    return np.array([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """All that leads from (W, I) to (N, F): levelling, heading of the x of L, I in the body B."""

    levelling: Levelling
    heading_rad: float
    R_BI: Array
    p_BI: Array

    @property
    def R_NW(self) -> Array:
        """W to N; (3, 3)."""
        return ned_from_level(self.heading_rad) @ self.levelling.R_LW


@dataclass(frozen=True, slots=True, eq=False)
class NedPose:
    """The vehicle's body for a flight controller.

    p_NB (3,) [m]; R_NF (3, 3); v_NB (3,) [m/s] in N and w_F (3,) [rad/s] in F, None: unknown;
    cov (9, 9) of [p, small rotation about the axes of N, v] in N, or (6, 6) without v, or None.
    """

    p_NB: Array
    R_NF: Array
    v_NB: Array | None = None
    w_F: Array | None = None
    cov: Array | None = None


def to_ned(nav: NavState, alignment: Alignment, w_I: Array | None = None) -> NedPose:
    """The body's pose, velocity and covariance of a state of I in W.

    w_I (3,): angular rate [rad/s]; without it a body that is not where I is has no velocity.
    """
    R_NW, R_IB = alignment.R_NW, alignment.R_BI.T
    p_IB = -R_IB @ alignment.p_BI
    R_WB = nav.R_WI @ R_IB
    v_I = np.zeros(3) if w_I is None else geo.hat(w_I) @ p_IB
    known = nav.v_WI is not None and (w_I is not None or not p_IB.any())
    return NedPose(
        R_NW @ (nav.p_WI + nav.R_WI @ p_IB),
        (R_NW @ R_WB) * FLIP,
        R_NW @ (nav.v_WI + nav.R_WI @ v_I) if known and nav.v_WI is not None else None,
        None if w_I is None else FLIP * (alignment.R_BI @ w_I),
        None if nav.cov is None else _in_ned(nav.cov, R_NW, nav.R_WI, p_IB, v_I, known),
    )


def _in_ned(cov: Array, R_NW: Array, R_WI: Array, p_IB: Array, v_I: Array, with_v: bool) -> Array:
    """Covariance of [p, rotation about N, v] of the body from that of [p_WI, right in I, v_WI]."""
    R_NI = R_NW @ R_WI
    n = 9 if with_v and len(cov) == 9 else 6
    J = np.zeros((n, n))
    J[:3, :3] = R_NW
    J[:3, 3:6] = -R_NI @ geo.hat(p_IB)
    J[3:6, 3:6] = R_NI
    if n == 9:
        J[6:, 6:] = R_NW
        J[6:, 3:6] = -R_NI @ geo.hat(v_I)
    with np.errstate(invalid="ignore", over="ignore"):  # not finite: `triangle` says so
        return np.asarray(J @ cov[:n, :n] @ J.T)


def largest_sigmas(pose: NedPose | None) -> tuple[float, float]:
    """Standard deviation of the position [m] and attitude [deg] on their worst axis.

    0 where there is no covariance, infinite where that is not finite.
    """
    if pose is None or pose.cov is None:
        return 0.0, 0.0
    variance = np.nan_to_num(np.diag(pose.cov)[:6], nan=np.inf, posinf=np.inf)
    position, attitude = variance[:3].max(), variance[3:].max()
    return float(np.sqrt(max(position, 0.0))), float(np.degrees(np.sqrt(max(attitude, 0.0))))


def euler_321(R_NF: Array) -> Array:
    """Roll, pitch, yaw [rad] of F in N, roll and yaw in (-pi, pi]; (3, 3) -> (3,)."""
    rpy = geo.rpy_from_matrix(R_NF)
    return np.where(rpy <= -np.pi, rpy + 2.0 * np.pi, rpy)


def body_velocity(pose: NedPose) -> tuple[Array, Array | None] | None:
    """Velocity in F (3,) [m/s] with its covariance (3, 3) in F; None where it is unknown."""
    if pose.v_NB is None:
        return None
    R_FN = pose.R_NF.T
    if pose.cov is None or len(pose.cov) < 9:
        return R_FN @ pose.v_NB, None
    J = R_FN @ np.hstack([geo.hat(pose.v_NB), np.eye(3)])  # of [rotation about N, v in N]
    return R_FN @ pose.v_NB, J @ pose.cov[3:, 3:] @ J.T


def triangle(cov: Array | None, size: int = 6) -> list[float]:
    """Row-major upper triangle of the first `size` rows; all NaN where unknown or not sound."""
    count = size * (size + 1) // 2
    if cov is None:
        return [float("nan")] * count
    values = cov[np.triu_indices(size)]
    sound = bool((np.abs(values) < _FLOAT32).all()) and bool((np.diag(cov)[:size] >= 0.0).all())
    return values.tolist() if sound else [float("nan")] * count


def heading_of_map(yaw_rad: float, levelling: Levelling, R_WI: Array, R_BI: Array) -> float:
    """Heading [rad] of the x of L, in (-pi, pi], for which the body has this compass yaw."""
    R_NF = (ned_from_level(0.0) @ levelling.R_LW @ R_WI @ R_BI.T) * FLIP
    turn = yaw_rad - euler_321(R_NF)[2]
    return float(np.pi - (np.pi - turn) % (2.0 * np.pi))


_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # from north, east, down


def enu_of_ned(x_N: Array) -> Array:
    """Vectors from north, east, down to east, north, up; (..., 3) -> (..., 3)."""
    return np.asarray(x_N @ _ENU.T)


def flu_in_enu(q_NF: Array) -> Array:
    """Attitudes of the body FLU in ENU from those of FRD in NED; (..., 4) wxyz -> (..., 4)."""
    half = np.sqrt(0.5)
    turn = np.array([0.0, half, half, 0.0])  # ENU from NED: half a turn about x + y
    flip = np.array([0.0, 1.0, 0.0, 0.0])  # FRD from FLU: half a turn about x
    return geo.multiply_quat(geo.multiply_quat(np.broadcast_to(turn, q_NF.shape), q_NF),
                             np.broadcast_to(flip, q_NF.shape))  # fmt: skip
