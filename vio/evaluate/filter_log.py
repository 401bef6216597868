"""Writes down, frame by frame, what the filter believes of itself and of its rig."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray
from vio.filter import state as at

if TYPE_CHECKING:
    from vio.filter.eskf import ErrorStateFilter


@dataclass(frozen=True, slots=True, eq=False)
class FilterLog:
    """n frames: t_ns (n,) camera clock; each belief with its sigma, (n, k) and (n, k).

    gyro_bias [rad/s], accel_bias [m/s^2]: in I; camera_rotation [rad]: right rotation of R_IC away
    from the file's; time_offset [s]; nis (n,): of the newest measurement, per degree of freedom;
    resets (n,): how often the filter had begun anew.
    """

    t_ns: IntArray
    gyro_bias: tuple[Array, Array]
    accel_bias: tuple[Array, Array]
    camera_rotation: tuple[Array, Array]
    time_offset: tuple[Array, Array]
    nis: Array
    resets: IntArray

    def __len__(self) -> int:
        return len(self.t_ns)


class FilterLogRecorder:
    """Owns the rows; `record` asks the filter after a frame."""

    def __init__(self, estimator: "ErrorStateFilter", R_IC: Array) -> None:
        """R_IC (3, 3): the camera in the IMU as the calibration file has it."""
        self._estimator, self._q_CI = estimator, geo.quat_from_matrix(R_IC.T)
        self._rows: list[tuple[int, Array, Array, float, int]] = []

    def record(self, t_ns: int) -> None:
        """A frame has been taken."""
        x, P = self._estimator.state(), self._estimator.covariance()
        if x is not None and P is not None:
            sigma = np.sqrt(np.maximum(np.diag(P), 0.0))
            resets = self._estimator.health().resets
            self._rows.append((t_ns, x, sigma, self._estimator.nis, resets))

    def log(self) -> FilterLog | None:
        """All rows; None where the filter never started."""
        if not self._rows:
            return None
        times, states, sigmas, nis, resets = zip(*self._rows, strict=True)
        x, s = np.stack(states), np.stack([row[: at.BASE] for row in sigmas])
        q_IC = x[:, at.X_QIC : at.X_QIC + 4]
        turned = geo.log_quat(geo.multiply_quat(np.broadcast_to(self._q_CI, q_IC.shape), q_IC))
        return FilterLog(
            np.array(times, dtype=np.int64),
            (x[:, at.X_BG : at.X_BG + 3], s[:, at.BG : at.BG + 3]),
            (x[:, at.X_BA : at.X_BA + 3], s[:, at.BA : at.BA + 3]),
            (turned, s[:, at.EX : at.EX + 3]),
            (x[:, [at.X_TD]], s[:, [at.TD]]),
            np.array(nis),
            np.array(resets, dtype=np.int64),
        )
