"""The flight of the demo: over the arena's floor, its tags laid by hand, seen by a real lens."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array, IntArray
from tagvo.records import Frame
from tagvo.render.view import Image, Look, displaced, render_view
from tagvo.tags.tag_map import TagMap
from vio.records import ImuNoise, ImuSample

if TYPE_CHECKING:
    from vio.sim.world.trajectory import Flight, Motion

SEED = 12
LATENCY_S = 0.06  # from the middle of an exposure to a pose on a companion computer
_T0_NS = 1_700_000_000_000_000_000
_FRAME_HZ, _TRUTH_HZ = 15, 100
_QUICK_S = (5.0, 9.0)
_REST_S = 2.0  # on the ground before take-off, the camera running
_IMU_BEFORE_S = 1.0  # the IMU runs this long before the camera
_IMU_STREAM = (SEED, 0, 1)  # of random numbers; (SEED, k) is that of image k
_EXPOSURE_S, _SUB_EXPOSURES = 4e-3, 3
_COEFFS = np.array([-0.18, 0.05, 0.001, -0.0005])  # a common wide lens
_GREY_NOISE = 2.5
_LOOK = Look(texture=12.0)
_WAYPOINTS = np.array(  # t [s], x, y, z [m], yaw [deg]: take-off, a square, four heights, descent
    [
        [0.0, 0.50, 2.00, 0.30, 0.0],
        [2.0, 0.50, 2.00, 0.70, 0.0],
        [5.0, 1.90, 2.00, 1.00, 25.0],
        [8.0, 1.90, 3.40, 1.80, 50.0],
        [11.0, 0.50, 3.40, 1.30, 30.0],
        [14.0, 0.50, 2.00, 0.70, 0.0],
    ]
)


def demo_flight() -> "Flight":
    """The spline of fifth degree through the waypoints, at rest at both ends and beyond them."""
    from scipy.interpolate import make_interp_spline

    from vio.sim.world.trajectory import along

    rest = [(1, np.zeros(4)), (2, np.zeros(4))]
    ends: Any = (rest, rest)
    t, values = _WAYPOINTS[:, 0], _WAYPOINTS[:, 1:] * [1.0, 1.0, 1.0, np.pi / 180.0]
    moves = along(make_interp_spline(t, values, k=5, bc_type=ends))
    return lambda t_s: replace(moves(np.clip(t_s, t[0], t[-1])), t_s=t_s)


def camera_poses(motion: "Motion", camera: Camera) -> tuple[Array, Array]:
    """R_WC (n, 3, 3), p_WC (n, 3) [m]."""
    return geo.compose(motion.R_WI, motion.p_WI, *geo.invert(camera.R_CI, camera.p_CI))


def demo_camera(camera: Camera) -> Camera:
    """The camera with the distortion of a real lens."""
    return replace(camera, model="radtan", coeffs=_COEFFS)


def seconds(t_ns: IntArray) -> Array:
    """Time of the flight [s] of stamps."""
    return np.asarray((t_ns - _T0_NS) * 1e-9)


def stamps(quick: bool) -> tuple[IntArray, IntArray]:
    """Stamps of the frames and of the truth; quick: four seconds from the middle alone."""
    start, end = _QUICK_S if quick else (-_REST_S, float(_WAYPOINTS[-1, 0]))

    def at(rate_hz: int) -> IntArray:
        t = start + np.arange(round((end - start) * rate_hz) + 1) / rate_hz
        return _T0_NS + np.rint(t * 1e9).astype(np.int64)

    return at(_FRAME_HZ), at(_TRUTH_HZ)


def imu_samples(
    flight: "Flight", noise: ImuNoise, quick: bool, turn_on: tuple[float, float] = (0.01, 0.1)
) -> Iterator[ImuSample]:
    """The IMU from 1 s before the first frame on; gravity is along -z of the map.

    turn_on: sigmas of its first biases [rad/s, m/s^2].
    """
    from vio.sim.sensors.simple_imu import simulate_imu

    frame_ns, _ = stamps(quick)
    start_s, end_s = seconds(frame_ns[[0, -1]]) - [_IMU_BEFORE_S, 0.0]
    rng = np.random.default_rng(_IMU_STREAM)
    track, _ = simulate_imu(
        lambda t: flight(t + start_s), end_s - start_s, noise, rng, turn_on=turn_on
    )
    offset = _T0_NS + round(start_s * 1e9)
    for i in range(len(track)):
        t_ns = int(track.t_ns[i]) + offset
        yield ImuSample(t_ns, track.gyro_I[i], track.accel_I[i], t_ns)


def frames(
    flight: "Flight", tag_map: TagMap, camera: Camera, t_ns: IntArray, workers: int
) -> Iterator[Frame]:
    """Rendered frames in order; the tags lie as the map's own sigmas allow, once for all."""
    from joblib import Parallel, delayed

    floor = displaced(tag_map, np.random.default_rng(SEED))
    shots = (delayed(_shot)(flight, floor, camera, k, t) for k, t in enumerate(t_ns.tolist()))
    images = Parallel(n_jobs=workers, prefer="threads", return_as="generator")(shots)
    for t, image in zip(t_ns.tolist(), images, strict=True):
        yield Frame(t, image, arrival_ns=t + round(LATENCY_S * 1e9))


def _shot(flight: "Flight", floor: TagMap, camera: Camera, k: int, t_ns: int) -> Image:
    """One exposure along the flight."""
    middle = seconds(np.array(t_ns))
    t = middle + ((np.arange(_SUB_EXPOSURES) + 0.5) / _SUB_EXPOSURES - 0.5) * _EXPOSURE_S
    return render_view(
        floor, camera, *camera_poses(flight(t), camera), look=_LOOK, supersample=3,
        noise_sigma=_GREY_NOISE, rng=np.random.default_rng([SEED, k]),
    )  # fmt: skip
