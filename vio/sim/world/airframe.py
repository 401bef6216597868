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

    position_m: NonNegativeFloat = Field(default=0.0, description="rms of position per axis [m]")
    position_hz: Band = Field(default=(0.1, 0.8), description="band of it, from and to [Hz]")
    attitude_deg: NonNegativeFloat = Field(
        default=0.0, description="rms of attitude per axis [deg]"
    )
    attitude_hz: Band = Field(default=(1.0, 8.0), description="band of it, from and to [Hz]")


class Harmonic(Model):
    """Vibration at `order` times the rotors' turns: amplitudes of the sum over all rotors."""

    order: PositiveFloat = Field(description="multiple of the rotors' turns")
    accel_m_s2: NonNegativeFloat = Field(description="amplitude of the acceleration [m/s^2]")
    gyro_rad_s: NonNegativeFloat = Field(description="amplitude of the rate [rad/s]")


class Rotors(Model):
    """Turns per second in hover, the spread between rotors and the slow wander of each (shares)."""

    count: int = Field(default=4, ge=1, le=16, description="number of rotors")
    hz: PositiveFloat = Field(default=100.0, description="turns a second in hover [Hz]")
    spread: NonNegativeFloat = Field(
        default=0.02,
        le=0.5,
        description="share by which a rotor is faster or slower than that at most",
    )
    wander: NonNegativeFloat = Field(
        default=0.01, le=0.5, description="share by which each swings once or so a second"
    )
    harmonics: tuple[Harmonic, ...] = Field(
        default=(), description="waves at multiples of the turns; amplitudes of all rotors together"
    )


class Vehicle(Model):
    """One vehicle; lengths in I (x forward, y left, z up), the camera looking down."""

    name: str = Field(description="what it is called")
    camera_p_I: Numbers3 = Field(description="place of the camera in I [m]")
    camera_rpy_deg: Numbers3 = Field(
        default=(0.0, 0.0, 0.0),
        description="turn of the camera from straight down, image top ahead [deg]",
    )
    size_m: PositiveFloat = Field(
        default=0.3, description="across, propellers included: the size of its shadow [m]"
    )
    clearance_m: PositiveFloat = Field(
        default=0.12, description="height of I above the ground where it stands [m]"
    )
    drag_per_s: NonNegativeFloat = Field(
        default=0.0, description="rotor drag: deceleration per speed [1/s]"
    )
    max_tilt_deg: float = Field(
        default=60.0, gt=0.0, lt=90.0, description="a flight that needs more tilt is refused [deg]"
    )
    shake: Shake = Field(
        default=Shake(), description="how far it strays in flight from its command"
    )
    rotors: Rotors = Field(default=Rotors(), description="what vibrates")


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
