"""An IMU's noise as its samples show it, whatever its file states.

Second differences hold no slow motion, and of white noise six times its variance. Taken of single
samples and of means over four, white noise gives the same density; motion shows more in the means,
vibration more in the samples. So the smaller of the two is the density of what is white.
"""

import numpy as np

from tagvo.geometry import Array

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


class NoiseMeter:
    """Follows six axes, gyro first; owns their running second differences."""

    def __init__(self, stated: Array, vibration: float, period_s: float) -> None:
        """stated (6,): the file's densities [rad/s/sqrt(Hz), m/s^2/sqrt(Hz)]; period_s: usual step.

        vibration: share of the accelerometer's scatter that stays in what it integrates to.
        """
        self.stated, self._stated2 = stated, np.square(stated)
        self._share = np.repeat([0.0, vibration**2], 3)
        self._period_s = period_s
        self._scatter, self._block_scatter = np.zeros(6), np.zeros(6)
        self._long, self._long_s, self.largest = np.zeros(6), 0.0, np.zeros(6)
        self.reset()

    def reset(self) -> None:
        """The samples do not follow the ones before: differences begin anew."""
        self._last: list[Array] = []
        self._means: list[Array] = []
        self._sum, self._count = np.zeros(6), 0

    def scale(self, six: Array, dt: float) -> Array:
        """What multiplies the stated squared densities from now on; (6,), from sample six (6,)."""
        dt = min(dt, self._period_s)
        self._last = [*self._last[-2:], six]
        if len(self._last) == 3:
            second = self._last[0] - 2.0 * self._last[1] + self._last[2]
            self._scatter += min(dt / _SCATTER_S, 1.0) * (second**2 / 6.0 - self._scatter)
        self._sum, self._count = self._sum + six, self._count + 1
        if self._count == _BLOCK:
            self._add_block(_BLOCK * dt)
        # rectified or folded down by the sampling, a part of any scatter stays in the integral
        shaken = 1.0 + self._share * self._scatter * dt / self._stated2
        white = self._white(dt) / self._stated2
        return np.asarray(np.maximum(shaken, np.where(white > _TRUST, white, 1.0)))

    def _white(self, dt: float) -> Array:
        """Squared densities (6,) of what is white."""
        return np.asarray(np.minimum(self._scatter * dt, self._block_scatter * _BLOCK * dt))

    def _add_block(self, span_s: float) -> None:
        self._means = [*self._means[-2:], self._sum / _BLOCK]
        self._sum, self._count = np.zeros(6), 0
        if len(self._means) < 3:
            return
        second = self._means[0] - 2.0 * self._means[1] + self._means[2]
        self._block_scatter += min(span_s / _BLOCK_S, 1.0) * (second**2 / 6.0 - self._block_scatter)
        self._long_s += span_s
        share = span_s / min(self._long_s, _LONG_S)
        self._long += share * (self._white(span_s / _BLOCK) - self._long)
        if self._long_s > _KNOWN_S:
            self.largest = np.maximum(self.largest, np.sqrt(self._long))
