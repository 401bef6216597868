"""Pixels to pose: the paper's stages in the paper's order, and the joint pose beside them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tagvo.camera.model import Camera
from tagvo.config import TagvoConfig
from tagvo.detect import Detector, make_detector
from tagvo.detect.blur import measured_sigma
from tagvo.detect.edge_profile import Gray
from tagvo.detect.protocol import gray_image
from tagvo.detect.rejection import filter_detections
from tagvo.errors import TagvoError
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.kernels.tag_residual import TagBatch, mean_covariance
from tagvo.pose.ambiguity import AMBIGUITY, camera_candidates, chi2_gap
from tagvo.pose.fusion import WEIGHT, fuse
from tagvo.pose.ippe import solve_tags
from tagvo.pose.joint import JointPose
from tagvo.pose.lone_tag import with_hidden_shift
from tagvo.pose.measurement import Candidates, best_joint, measure_fused, measure_joint
from tagvo.pose.observations import observe, quad_area, tag_batch, to_imu_poses
from tagvo.pose.outliers import REJECT
from tagvo.pose.selection import SELECT
from tagvo.records import (
    Detections,
    Frame,
    ImuPoses,
    Observations,
    PoseMeasurement,
    PosePrior,
    TagPoses,
)
from tagvo.tags.tag_map import TagMap
from tagvo.track.tracker import Tracker


@dataclass(frozen=True, slots=True, eq=False)
class FusedPose:
    """The paper's pose: of the body (p_WI (3,), R_WI (3, 3)) and of the camera (p_WC, R_WC).

    cov (6, 6) as in PoseMeasurement, None on the way to a joint pose; weights (k,) of the tags
    that were kept.
    """

    p_WI: Array
    R_WI: Array
    p_WC: Array
    R_WC: Array
    cov: Array | None
    weights: Array


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Every intermediate of one frame, for reports and tests; None where a stage was not reached.

    counts: detections dropped, by cause, and how they were found (tracked_frames, search_CAUSE);
    observations, tag_poses, candidates, imu_poses: of the n tags on the map; selected (n,) by THS;
    kept (k,) rows of those left by OR; fused, joint: the two poses; pose: the output; reason: why
    there is none.
    """

    t_ns: int
    detections: Detections
    counts: dict[str, int]
    observations: Observations
    tag_poses: TagPoses | None = None
    candidates: Candidates | None = None
    imu_poses: ImuPoses | None = None
    selected: BoolArray | None = None
    kept: IntArray | None = None
    fused: FusedPose | None = None
    joint: JointPose | None = None
    pose: PoseMeasurement | None = None
    reason: str | None = None

    def rejected(self, reject_weight: float) -> BoolArray:
        """Which of the n tags the joint pose gave less than this weight; none where it is not had.

        (n,); raises nothing.
        """
        if self.joint is None:
            return np.zeros(len(self.observations), dtype=bool)
        return np.asarray(self.joint.weight < reject_weight)


def _no_lap(stage: str) -> None:
    return None


