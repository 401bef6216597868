"""What a vehicle is to a simulation: where its camera sits, how it shakes, how its rotors hum."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, NonNegativeFloat, PositiveFloat

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.sim.model import Model

_DOWN = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # R_CI, looking down


def _band(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] >= value[1]:
        raise ValueError("the lower end of a band must be below its upper end")
    return value


Numbers3 = tuple[float, float, float]
Band = Annotated[tuple[PositiveFloat, PositiveFloat], AfterValidator(_band)]


class Shake(Model):
    """How far a hovering vehicle strays from its command, rms per axis, and in which band."""

    position_m: NonNegativeFloat = 0.0
    position_hz: Band = (0.1, 0.8)
    attitude_deg: NonNegativeFloat = 0.0
    attitude_hz: Band = (1.0, 8.0)


class Harmonic(Model):
    """Vibration at `order` times the rotors' turns: amplitudes of the sum over all rotors."""

    order: PositiveFloat
    accel_m_s2: NonNegativeFloat
    gyro_rad_s: NonNegativeFloat


class Rotors(Model):
    """Turns per second in hover, the spread between rotors and the slow wander of each (shares)."""

    count: int = Field(default=4, ge=1, le=16)
    hz: PositiveFloat = 100.0
    spread: NonNegativeFloat = Field(default=0.02, le=0.5)
    wander: NonNegativeFloat = Field(default=0.01, le=0.5)
    harmonics: tuple[Harmonic, ...] = ()


class Vehicle(Model):
    """One vehicle; lengths in I (x forward, y left, z up), the camera looking down."""

    name: str
    camera_p_I: Numbers3
    camera_rpy_deg: Numbers3 = (0.0, 0.0, 0.0)
    size_m: PositiveFloat = 0.3
    clearance_m: PositiveFloat = 0.12
    drag_per_s: NonNegativeFloat = 0.0
    max_tilt_deg: float = Field(default=60.0, gt=0.0, lt=90.0)
    shake: Shake = Shake()
    rotors: Rotors = Rotors()


def mount(vehicle: Vehicle) -> tuple[Array, Array]:
    """Pose of I in the camera: R_CI (3, 3), p_CI (3,); rpy turns the camera within the vehicle.

    Without rpy it looks along -z of I, the top of its image forward.
    """
    turn = geo.matrix_from_rpy(*np.radians(vehicle.camera_rpy_deg))
    R_CI = _DOWN @ turn.T
    return R_CI, -R_CI @ np.array(vehicle.camera_p_I)


@dataclass(frozen=True, slots=True, eq=False)
class Vibration:
    """Waves of m rotor harmonics: turns per second hz (m,), wander (m,), its rate (m,) [rad/s] and
    phase (m,); accel (m, 3) [m/s^2], gyro (m, 3) [rad/s] amplitudes; phase (m, 2) of both [rad].
    """

    hz: Array
    wander: Array
    wander_rate: Array
    wander_phase: Array
    accel: Array
    gyro: Array
    phase: Array


def vibration(rotors: Rotors, rng: np.random.Generator) -> Vibration:
    """The waves of these rotors: each a little faster or slower than the others, directions random.

    Amplitudes are shared so that the rotors' sum has the harmonic's: powers add.
    """
    orders = np.array([h.order for h in rotors.harmonics])
    spread = 1.0 + rotors.spread * rng.uniform(-1.0, 1.0, size=rotors.count)
    shape = (rotors.count, len(orders))
    size = np.array([[h.accel_m_s2, h.gyro_rad_s] for h in rotors.harmonics]).reshape(-1, 2)
    size = np.broadcast_to(size / np.sqrt(rotors.count), (*shape, 2)).reshape(-1, 2)
    wander_rate = rng.uniform(0.5, 2.0, size=rotors.count)  # thrust is trimmed once or so a second
    wander_phase = rng.uniform(0.0, 2.0 * np.pi, size=rotors.count)
    count = shape[0] * shape[1]
    return Vibration(
        (rotors.hz * spread[:, None] * orders).ravel(),
        np.full(count, rotors.wander),
        np.repeat(wander_rate, shape[1]),
        np.repeat(wander_phase, shape[1]),
        size[:, :1] * _directions(count, rng),
        size[:, 1:] * _directions(count, rng),
        rng.uniform(0.0, 2.0 * np.pi, size=(count, 2)),
    )


def hum(waves: Vibration, t_s: Array) -> tuple[Array, Array, Array]:
    """Vibration at times (n,): gyro (n, 3) [rad/s], accel (n, 3) [m/s^2], turn (n, 3) [rad].

    turn is what the gyro's part adds up to, the shaking of all that is bolted to the vehicle.
    """
    # integral of hz (1 + wander sin(wander_rate t + wander_phase))
    swing = np.cos(np.outer(t_s, waves.wander_rate) + waves.wander_phase)
    t = t_s[:, None] - waves.wander / waves.wander_rate * swing
    angle = 2.0 * np.pi * waves.hz * t
    gyro = np.sin(angle + waves.phase[:, 0]) @ waves.gyro
    accel = np.sin(angle + waves.phase[:, 1]) @ waves.accel
    turn = np.cos(angle + waves.phase[:, 0]) @ (waves.gyro / (-2.0 * np.pi * waves.hz[:, None]))
    return gyro, accel, turn


def _directions(count: int, rng: np.random.Generator) -> Array:
    v = rng.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
