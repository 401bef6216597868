"""The flight of the demo: over the arena's floor, its tags laid by hand, seen by a real lens."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.camera import Camera
from tagvo.geometry import Array, IntArray
from tagvo.records import Frame
from tagvo.render import Image, Look, displaced, render_view
from tagvo.tagmap import TagMap

SEED = 12
GRAVITY = 9.81
_T0_NS = 1_700_000_000_000_000_000
_FRAME_HZ, _TRUTH_HZ = 15, 100
_QUICK_S = (5.0, 9.0)
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


@dataclass(frozen=True, eq=False)
class Flight:
    """The body of a multirotor along smooth waypoints; every callable takes t (...) [s].

    p (..., 3) [m] of I in W, v (..., 3) [m/s], a (..., 3) [m/s^2], yaw (...) [rad].
    """

    p: Callable[[Array], Array]
    v: Callable[[Array], Array]
    a: Callable[[Array], Array]
    yaw: Callable[[Array], Array]

    def R_WI(self, t: Array) -> Array:
        """Attitude: z along the thrust that the acceleration asks for, x along the yaw."""
        thrust = self.a(t) + np.array([0.0, 0.0, GRAVITY])
        z = thrust / np.linalg.norm(thrust, axis=-1, keepdims=True)
        yaw = self.yaw(t)
        heading = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=-1)
        y = np.cross(z, heading)
        y = y / np.linalg.norm(y, axis=-1, keepdims=True)
        return np.stack([np.cross(y, z), y, z], axis=-1)

    def camera(self, t: Array, camera: Camera) -> tuple[Array, Array]:
        """R_WC (..., 3, 3), p_WC (..., 3) [m]."""
        return geo.compose(self.R_WI(t), self.p(t), *geo.invert(camera.R_CI, camera.p_CI))


def demo_flight() -> Flight:
    """The spline of fifth degree through the waypoints, at rest at both ends."""
    from scipy.interpolate import make_interp_spline

    rest = [(1, np.zeros(4)), (2, np.zeros(4))]
    ends: Any = (rest, rest)
    t, values = _WAYPOINTS[:, 0], _WAYPOINTS[:, 1:] * [1.0, 1.0, 1.0, np.pi / 180.0]
    path = make_interp_spline(t, values, k=5, bc_type=ends)
    v, a = path.derivative(1), path.derivative(2)
    return Flight(
        lambda t: path(t)[..., :3],
        lambda t: v(t)[..., :3],
        lambda t: a(t)[..., :3],
        lambda t: path(t)[..., 3],
    )


def demo_camera(camera: Camera) -> Camera:
    """The camera with the distortion of a real lens."""
    return replace(camera, model="radtan", coeffs=_COEFFS)


def seconds(t_ns: IntArray) -> Array:
    """Time of the flight [s] of stamps."""
    return np.asarray((t_ns - _T0_NS) * 1e-9)


def stamps(quick: bool) -> tuple[IntArray, IntArray]:
    """Stamps of the frames and of the truth; quick: four seconds from the middle alone."""
    start, end = _QUICK_S if quick else (0.0, float(_WAYPOINTS[-1, 0]))

    def at(rate_hz: int) -> IntArray:
        t = start + np.arange(round((end - start) * rate_hz) + 1) / rate_hz
        return _T0_NS + np.rint(t * 1e9).astype(np.int64)

    return at(_FRAME_HZ), at(_TRUTH_HZ)


def frames(
    flight: Flight, tag_map: TagMap, camera: Camera, t_ns: IntArray, workers: int
) -> Iterator[Frame]:
    """Rendered frames in order; the tags lie as the map's own sigmas allow, once for all."""
    from joblib import Parallel, delayed

    floor = displaced(tag_map, np.random.default_rng(SEED))
    shots = (delayed(_shot)(flight, floor, camera, k, t) for k, t in enumerate(t_ns.tolist()))
    images = Parallel(n_jobs=workers, prefer="threads", return_as="generator")(shots)
    for t, image in zip(t_ns.tolist(), images, strict=True):
        yield Frame(t, image)


def _shot(flight: Flight, floor: TagMap, camera: Camera, k: int, t_ns: int) -> Image:
    """One exposure along the flight."""
    middle = seconds(np.array(t_ns))
    t = middle + ((np.arange(_SUB_EXPOSURES) + 0.5) / _SUB_EXPOSURES - 0.5) * _EXPOSURE_S
    return render_view(
        floor, camera, *flight.camera(t, camera), look=_LOOK, supersample=3,
        noise_sigma=_GREY_NOISE, rng=np.random.default_rng([SEED, k]),
    )  # fmt: skip