class TagVO:
    """The tag visual odometry of one camera over one map; owns a detector and, with
    `track.mode: on`, a tracker: it remembers which strip it searched, nothing of poses."""

    def __init__(
        self,
        camera: Camera,
        tag_map: TagMap,
        config: TagvoConfig | None = None,
        *,
        detector: Detector | None = None,
        lap: Callable[[str], None] = _no_lap,
    ) -> None:
        """detector: what finds tags in images; None: as the config says, made at the first image.

        lap: called with the name of each stage as it ends; core code reads no clock.
        """
        self.camera = camera
        self.tag_map = tag_map
        self.config = config or TagvoConfig()
        self._detector = detector
        self._tracker: Tracker | None = None
        self._lap = lap

    def __call__(self, frame: Frame, prior: PosePrior | None = None) -> PoseMeasurement | None:
        """The pose of the camera at this frame, or None where no tag gives one."""
        return self.trace(frame, prior).pose

    def trace(self, frame: Frame, prior: PosePrior | None = None) -> Trace:
        """The pose of the camera at this frame with every intermediate."""
        cfg, lap = self.config, self._lap
        found, how = self.find(frame, prior)
        lap("detect")
        det, rows, counts = filter_detections(
            found, self.tag_map, cfg.filters, self.camera.resolution
        )
        counts |= how
        obs, counts["not_undistorted"] = observe(
            det, rows, self.camera, cfg.noise.corner_px, frame.camera
        )
        if not len(obs):
            reason = "no_tags" if not len(found) else "no_usable_tags"
            return Trace(frame.t_ns, found, counts, obs, reason=reason)
        tags, area = tag_batch(obs, self.tag_map, self.camera, cfg.floor), quad_area(obs.corners_px)
        tag_poses, candidates = self._tag_poses(obs, tags, area, prior)
        imu_poses = to_imu_poses(obs, *candidates.taken(), area, self.tag_map, self.camera)
        lap("tagpose")
        selected = SELECT[cfg.select](imu_poses)
        inside, flags = REJECT[cfg.outliers](imu_poses.p_WI[selected], cfg.iqr)
        kept = np.flatnonzero(selected)[inside]
        lap("select")
        fused, mean_flags = self._fuse(imu_poses, kept, tags)
        lap("fuse")
        joint, pose, reason = None, None, "inconsistent"
        if fused.cov is not None:
            pose = measure_fused(
                frame.t_ns, (fused.R_WC, fused.p_WC), fused.cov, obs, kept, candidates,
                {*flags, *mean_flags},
            )  # fmt: skip
        else:
            reason = "all_rejected"
            joint, pose = self._joint(frame.t_ns, fused, candidates, obs, tags, area, prior)
            lap("joint")
        return Trace(
            frame.t_ns, found, counts, obs, tag_poses, candidates, imu_poses, selected, kept, fused,
            joint, pose, None if pose else reason,
        )  # fmt: skip

    def detect(self, frame: Frame) -> Detections:
        """Tags of a frame that brings its own, or found in its image with a sigma each corner."""
        return self.find(frame, None)[0]

    def find(self, frame: Frame, prior: PosePrior | None) -> tuple[Detections, dict[str, int]]:
        """Tags of a frame that brings its own, tracked by a prior, or found in its image.

        Those of an image come with a sigma each corner; the counts say how they were found.
        TagvoError for a frame without either, and for an image of another size than the camera's.
        """
        if frame.detections is not None:
            return frame.detections, {}
        if frame.image is None:
            raise TagvoError(f"frame {frame.t_ns}: neither an image nor detections")
        gray = gray_image(frame.image)
        if gray.shape[::-1] != self.camera.resolution:
            (height, width), (w, h) = gray.shape, self.camera.resolution
            raise TagvoError(
                f"frame {frame.t_ns}: {width}x{height} pixels; the camera file says {w}x{h}"
            )
        if self.config.track.mode == "off":
            return self._search(gray), {}
        if self._tracker is None:
            self._tracker = Tracker(self.camera, self.tag_map, self.config.track)
        largest_only = self.config.pose == "fused" and self.config.select != "ALL"
        tracked = self._tracker(gray, frame.t_ns, prior, self._search, largest_only)
        if tracked.detections is not None:
            return self._with_floor(tracked.detections), tracked.counts
        found = self._search(gray, self._tracker.decimate(prior, frame.t_ns, largest_only))
        self._tracker.searched(found, largest_only)
        return found, tracked.counts

    def _with_floor(self, found: Detections) -> Detections:
        """Tracked tags with the share of the configured noise that no residual shows."""
        floor = 0.5 * self.config.noise.image_px
        return replace(found, sigma_px=np.hypot(found.sigma_px, floor))

    def _search(self, gray: Gray, decimate: float | None = None) -> Detections:
        """Tags found in a grey image, or in a part of one, with a sigma each corner."""
        cfg, family, bits = self.config, self.tag_map.family, self.tag_map.border_bits
        if self._detector is None:
            d = cfg.detector
            self._detector = make_detector(
                d.library, family, border_bits=bits, decimate=d.decimate,
                max_hamming=d.max_hamming, threads=d.threads,
            )  # fmt: skip
        found = self._detector.detect(gray, decimate if cfg.track.adaptive else None)
        if not len(found):
            return found
        if not cfg.noise.blur:
            return replace(found, sigma_px=np.full((len(found), 4), cfg.noise.image_px))
        cells = family.border_cells + 2 * (bits - 1)
        sigma = measured_sigma(gray, found.corners_px, cells, cfg.noise.image_px)
        return replace(found, sigma_px=sigma)

    def _tag_poses(
        self, obs: Observations, tags: TagBatch, area: Array, prior: PosePrior | None
    ) -> tuple[TagPoses, Candidates]:
        """Both poses of every tag, and which of them each takes."""
        steps = self.config.refine if self.config.pose == "fused" else 0  # joint refines the whole
        poses = solve_tags(obs, tags.corners_T, self.tag_map.size[obs.row], steps)
        R_WC, p_WC, depth = camera_candidates(poses.R_CT, poses.p_CT, tags.R_WT, tags.p_WT)
        gap = chi2_gap(poses.rms_px, obs.sigma_px)
        branch = AMBIGUITY[self.config.ambiguity](R_WC, p_WC, depth, gap, area, prior)
        return poses, Candidates(R_WC, p_WC, depth, gap, branch)

    def _fuse(
        self, imu_poses: ImuPoses, kept: IntArray, tags: TagBatch
    ) -> tuple[FusedPose, tuple[str, ...]]:
        """MEF of the kept tags, back at the camera, with its covariance; and flags."""
        cfg, camera = self.config, self.camera
        weights = WEIGHT[cfg.weights](imu_poses.level[kept])
        p_WI, R_WI, flags = fuse(imu_poses.p_WI[kept], imu_poses.R_WI[kept], weights, cfg.mean)
        R_WC = R_WI @ camera.R_CI.T
        p_WC = p_WI - R_WC @ camera.p_CI
        cov = None  # of no use to the joint pose, which starts here
        if cfg.pose == "fused":
            cov = mean_covariance(R_WC, p_WC, tags, kept, weights / weights.sum())
        return FusedPose(p_WI, R_WI, p_WC, R_WC, cov, weights), flags

    def _joint(
        self,
        t_ns: int,
        fused: FusedPose,
        candidates: Candidates,
        obs: Observations,
        tags: TagBatch,
        area: Array,
        prior: PosePrior | None,
    ) -> tuple[JointPose, PoseMeasurement | None]:
        """The joint pose from the fused one as its start, and the measurement it makes."""
        cfg = self.config
        judge = prior if cfg.ambiguity == "prior" else None
        joint, rival, gap = best_joint(
            (fused.R_WC, fused.p_WC), tags, candidates, area, cfg.joint, judge
        )
        if len(obs) == 1:
            joint, misfit = with_hidden_shift(joint, tags)
            gap /= misfit
        reject = cfg.joint.reject_weight
        return joint, measure_joint(t_ns, joint, rival, gap, obs, reject)
