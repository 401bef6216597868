"""The camera as a stream: when it exposes, what its stamps say, when a frame is known at last."""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array, BoolArray, IntArray
from vio.sim.model import Model, Range
from vio.sim.sensors.clocks import Clock, delays, jittered, kept


class CameraStream(Model):
    """What happens between the shutter and the consumer."""

    rate_hz: PositiveFloat = Field(default=30.0, description="frames a second [Hz]")
    start_s: NonNegativeFloat = Field(
        default=0.1, description="first exposure after the IMU's first sample [s]"
    )
    timeshift_s: FiniteFloat = Field(
        default=0.0, description="t_imu = t_cam + this, when the flight begins [s]"
    )
    drift_ppm: float = Field(
        default=0.0, ge=-1e5, le=1e5, description="what the camera's clock gains on true time [ppm]"
    )
    stamp_jitter_s: NonNegativeFloat = Field(default=0.0, description="sigma of its stamps [s]")
    latency_s: Range = Field(
        default=(0.0, 0.0), description="from exposure to a consumer, least and most [s]"
    )
    slow_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of frames that take longer"
    )
    slow_s: NonNegativeFloat = Field(default=0.0, description="by how much longer at most [s]")
    in_order: bool = Field(
        default=True, description="a frame waits for the one before; false: it may be overtaken"
    )
    drop_share: float = Field(
        default=0.0, ge=0.0, le=0.99, description="share of frames lost one by one"
    )
    dropouts: int = Field(default=0, ge=0, le=1000, description="how many times without frames")
    dropout_s: Range = Field(
        default=(0.5, 3.0), description="how long such a time is, least and most [s]"
    )
    dropouts_after_s: NonNegativeFloat = Field(
        default=5.0, description="none in the first seconds [s]"
    )
    stalls: int = Field(
        default=0, ge=0, le=1000, description="how many times whose frames all arrive at their end"
    )
    stall_s: PositiveFloat = Field(default=0.5, description="how long such a time is at most [s]")


class CalibrationError(Model):
    """How far the log's camchain is from the truth."""

    rotation_deg: NonNegativeFloat = Field(
        default=0.0, description="turn of the camera in I, about a drawn axis [deg]"
    )
    position_m: NonNegativeFloat = Field(
        default=0.0, description="error of the camera's place in I, in a drawn direction [m]"
    )
    focal_rel: NonNegativeFloat = Field(
        default=0.0, description="sigma of the focal length's error, a share"
    )
    principal_px: NonNegativeFloat = Field(
        default=0.0, description="sigma of the principal point's error per axis [px]"
    )
    timeshift_s: FiniteFloat = Field(default=0.0, description="time shift, true minus said [s]")


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """Frames that will be delivered (n,): true middle of exposure t_s [s], its stamp t_ns in the
    camera's clock, and arrival_ns in the IMU's."""

    t_s: Array
    t_ns: IntArray
    arrival_ns: IntArray

    def __len__(self) -> int:
        return len(self.t_s)


def exposures(
    stream: CameraStream,
    span_s: tuple[float, float],
    imu_clock: Clock,
    rng: np.random.Generator,
) -> Exposures:
    """The frames of a stream between two true times [s], in order of exposure."""
    start, end = span_s
    t_s = np.arange(start + stream.start_s, end, 1.0 / stream.rate_hz)
    n = len(t_s)
    clock = Clock(imu_clock.zero_ns - round(stream.timeshift_s * 1e9), stream.drift_ppm * 1e-6)
    t_ns = jittered(clock.shows(t_s), stream.stamp_jitter_s, rng)
    known_s = t_s + delays(n, stream.latency_s, stream.slow_share, stream.slow_s, rng)
    there = kept(n, stream.drop_share, rng)
    there &= visible(
        t_s - start, end - start, stream.dropouts, rng,
        length_s=stream.dropout_s, after_s=stream.dropouts_after_s,
    )  # fmt: skip
    for _ in range(stream.stalls):
        begin = rng.uniform(start, end)
        freed = begin + rng.uniform(0.0, 1.0) * stream.stall_s
        known_s = np.where((known_s >= begin) & (known_s < freed), freed, known_s)
    known_s = known_s[there]
    if stream.in_order and len(known_s):
        known_s = np.maximum.accumulate(known_s)
    return Exposures(t_s[there], t_ns[there], imu_clock.shows(known_s))


def said_camera(
    true: Camera, stream: CameraStream, error: CalibrationError, rng: np.random.Generator
) -> Camera:
    """The camera as its calibration file has it, wrong by the errors drawn."""
    said = wrong_rig(true, error.rotation_deg, error.position_m, rng)
    focal = 1.0 + error.focal_rel * rng.standard_normal()
    principal = error.principal_px * rng.standard_normal(2)
    intrinsics = np.concatenate([true.intrinsics[:2] * focal, true.intrinsics[2:] + principal])
    shift = stream.timeshift_s - error.timeshift_s
    return replace(said, intrinsics=intrinsics, timeshift_s=shift)


def wrong_rig(camera: Camera, deg: float, metres: float, rng: np.random.Generator) -> Camera:
    """The camera's calibration file with an extrinsic rotation and lever arm this far off."""
    turn = geo.exp(np.radians(deg) * _unit(rng))
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
    R_CI, p_CI = geo.invert(R_IC @ turn, p_IC + metres * _unit(rng))
    return Camera(
        camera.model, camera.intrinsics, camera.coeffs, camera.resolution, R_CI, p_CI,
        camera.timeshift_s, camera.source,
    )  # fmt: skip


def _unit(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def visible(
    t: Array,
    duration_s: float,
    dropouts: int,
    rng: np.random.Generator,
    *,
    length_s: tuple[float, float] = (0.5, 3.0),
    after_s: float = 5.0,
) -> BoolArray:
    """False inside dropouts that last length_s [s], none of which begins in the first after_s."""
    seen = np.ones(len(t), dtype=bool)
    for _ in range(dropouts):
        start = rng.uniform(after_s, max(duration_s - length_s[1], after_s + 0.1))
        seen &= ~((t >= start) & (t < start + rng.uniform(*length_s)))
    return seen
