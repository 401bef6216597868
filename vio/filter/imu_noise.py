"""An IMU's noise as its samples show it, whatever its file states.

Second differences hold no slow motion, and of white noise six times its variance. Taken of single
samples and of means over four, white noise gives the same density; motion shows more in the means,
vibration more in the samples. So the smaller of the two is the density of what is white.
"""

import math

import numpy as np

from tagvo.geometry import Array
from tagvo.kernels.jit import njit

_BLOCK = 4  # samples in a mean: what is above a quarter of the rate averages out
_TRUST = 2.0  # times the stated variance, from which it counts: chance gives 1.3 (1 sigma, 1 s)
_SCATTER_S = 0.5  # over which the samples' scatter is judged
_BLOCK_S = 1.0  # over which that of the means is
_LONG_S, _KNOWN_S = 20.0, 5.0  # over which the density is told, and from when on


_SAY = 3.0  # times the stated density, from which a person is told


def noise_words(measured: Array, stated: Array) -> str | None:
    """The measured densities and what to write where they are far above the stated ones; or None.

    Both (6,), gyro first [rad/s/sqrt(Hz), m/s^2/sqrt(Hz)]; of three axes the worst counts.
    """
    now, file = (np.asarray(x).reshape(2, 3).max(axis=1) for x in (measured, stated))
    if not (now > _SAY * file).any():
        return None
    gyro, accel = np.maximum(now, file)
    return (
        f"the IMU is noisier than stated: gyro {now[0]:.2g} rad/s/sqrt(Hz) ({file[0]:.2g} stated),"
        f" accelerometer {now[1]:.2g} m/s^2/sqrt(Hz) ({file[1]:.2g} stated); put into imu.yaml"
        f" (daemon.imu_noise): gyroscope_noise_density: {gyro:.1e},"
        f" accelerometer_noise_density: {accel:.1e}"
    )


# rows of the meter's table, (ROWS, 6), gyro first
LAST, MEAN = 0, 3  # the last three samples, and means over a block: newest third
SUM, SCATTER, BLOCK, LONG, LARGEST = 6, 7, 8, 9, 10
STATED2, SHARE, SCALE, CLOCK = 11, 12, 13, 14
ROWS = 15
SAMPLES, MEANS, SUMMED, LONG_S = 0, 1, 2, 3  # columns of row CLOCK


@njit
def follow(m: Array, six: Array, dt: float) -> None:
    """Take a sample six (6,), dt [s] after the one before, into a meter's table m (ROWS, 6)."""
    clock = m[CLOCK]
    clock[SAMPLES] = min(clock[SAMPLES] + 1.0, 3.0)
    clock[SUMMED] += 1.0
    whole = clock[SUMMED] >= _BLOCK
    if whole:
        clock[MEANS] = min(clock[MEANS] + 1.0, 3.0)
        clock[SUMMED] = 0.0
    known = whole and clock[MEANS] >= 3.0
    if known:
        clock[LONG_S] += _BLOCK * dt
    for i in range(6):
        m[LAST, i], m[LAST + 1, i], m[LAST + 2, i] = m[LAST + 1, i], m[LAST + 2, i], six[i]
        if clock[SAMPLES] >= 3.0:
            second = m[LAST, i] - 2.0 * m[LAST + 1, i] + m[LAST + 2, i]
            m[SCATTER, i] += min(dt / _SCATTER_S, 1.0) * (second * second / 6.0 - m[SCATTER, i])
        m[SUM, i] += six[i]
        if whole:
            m[MEAN, i], m[MEAN + 1, i] = m[MEAN + 1, i], m[MEAN + 2, i]
            m[MEAN + 2, i] = m[SUM, i] / _BLOCK
            m[SUM, i] = 0.0
        if known:
            second = m[MEAN, i] - 2.0 * m[MEAN + 1, i] + m[MEAN + 2, i]
            gain = min(_BLOCK * dt / _BLOCK_S, 1.0)
            m[BLOCK, i] += gain * (second * second / 6.0 - m[BLOCK, i])
        white = dt * min(m[SCATTER, i], _BLOCK * m[BLOCK, i])
        if known:
            m[LONG, i] += _BLOCK * dt / min(clock[LONG_S], _LONG_S) * (white - m[LONG, i])
            if clock[LONG_S] > _KNOWN_S:
                m[LARGEST, i] = max(m[LARGEST, i], math.sqrt(m[LONG, i]))
        # rectified or folded down by the sampling, a part of any scatter stays in the integral
        shaken = 1.0 + m[SHARE, i] * m[SCATTER, i] * dt / m[STATED2, i]
        more = white / m[STATED2, i]
        m[SCALE, i] = max(shaken, more) if more > _TRUST else shaken


class NoiseMeter:
    """Follows six axes, gyro first; owns their running second differences."""

    def __init__(self, stated: Array, vibration: float, period_s: float) -> None:
        """stated (6,): the file's densities [rad/s/sqrt(Hz), m/s^2/sqrt(Hz)]; period_s: usual step.

        vibration: share of the accelerometer's scatter that stays in what it integrates to.
        """
        self.stated = stated
        self._m = np.zeros((ROWS, 6))
        self._m[STATED2] = np.square(stated)
        self._m[SHARE] = np.repeat([0.0, vibration**2], 3)
        self._m[SCALE] = 1.0
        self._period_s = period_s

    @property
    def largest(self) -> Array:
        """The largest densities of what is white so far, each over 20 s; (6,), 0: not known yet."""
        return np.asarray(self._m[LARGEST].copy())

    def reset(self) -> None:
        """The samples do not follow the ones before: differences begin anew."""
        self._m[CLOCK, :LONG_S] = 0.0
        self._m[SUM] = 0.0

    def scale(self, six: Array, dt: float) -> Array:
        """What multiplies the stated squared densities from now on; (6,), from sample six (6,)."""
        follow(self._m, six, min(dt, self._period_s))
        return np.asarray(self._m[SCALE].copy())
