"""Made-up flights for the tests of the judges: a smooth truth and estimates with known errors."""

from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray
from vio.evaluate.records import Trajectory

MS = 1_000_000
T0 = 1_700_000_000_000_000_000  # a stamp that floats cannot hold to the nanosecond


@dataclass(frozen=True)
class Truth:
    t_ns: IntArray
    p_WI: Array
    q_WI: Array
    v_WI: Array | None = None


def stamps(n: int, step_ms: float = 50.0, start_ms: float = 0.0) -> IntArray:
    return T0 + np.round((start_ms + step_ms * np.arange(n)) * MS).astype(np.int64)


def pose_at(t_ns: IntArray) -> tuple[Array, Array, Array]:
    """Position, rotation and velocity of a smooth made-up flight."""
    t = (np.asarray(t_ns) - T0) * 1e-9
    p = np.stack([np.sin(t), 2.0 * np.cos(0.5 * t), 1.0 + 0.3 * t], axis=-1)
    v = np.stack([np.cos(t), -np.sin(0.5 * t), np.full_like(t, 0.3)], axis=-1)
    R = geo.exp(np.stack([0.2 * np.sin(t), 0.3 * np.cos(t), 0.7 * t], axis=-1))
    return p, R, v


def make_truth(n: int = 200, step_ms: float = 50.0, *, velocity: bool = False) -> Truth:
    t_ns = stamps(n, step_ms)
    p, R, v = pose_at(t_ns)
    return Truth(t_ns, p, geo.quat_from_matrix(R), v if velocity else None)


def estimate(
    t_ns: IntArray,
    rng: np.random.Generator,
    *,
    name: str = "vo",
    sigma: float = 0.01,
    latency_ms: float = 0.0,
    full: bool = False,
) -> Trajectory:
    """Poses of the flight at t_ns with noise of sigma [m, rad]; full: velocity and covariance."""
    n = len(t_ns)
    p, R, v = pose_at(t_ns)
    e = rng.normal(size=(n, 6)) * sigma
    return Trajectory(
        name,
        t_ns,
        t_ns + int(latency_ms * MS),
        p + e[:, :3],
        R @ geo.exp(e[:, 3:]),
        v + rng.normal(size=(n, 3)) * sigma if full else None,
        np.tile(np.eye(6) * sigma**2, (n, 1, 1)) if full else None,
    )


def empty(name: str = "vio") -> Trajectory:
    none = np.empty(0, dtype=np.int64)
    return Trajectory(name, none, none, np.empty((0, 3)), np.empty((0, 3, 3)))
