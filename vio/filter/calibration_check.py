"""Whether the calibration file tells the truth: believed once the flight confirms it.

The extrinsic rotation and the time offset start with wide priors. Once the filter has seen enough
to tell, the file's value is either confirmed, and then holds as tightly as calibrations do, or it
is not, and the state stays free. A confirmation that later data contradict is withdrawn. (Left free
for ever, errors of camera and IMU that are no noise pull a good calibration away.)
"""

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.config.filter import RigConfig, VioConfig
from vio.filter import state as at
from vio.filter.measurements import constraints

_CONVINCED = 2.0  # log odds for the file's value from which it is believed
_CONTRADICTION = (36.0, 25.0)  # chi-square beyond doubt: 1 dof and 3 dof, 1e-5 and less


class CalibrationHypothesis:
    """Bayes factor (Savage-Dickey) for a block of the state being as the file says.

    tight, wide, enough: sigmas of the file if it is true, of the prior, and the largest that the
    filter's own estimate may have to judge by.
    """

    def __init__(self, first: int, count: int, tight: float, wide: float, enough: float) -> None:
        self._block = slice(first, first + count)
        self._tight, self._wide, self._enough = tight**2, wide**2, enough**2
        self._limit = _CONTRADICTION[count > 1]
        self._open = constraints.opened(self._wide, first, count)
        self.confirmed = False

    def decide(self, e: Array, P: Array, file: Array) -> Array | None:
        """The history's row where the verdict changes; e (k,): states less the file's."""
        C, eye = P[self._block, self._block], np.eye(len(e))
        if self.confirmed:
            doubt = 1.001 * self._tight * eye - C  # covariance of what the data have moved
            if not float(e @ np.linalg.solve(doubt, e)) > self._limit:
                return None
            self.confirmed = False
            return self._open
        if self._wide <= self._tight or float(np.linalg.eigvalsh(C)[-1]) > self._enough:
            return None
        if _odds(e, C, self._wide) < _CONVINCED:
            return None
        self.confirmed = True
        return file


class CalibrationCheck:
    """The claims of one camera's calibration, since one start of the filter."""

    def __init__(self, config: VioConfig, R_IC: Array, time_offset_s: float) -> None:
        rig: RigConfig = config.rig
        wide = float(np.radians(config.prior.extrinsic_rotation_deg))
        tight, enough = np.radians(rig.rotation_deg), np.radians(rig.rotation_known_deg)
        self._R_IC, self._td = R_IC, time_offset_s
        self._turned_row = constraints.rotation(geo.quat_from_matrix(R_IC), float(tight))
        self._delayed_row = constraints.clock(time_offset_s, rig.time_offset_s)
        self._turned = CalibrationHypothesis(at.EX, 3, float(tight), wide, float(enough))
        self._delayed = CalibrationHypothesis(
            at.TD, 1, rig.time_offset_s, config.prior.time_offset_s, rig.time_offset_known_s
        )

    def rows(self, x: Array, P: Array) -> list[Array]:
        """Measurements for the history where a verdict changes."""
        R_IC = geo.matrix_from_quat(x[at.X_QIC : at.X_QIC + 4])
        turned = self._turned.decide(geo.log(self._R_IC.T @ R_IC), P, self._turned_row)
        late = np.array([x[at.X_TD] - self._td])
        delayed = self._delayed.decide(late, P, self._delayed_row)
        return [row for row in (turned, delayed) if row is not None]


def _odds(e: Array, C: Array, wide: float) -> float:
    """Log odds that the file is right against a free prior: how the data have changed the density
    at the file's value (Savage and Dickey); e, C: posterior about it, wide: variance of the prior.
    """
    spread = float(np.linalg.slogdet(C)[1])
    return float(0.5 * (len(e) * np.log(wide) - spread - e @ np.linalg.solve(C, e)))
