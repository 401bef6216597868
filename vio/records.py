"""The frozen records of vio: what an IMU says, and what the estimators answer."""

from dataclasses import dataclass

from tagvo.geometry import Array


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One sample of an IMU, in I.

    t_ns: the IMU's clock; gyro (3,) [rad/s]; accel (3,) specific force [m/s^2]; arrival_ns: when
    it was known, None: at its stamp; mean: the figures are means since the sample before
    (increments divided by the interval) and not values at t_ns.
    """

    t_ns: int
    gyro: Array
    accel: Array
    arrival_ns: int | None = None
    mean: bool = False


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Effective densities of one IMU, as Kalibr's imu.yaml names them; the start is a Pixhawk's.

    gyro [rad/s/sqrt(Hz)], accel [m/s^2/sqrt(Hz)], walks [rad/s^2/sqrt(Hz), m/s^3/sqrt(Hz)],
    rate [Hz]; gyro_max [rad/s] and accel_max [m/s^2]: where an axis saturates.
    """

    gyro: float = 3e-4
    accel: float = 5e-3
    gyro_walk: float = 2e-5
    accel_walk: float = 5e-4
    rate: float = 200.0
    gyro_max: float = 34.9
    accel_max: float = 156.9


@dataclass(frozen=True, slots=True, eq=False)
class NavState:
    """An estimate of I in W at one moment.

    p_WI (3,) [m]; R_WI (3, 3); v_WI (3,) [m/s], None where the estimator has none; cov (9, 9) of
    [p in W, right rotation in I, v in W], or (6, 6) without v, None where unknown.
    """

    t_ns: int
    p_WI: Array
    R_WI: Array
    v_WI: Array | None = None
    cov: Array | None = None
