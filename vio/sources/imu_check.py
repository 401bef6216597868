"""Whether an IMU can be what it claims: wrong units and clocks get a word, not a divergence."""

import numpy as np

from tagvo.geometry import IntArray
from vio.errors import LogError
from vio.records import ImuTrack
from vio.setup_check.findings import Finding

_GRAVITY = 9.81
_TOLERANCE = 0.05
_G_UNITS = (0.5, 2.0)  # median specific force in g [g]
_SPINNING = 8.0  # [rad/s] a median rate that no vehicle flies
_ROWS = 20
_IMU_HZ, _FRAMES_HZ = 33_000.0, 5_000.0  # above any part's rate, far below a thousandfold one


def check_stamps(imu_t_ns: IntArray, frames_t_ns: IntArray, where: str) -> Finding | None:
    """Stamps that cannot be nanoseconds: rates beyond any part, or two files a thousandfold apart.

    imu_t_ns (n,), frames_t_ns (m,); either may be empty.
    """
    for t_ns, what, most in ((imu_t_ns, "IMU", _IMU_HZ), (frames_t_ns, "frames", _FRAMES_HZ)):
        steps = np.diff(np.sort(np.unique(t_ns)))
        if len(steps) < _ROWS:
            continue
        rate = 1e9 / float(np.median(steps))
        if rate > most:
            unit = "microseconds" if rate < 1e3 * most else "milliseconds"
            text = f"{where}: stamps look like {unit} ({what} at {rate:,.0f} Hz)"
            return Finding("stamp_unit", f"{text}: nanoseconds are needed", rate, certain=True)
    if len(imu_t_ns) == 0 or len(frames_t_ns) == 0:
        return None
    ratio = float(np.median(imu_t_ns)) / max(float(np.median(frames_t_ns)), 1.0)
    thousands = np.log10(max(ratio, 1e-30)) / 3.0
    if round(thousands) == 0 or abs(thousands - round(thousands)) > 0.01:
        return None
    text = f"{where}: IMU stamps are {ratio:.3g} times those of the frames: one of the two files"
    return Finding("stamp_unit", f"{text} is not in nanoseconds", ratio, certain=True)


def check_imu(track: ImuTrack, frames_t_ns: IntArray, where: str) -> list[str]:
    """Warnings about a track beside its frames' stamps (in its clock); LogError where it is no use.

    The median of the specific force is close to gravity in any flight; a vehicle does not spin.
    """
    gyro = np.linalg.norm(track.gyro_I, axis=-1)
    accel = np.linalg.norm(track.accel_I, axis=-1)
    known = np.isfinite(gyro) & np.isfinite(accel)
    if int(known.sum()) < _ROWS:
        return [f"{where}: {int(known.sum())} valid IMU rows; the filter needs {_ROWS} and more"]
    rate, force = float(np.median(gyro[known])), float(np.median(accel[known]))
    if abs(rate / _GRAVITY - 1.0) < _TOLERANCE and force < _SPINNING:
        raise LogError(
            f"{where}: the median angular rate is {rate:.3g}, median specific force {force:.3g}:"
            " do the accelerometer's columns stand first? gyro rad/s, then force m/s^2 are needed"
        )
    if rate > _SPINNING:
        raise LogError(
            f"{where}: the median angular rate is {rate:.3g}; rad/s are needed, is this deg/s?"
        )
    if _G_UNITS[0] < force < _G_UNITS[1]:
        raise LogError(
            f"{where}: the median specific force is {force:.3g}; m/s^2 are needed, is this in g?"
        )
    _check_clocks(track.t_ns[known], frames_t_ns, where)
    if force > 1.0 and abs(force / _GRAVITY - 1.0) > _TOLERANCE:  # below: see setup_check
        return [
            f"{where}: the median specific force is {force:.4g} m/s^2, gravity {_GRAVITY}; the"
            " accelerometer's scale is off by more than 5 %, or its unit is not m/s^2"
        ]
    return []


def _check_clocks(imu_t_ns: IntArray, frames_t_ns: IntArray, where: str) -> None:
    if len(frames_t_ns) == 0:
        return
    first, last = int(imu_t_ns.min()), int(imu_t_ns.max())
    if ((frames_t_ns >= first) & (frames_t_ns <= last)).any():
        return
    raise LogError(
        f"{where}: IMU stamps from {first} to {last}, frames from {int(frames_t_ns.min())} to"
        f" {int(frames_t_ns.max())} ns; the clocks must overlap"
    )
