"""The camera as a stream: when it exposes, what its stamps say, when a frame is known at last."""

from dataclasses import dataclass, replace

import numpy as np
from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat

from tagvo.camera.model import Camera
from tagvo.geometry import Array, IntArray
from vio.sim.model import Model, Range
from vio.sim.sensors.clocks import Clock, delays, jittered, kept
from vio.sim.sensors.pose_noise import visible, wrong_rig


class CameraStream(Model):
    """What happens between the shutter and the consumer.

    timeshift_s: t_imu = t_cam + this when the flight begins; drift_ppm: of the camera's clock
    against true time; latency_s: range from exposure to arrival, a slow_share of frames up to
    slow_s more; in_order: a frame waits for the one before; drop_share: frames lost one by one;
    dropouts: times without frames, of dropout_s each, none in the first dropouts_after_s; stalls:
    times of up to stall_s whose frames all arrive at their end.
    """

    rate_hz: PositiveFloat = 30.0
    start_s: NonNegativeFloat = 0.1
    timeshift_s: FiniteFloat = 0.0
    drift_ppm: float = Field(default=0.0, ge=-1e5, le=1e5)
    stamp_jitter_s: NonNegativeFloat = 0.0
    latency_s: Range = (0.0, 0.0)
    slow_share: float = Field(default=0.0, ge=0.0, le=1.0)
    slow_s: NonNegativeFloat = 0.0
    in_order: bool = True
    drop_share: float = Field(default=0.0, ge=0.0, le=0.99)
    dropouts: int = Field(default=0, ge=0, le=1000)
    dropout_s: Range = (0.5, 3.0)
    dropouts_after_s: NonNegativeFloat = 5.0
    stalls: int = Field(default=0, ge=0, le=1000)
    stall_s: PositiveFloat = 0.5


class CalibrationError(Model):
    """How far the log's camchain is from the truth.

    rotation_deg, position_m: the camera's pose in I, by just this much in a drawn direction;
    focal_rel, principal_px: sigmas of what is drawn; timeshift_s: true minus said.
    """

    rotation_deg: NonNegativeFloat = 0.0
    position_m: NonNegativeFloat = 0.0
    focal_rel: NonNegativeFloat = 0.0
    principal_px: NonNegativeFloat = 0.0
    timeshift_s: FiniteFloat = 0.0


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
