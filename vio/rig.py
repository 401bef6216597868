"""Whether the camera is where its calibration says: believed until the flight contradicts it.

The extrinsic rotation starts with a wide prior. Once the filter has seen enough to tell, the
calibration file is either confirmed, and then holds as tightly as calibrations do, or it is not,
and the rotation stays free. A confirmation that later data contradict is withdrawn. (Left free
for ever, errors of the camera and the IMU that are no noise pull a good calibration away.)
"""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio import layout as at
from vio.settings import RigConfig

_CONTRADICTION = 25.0  # chi-square of 3 dof: 1.5e-5


class RigJudge:
    """Remembers whether the calibration is believed; one per start of the filter."""

    def __init__(self, config: RigConfig, wide_deg: float, R_IC: Array) -> None:
        self._q_IC = geo.quat_from_matrix(R_IC)
        self._R_IC = R_IC
        self._wide = float(np.radians(wide_deg)) ** 2
        self._tight = float(np.radians(config.confirmed_deg)) ** 2
        self._enough = float(np.radians(config.confirm_below_deg)) ** 2
        self.confirmed = False

    def row(self, x: Array, P: Array) -> Array | None:
        """A measurement for the window where the verdict changes, else None."""
        e = geo.log(self._R_IC.T @ geo.matrix_from_quat(x[at.X_QIC : at.X_QIC + 4]))
        C = P[at.EX : at.EX + 3, at.EX : at.EX + 3]
        if self.confirmed:
            doubt = self._tight * np.eye(3) - C  # covariance of what the data have moved
            moved = float(e @ np.linalg.solve(doubt + 1e-3 * self._tight * np.eye(3), e))
            if 0.0 <= moved <= _CONTRADICTION:
                return None
            self.confirmed = False
            return np.array([at.M_OPEN, 1.0, self._wide])
        if self._wide <= self._tight or float(np.linalg.eigvalsh(C)[-1]) > self._enough:
            return None
        if _evidence(e, C, self._tight) < _evidence(e, C, self._wide):
            return None
        self.confirmed = True
        return np.concatenate([[at.M_RIG, 1.0], self._q_IC, [self._tight]])


def _evidence(e: Array, C: Array, variance: float) -> float:
    """Log likelihood, but for a constant, of an estimate e with covariance C about zero."""
    S = C + variance * np.eye(3)
    return float(-0.5 * (e @ np.linalg.solve(S, e) + np.linalg.slogdet(S)[1]))
