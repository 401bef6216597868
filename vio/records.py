"""The records that flow through vio: samples of a live or logged IMU, truth, phases, noise."""

from dataclasses import dataclass

from tagvo.geometry import Array, BoolArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class ImuSample:
    """One IMU sample.

    t_ns in the IMU's clock; gyro_I (3,) [rad/s]; accel_I (3,) specific force [m/s^2];
    arrival_ns: when it was known, in the same clock; mean: the figures are means since the sample
    before (increments divided by the interval), not values at t_ns.
    """

    t_ns: int
    gyro_I: Array
    accel_I: Array
    arrival_ns: int
    mean: bool = False


@dataclass(frozen=True, slots=True)
class Ground:
    """Whether the vehicle stands still on the ground, as known at arrival_ns in the IMU's clock."""

    arrival_ns: int
    on_ground: bool


@dataclass(frozen=True, slots=True, eq=False)
class ImuTrack:
    """n IMU samples in the order of their file, which need not be that of time.

    t_ns (n,); gyro_I (n, 3) [rad/s]; accel_I (n, 3) specific force [m/s^2]; arrival_ns (n,);
    mean (n,) as in ImuSample, None: values at their stamps.
    """

    t_ns: IntArray
    gyro_I: Array
    accel_I: Array
    arrival_ns: IntArray
    mean: BoolArray | None = None

    def __len__(self) -> int:
        return len(self.t_ns)

    def sample(self, row: int) -> ImuSample:
        """One row as a sample; its arrays are views."""
        mean = False if self.mean is None else bool(self.mean[row])
        return ImuSample(
            int(self.t_ns[row]), self.gyro_I[row], self.accel_I[row], int(self.arrival_ns[row]),
            mean,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """n reference poses of I in W, stamps strictly ascending.

    t_ns (n,); p_WI (n, 3) [m]; q_WI (n, 4) wxyz, unit; where the file has them (NaN: not known):
    v_WI (n, 3) [m/s], b_g (n, 3) [rad/s] and b_a (n, 3) [m/s^2] biases in I.
    """

    t_ns: IntArray
    p_WI: Array
    q_WI: Array
    v_WI: Array | None = None
    b_g: Array | None = None
    b_a: Array | None = None

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class Phase:
    """A named part of a flight, from t_start_ns up to t_end_ns; names may repeat and nest."""

    name: str
    t_start_ns: int
    t_end_ns: int


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Effective continuous-time densities of an IMU, with Kalibr's meanings.

    accel_density [m/s^2/sqrt(Hz)], accel_walk [m/s^3/sqrt(Hz)], gyro_density [rad/s/sqrt(Hz)],
    gyro_walk [rad/s^2/sqrt(Hz)]; rate_hz: nominal, None where the file does not say.
    """

    accel_density: float
    accel_walk: float
    gyro_density: float
    gyro_walk: float
    rate_hz: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class NavState:
    """An estimate of I in W at one moment.

    t_ns: the moment, in the IMU's clock; p_WI (3,) [m]; R_WI (3, 3); v_WI (3,) [m/s], None where
    the estimator has none; cov (9, 9) of [p in W, right rotation in I, v in W], or (6, 6) without
    v, None where unknown; known_ns: when it was known, None: at once.
    """

    t_ns: int
    p_WI: Array
    R_WI: Array
    v_WI: Array | None = None
    cov: Array | None = None
    known_ns: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The filter at one moment, with all that a vehicle is told.

    t_ns: the moment in the camera's clock (nav.t_ns is in the IMU's); w_I (3,) angular rate without
    its bias [rad/s]; down_W (3,) gravity's direction in W, unit; down_sigma [rad] of that.
    """

    t_ns: int
    nav: NavState
    w_I: Array
    down_W: Array
    down_sigma: float = 0.0
