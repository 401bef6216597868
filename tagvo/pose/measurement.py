"""Turns the fused or the joint pose into the measurement, and says where it is undecided."""

from dataclasses import dataclass, replace
from statistics import median

import numpy as np

from tagvo import geometry as geo
from tagvo.config import JointConfig
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.kernels.tag_residual import TagBatch
from tagvo.pose.ambiguity import DECISIVE, prior_cost
from tagvo.pose.joint import JointPose, solve_joint
from tagvo.records import Observations, PoseMeasurement, PosePrior

_ALTERNATIVE_TAGS = 3  # so few tags may all flip together: both branches are tried
_CONTRADICTION = 104.5  # median chi-square of a tag, four times the 99.9 % limit: tags disagree
_SAME_POSE = np.radians(0.5)


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Camera poses from both solutions of n tags, and which one each tag took.

    R_WC (n, 2, 3, 3), p_WC (n, 2, 3) [m], depth (n, 2) [m], gap (n,) chi-square by which the
    second fits worse, branch (n,) 0 or 1.
    """

    R_WC: Array
    p_WC: Array
    depth: Array
    gap: Array
    branch: IntArray

    def taken(self) -> tuple[Array, Array]:
        """R_WC (n, 3, 3), p_WC (n, 3) of the branches taken."""
        rows = np.arange(len(self.branch))
        return self.R_WC[rows, self.branch], self.p_WC[rows, self.branch]

    def other(self, row: int) -> tuple[Array, Array]:
        """R_WC (3, 3), p_WC (3,) of the branch that one tag did not take."""
        branch = 1 - int(self.branch[row])
        return self.R_WC[row, branch], self.p_WC[row, branch]


def with_doubt(
    cov: Array, here: tuple[Array, Array], other: tuple[Array, Array], gap: float
) -> Array:
    """Covariance about `here` of a pose that may as well be `other`; (6, 6), poses (R_WC, p_WC).

    The second moment of the mixture, the other pose having the likelihood exp(-gap / 2).
    """
    chance = 1.0 / (1.0 + np.exp(0.5 * max(gap, 0.0)))
    shift = np.concatenate([other[1] - here[1], geo.log(here[0].T @ other[0])])
    return np.asarray(cov + chance * np.outer(shift, shift))


def measure_fused(
    t_ns: int,
    pose: tuple[Array, Array],
    cov: Array,
    obs: Observations,
    rows: IntArray,
    candidates: Candidates,
    flags: set[str],
) -> PoseMeasurement | None:
    """The measurement of the paper's pose (R_WC, p_WC), made of the tags in these rows.

    None where it has no covariance: a tag lies behind the camera there.
    """
    if not np.isfinite(cov).all():
        return None
    if len(rows) == 1:
        gap = float(candidates.gap[rows[0]])
        if gap < DECISIVE:
            cov = with_doubt(cov, pose, candidates.other(int(rows[0])), gap)
            flags = flags | {"ambiguous"}
    return _measurement(t_ns, pose, cov, obs, rows, flags)


def best_joint(
    start: tuple[Array, Array],
    tags: TagBatch,
    candidates: Candidates,
    area_px: Array,
    config: JointConfig,
    prior: PosePrior | None,
) -> tuple[JointPose, JointPose | None, float]:
    """The joint pose from a start (R_WC, p_WC), its rival, and the rival's chi-square above it.

    With few tags a second start comes from the branch that the largest did not take; a prior, if
    given, has its say between the two. No rival: the poses are one, or many tags agree.
    """
    best = solve_joint(*start, tags, config)
    if len(area_px) > _ALTERNATIVE_TAGS:
        return best, None, np.inf
    other = candidates.other(int(np.argmax(area_px)))
    rival = solve_joint(*other, tags, config)
    if not np.isfinite(rival.cost):
        return best, None, np.inf
    if _turn(best, rival) < _SAME_POSE:
        if len(area_px) > 1:
            return best, None, np.inf
        # one flat valley from branch to branch, wider than its curvature at the lowest point says
        rival = replace(rival, R_WC=other[0], p_WC=other[1])
        return best, rival, max(float(candidates.gap[0]), 0.0)
    gap = rival.cost - best.cost
    if prior is not None:
        depth = np.full(1, float(np.median(candidates.depth)))
        gap += float(
            prior_cost(rival.R_WC[None], rival.p_WC[None], depth, prior)[0]
            - prior_cost(best.R_WC[None], best.p_WC[None], depth, prior)[0]
        )
    return (rival, best, -gap) if gap < 0.0 else (best, rival, gap)


def measure_joint(
    t_ns: int,
    joint: JointPose,
    rival: JointPose | None,
    gap: float,
    obs: Observations,
    reject_weight: float,
) -> PoseMeasurement | None:
    """The measurement of the joint pose; None where it failed or every tag was rejected."""
    used = joint.weight >= reject_weight
    if not np.isfinite(joint.cov).all() or not used.any():
        return None
    cov, flags = joint.cov, set[str]()
    if rival is not None and gap < DECISIVE:
        cov = with_doubt(cov, (joint.R_WC, joint.p_WC), (rival.R_WC, rival.p_WC), gap)
        flags.add("ambiguous")
    contradicted = median(joint.chi2.tolist()) > _CONTRADICTION
    if not joint.converged or contradicted or used.sum() < 0.5 * len(used):
        flags.add("degraded")
    return _measurement(t_ns, (joint.R_WC, joint.p_WC), cov, obs, used, flags)


def _turn(a: JointPose, b: JointPose) -> float:
    return float(geo.angle(a.R_WC.T @ b.R_WC))


def _measurement(
    t_ns: int,
    pose: tuple[Array, Array],
    cov: Array,
    obs: Observations,
    used: IntArray | BoolArray,
    flags: set[str],
) -> PoseMeasurement:
    R_WC, p_WC = pose
    symmetric = 0.5 * (cov + cov.T)
    ids = tuple(obs.tag_id[used].tolist())
    return PoseMeasurement(t_ns, p_WC, R_WC, symmetric, ids, tuple(sorted(flags)), obs.camera)
