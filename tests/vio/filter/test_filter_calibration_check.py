"""The judge of the calibration: what it believes, what it leaves free, and what it takes back."""

import numpy as np
import pytest

from vio.config.filter import VioConfig
from vio.filter import state as at
from vio.filter.calibration_check import CalibrationCheck
from vio.filter.initialization import prior_covariance
from vio.filter.measurements import kinds


def verdicts(offset_s, sigma_s, turned_rad=0.0, sigma_rad=0.1, check=None):
    """Kinds of the rows asked for by states that stand so far off the file's, so well known."""
    check = check or CalibrationCheck(VioConfig(), np.eye(3), 0.0)
    x, P = np.zeros(at.NOMINAL), prior_covariance(VioConfig(), False, None)
    half = 0.5 * turned_rad
    x[at.X_QIC : at.X_QIC + 4] = [np.cos(half), np.sin(half), 0.0, 0.0]
    x[at.X_TD], P[at.TD, at.TD] = offset_s, sigma_s**2
    P[at.EX : at.EX + 3, at.EX : at.EX + 3] = sigma_rad**2 * np.eye(3)
    return [int(row[0]) for row in check.rows(x, P)]


def test_a_calibration_is_believed_only_on_clear_evidence():
    known = np.radians(0.5)
    assert verdicts(0.001, 0.0025, 0.0, known) == [kinds.ROTATION, kinds.CLOCK]
    assert verdicts(0.001, 0.01, 0.0, np.radians(1.2)) == []  # too early to tell
    assert verdicts(0.0055, 0.0029) == []  # the odds are even: it stays free
    assert verdicts(0.0115, 0.0029, np.radians(2.0), known) == []  # the file is wrong


@pytest.mark.parametrize("late_s", [0.0115, -0.0115, 0.03])
def test_a_late_imu_keeps_its_offset_free(late_s):
    """Estimates of a truly late stream, ever better known: hardly any is taken for the file's."""
    rng, believed = np.random.default_rng(0), 0
    for _ in range(200):
        sigma = 0.003
        believed += kinds.CLOCK in verdicts(rng.normal(late_s, sigma), sigma)
    assert believed <= 6


def test_a_belief_that_the_data_contradict_is_withdrawn():
    check = CalibrationCheck(VioConfig(), np.eye(3), 0.0)
    assert verdicts(0.001, 0.0025, check=check) == [kinds.CLOCK]
    assert verdicts(1e-4, 4.9e-4, check=check) == []
    assert verdicts(2e-3, 4.6e-4, check=check) == [kinds.OPEN]
    assert verdicts(0.0115, 0.0025, check=check) == []
