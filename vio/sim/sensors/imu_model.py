"""The IMU model: what a real part adds to true rates and forces, one pure function a fault."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, model_validator
from scipy.signal import butter, lfilter, lfilter_zi

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.records import ImuNoise, ImuTrack
from vio.sim.model import Model, Range
from vio.sim.sensors.clocks import Clock, delays, jittered, kept
from vio.sim.sensors.simple_imu import PIXHAWK, Biases, bias_walk
from vio.sim.world.dynamics import DOWN_W, BodyFlight, inertial

Shaking: TypeAlias = Callable[[Array], tuple[Array, Array]]  # times -> gyro, accel vibration
_LEAST = ImuNoise(1e-5, 0.0, 1e-6, 0.0)  # imu.yaml must give densities above zero


class LowPass(Model):
    """A Butterworth filter within the part; stamps do not know of its delay."""

    cutoff_hz: PositiveFloat = Field(description="cut-off frequency [Hz]")
    order: int = Field(default=2, ge=1, le=6, description="order of the filter")


class ImuModel(Model):
    """A part and its bus; sigmas are of what is drawn once a flight, per axis."""

    rate_hz: PositiveFloat = Field(
        default=PIXHAWK.rate_hz or 200.0, description="samples a second that leave the part [Hz]"
    )
    raw_hz: PositiveFloat | None = Field(
        default=None,
        description="rate of its samples; null: rate_hz, what is beyond half of it folds back [Hz]",
    )
    gyro_density: NonNegativeFloat = Field(
        default=PIXHAWK.gyro_density,
        description="density of the gyro's white noise [rad/s/sqrt(Hz)]",
    )
    accel_density: NonNegativeFloat = Field(
        default=PIXHAWK.accel_density,
        description="density of the accelerometer's white noise [m/s^2/sqrt(Hz)]",
    )
    gyro_walk: NonNegativeFloat = Field(
        default=PIXHAWK.gyro_walk, description="random walk of the gyro's bias [rad/s^2/sqrt(Hz)]"
    )
    accel_walk: NonNegativeFloat = Field(
        default=PIXHAWK.accel_walk,
        description="random walk of the accelerometer's bias [m/s^3/sqrt(Hz)]",
    )
    gyro_bias_rad_s: NonNegativeFloat = Field(
        default=0.0, description="sigma of the gyro's first bias [rad/s]"
    )
    accel_bias_m_s2: NonNegativeFloat = Field(
        default=0.0, description="sigma of the accelerometer's first bias [m/s^2]"
    )
    gyro_scale: NonNegativeFloat = Field(
        default=0.0, description="sigma of each gyro axis's scale error"
    )
    accel_scale: NonNegativeFloat = Field(
        default=0.0, description="sigma of each accelerometer axis's scale error"
    )
    misalignment_deg: NonNegativeFloat = Field(
        default=0.0,
        description="sigma of the turn of the gyro's and of the accelerometer's axes [deg]",
    )
    vibration: NonNegativeFloat = Field(
        default=1.0, description="share of the vehicle's vibration that reaches the part"
    )
    low_pass: LowPass | None = Field(
        default=None,
        description="Butterworth filter within the part, unknown to stamps; null: none",
    )
    gyro_max_rad_s: PositiveFloat = Field(
        default=34.9, description="where the gyro saturates [rad/s]"
    )
    accel_max_m_s2: PositiveFloat = Field(
        default=156.9, description="where the accelerometer saturates [m/s^2]"
    )
    gyro_lsb_rad_s: NonNegativeFloat = Field(
        default=0.0, description="the gyro's step of quantisation; 0: none [rad/s]"
    )
    accel_lsb_m_s2: NonNegativeFloat = Field(
        default=0.0, description="the accelerometer's step of quantisation; 0: none [m/s^2]"
    )
    drift_ppm: float = Field(
        default=0.0, ge=-1e5, le=1e5, description="what its clock gains on true time [ppm]"
    )
    stamp_jitter_s: NonNegativeFloat = Field(default=0.0, description="sigma of its stamps [s]")
    drop_share: float = Field(
        default=0.0, ge=0.0, le=0.9, description="share of samples that never come"
    )
    latency_s: Range = Field(
        default=(0.0, 0.0), description="from its stamp to the consumer, least and most [s]"
    )
    stated_factor: PositiveFloat = Field(
        default=1.0, description="what imu.yaml says over the densities above"
    )

    @model_validator(mode="after")
    def _fits(self) -> "ImuModel":
        rate = self.raw_hz or self.rate_hz
        if abs(rate / self.rate_hz - round(rate / self.rate_hz)) > 1e-9:
            raise ValueError(f"raw_hz must be a multiple of rate_hz ({self.rate_hz:g})")
        if self.low_pass is not None and self.low_pass.cutoff_hz >= 0.5 * rate:
            raise ValueError(f"low_pass.cutoff_hz must be below half of raw_hz ({0.5 * rate:g})")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Lay:
    """What the part makes of true axes: it shows gyro @ w, accel @ f; (3, 3), near identity."""

    gyro: Array
    accel: Array


def drawn_lay(model: ImuModel, rng: np.random.Generator) -> Lay:
    """Scale and misalignment of one part; accelerometer and gyro each with their own."""
    angle = np.radians(model.misalignment_deg)
    return Lay(
        *(
            np.diag(1.0 + scale * rng.standard_normal(3)) + angle * geo.hat(rng.standard_normal(3))
            for scale in (model.gyro_scale, model.accel_scale)
        )
    )


def white(
    shape: tuple[int, int], density: float, rate_hz: float, rng: np.random.Generator
) -> Array:
    """White noise of this density [unit/sqrt(Hz)] sampled at rate_hz, band up to half of it."""
    return np.asarray(density * np.sqrt(rate_hz) * rng.standard_normal(shape))


def low_passed(x: Array, low_pass: LowPass, rate_hz: float) -> Array:
    """Samples (n, k) through the filter, causally, as if x[0] had stood before for ever."""
    b, a = butter(low_pass.order, low_pass.cutoff_hz, fs=rate_hz)
    first = lfilter_zi(b, a)[:, None] * x[:1]
    return np.asarray(lfilter(b, a, x, axis=0, zi=first)[0])


def saturated(x: Array, largest: float) -> Array:
    """Values cut at what the part can show."""
    return np.clip(x, -largest, largest)


def quantised(x: Array, lsb: float) -> Array:
    """Values rounded to whole steps; lsb 0: as they are."""
    return lsb * np.rint(x / lsb) if lsb > 0.0 else x


def sampled(
    flight: BodyFlight,
    duration_s: float,
    model: ImuModel,
    clock: Clock,
    rng: np.random.Generator,
    *,
    down_W: Array = DOWN_W,
    shaking: Shaking | None = None,
) -> tuple[ImuTrack, Biases]:
    """The samples of a flight from true time 0 on, and the true biases at each of them.

    clock: whose stamps they bear; arrival is in the same clock.
    """
    rate, ratio = raw_rate(model)
    n = int(duration_s * model.rate_hz) + 1
    t_s = np.arange((n - 1) * ratio + 1) / rate
    lay = drawn_lay(model, rng)
    walk = 1.0 / np.sqrt(rate)
    bias_g = bias_walk(len(t_s), model.gyro_bias_rad_s, model.gyro_walk * walk, rng)
    bias_a = bias_walk(len(t_s), model.accel_bias_m_s2, model.accel_walk * walk, rng)
    gyro, accel = inertial(flight(t_s), down_W)
    if shaking is not None:
        hum_gyro, hum_accel = shaking(t_s)
        gyro, accel = gyro + model.vibration * hum_gyro, accel + model.vibration * hum_accel
    gyro = gyro @ lay.gyro.T + bias_g + white(gyro.shape, model.gyro_density, rate, rng)
    accel = accel @ lay.accel.T + bias_a + white(accel.shape, model.accel_density, rate, rng)
    gyro, accel = saturated(gyro, model.gyro_max_rad_s), saturated(accel, model.accel_max_m_s2)
    if model.low_pass is not None:
        gyro = low_passed(gyro, model.low_pass, rate)
        accel = low_passed(accel, model.low_pass, rate)
    rows = slice(None, None, ratio)
    gyro, accel = (
        quantised(gyro[rows], model.gyro_lsb_rad_s),
        quantised(accel[rows], model.accel_lsb_m_s2),
    )
    t_ns = clock.shows(t_s[rows])
    known = t_ns + np.rint(delays(n, model.latency_s, 0.0, 0.0, rng) * 1e9).astype(np.int64)
    stamps = jittered(t_ns, model.stamp_jitter_s, rng)
    there = kept(n, model.drop_share, rng)
    track = ImuTrack(stamps[there], gyro[there], accel[there], known[there])
    return track, Biases(bias_g[rows][there], bias_a[rows][there])


def raw_rate(model: ImuModel) -> tuple[float, int]:
    """Rate at which the part samples [Hz] and how many such samples make one of the bus."""
    ratio = 1 if model.raw_hz is None else round(model.raw_hz / model.rate_hz)
    return model.rate_hz * ratio, ratio


def stated(model: ImuModel) -> ImuNoise:
    """The densities that the log's imu.yaml gives: the part's own, the steps of its numbers in."""
    factor = model.stated_factor

    def effective(density: float, lsb: float, least: float) -> float:
        return float(max(factor * np.hypot(density, lsb / np.sqrt(12.0 * model.rate_hz)), least))

    return ImuNoise(
        effective(model.accel_density, model.accel_lsb_m_s2, _LEAST.accel_density),
        factor * model.accel_walk,
        effective(model.gyro_density, model.gyro_lsb_rad_s, _LEAST.gyro_density),
        factor * model.gyro_walk,
        model.rate_hz,
    )
