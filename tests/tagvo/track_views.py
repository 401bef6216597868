"""Images of the arena and priors about them, for tests of the tracker."""

import numpy as np
from oracles.false_lock_study import lens
from simulated import arena, pose_above

from tagvo import geometry as geo
from tagvo.config import TagvoConfig
from tagvo.records import PosePrior
from tagvo.render.view import Look, render_view

CAMERA, MAP = lens(), arena()
LOW, HIGH = MAP.p_WT[:, :2].min(axis=0) + 0.4, MAP.p_WT[:, :2].max(axis=0) - 0.4
COV = np.diag([0.01**2] * 3 + [np.radians(0.5) ** 2] * 3)
TRACK = TagvoConfig.model_validate({"track": {"mode": "on"}})


def view(seed, height=1.2, **keys):
    rng = np.random.default_rng(seed)
    R_WC, p_WC = pose_above(rng, height, LOW, HIGH)
    image = render_view(
        MAP, CAMERA, R_WC, p_WC, look=Look(texture=12.0), supersample=3, rng=rng,
        **{"noise_sigma": 2.5, **keys},
    )  # fmt: skip
    return image, R_WC, p_WC, rng


def prior_of(R_WC, p_WC, rng=None, cov=COV, t_ns=0):
    xi = np.zeros(6) if rng is None else np.linalg.cholesky(cov) @ rng.standard_normal(6)
    return PosePrior(t_ns, p_WC + xi[:3], R_WC @ geo.exp(xi[3:]), cov)
