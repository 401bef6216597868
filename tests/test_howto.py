"""How to add a state: the example's patch applies, touches few files, and the state is there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PATCH = ROOT / "docs/howto/state.patch"
CODE = """
import numpy as np
from vio.config.filter import VioConfig
from vio.filter import state as at
from vio.filter.initialization import prior_covariance
from vio.filter.noise_model import USUAL_NOISE, model_of
from vio.filter.propagation import propagate
from vio.filter.update import downdate

for on in (False, True):
    config = VioConfig(baro=on)
    model = model_of(USUAL_NOISE, config)
    n = model.layout.n
    P, x = prior_covariance(config, False, None), np.zeros(at.NOMINAL)
    assert P.shape == (n, n), (P.shape, n)
    x[[at.X_Q, at.X_QIC, at.X_QWL]] = 1.0
    x[at.X_BARO] = 3.0
    imu = np.concatenate([np.zeros(5), [9.81], np.ones(6)])
    propagate(x, P, imu, 0.005, model.q, model.layout)
    assert x[at.X_BARO] == 3.0
    if on:
        assert P[n - 1, n - 1] == 1.0
        good = downdate(x, P, np.array([[np.sqrt(1.25)]]), P[n - 1 :].copy(), np.array([0.5]),
                        model.layout)
        assert good
        assert abs(x[at.X_BARO] - 3.4) < 1e-12, x[at.X_BARO]
        assert abs(P[n - 1, n - 1] - 0.2) < 1e-12, P[n - 1, n - 1]
    print(n)
"""


def test_the_example_of_a_new_state_works(tmp_path):
    """In a copy, uncompiled: prior, propagation, injection and the switch follow from BLOCKS."""
    touched = re.findall(r"^\+\+\+ b/(.*)$", PATCH.read_text(encoding="utf-8"), re.MULTILINE)
    assert 1 <= len(touched) <= 3
    for package in ("tagvo", "vio"):
        skip = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, tmp_path / package, ignore=skip)
    subprocess.run(["git", "apply", "--unsafe-paths", str(PATCH)], cwd=tmp_path, check=True)
    env = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run(
        [sys.executable, "-c", CODE], cwd=tmp_path, env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    off, on = map(int, done.stdout.split())
    assert on == off + 1
