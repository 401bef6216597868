"""From detections to the measurement: trace, variants by name, frames with little or bad input."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from simulated import DOWN, arena, error_of, grid_map, pinhole, pose_above, shot
from strategies import seeds

from tagvo import geometry as geo
from tagvo.config import TagvoConfig
from tagvo.errors import TagvoError
from tagvo.pipeline import TagVO
from tagvo.pose.fusion import MEAN, WEIGHT
from tagvo.pose.outliers import REJECT
from tagvo.pose.selection import SELECT
from tagvo.records import Detections, Frame

CAMERA = pinhole(R_CI=DOWN, p_CI=np.array([0.02, -0.10, 0.05]))
MAP = arena()
POSES = ("fused", "joint")


def frame_at(seed, height=1.0, noise_px=0.3):
    rng = np.random.default_rng(seed)
    return shot(MAP, CAMERA, *pose_above(rng, height, [1.0, 1.5], [2, 3.5]), rng, noise_px=noise_px)


def vo_of(**keys):
    return TagVO(CAMERA, MAP, TagvoConfig(**keys))


def same(a, b):
    return all(
        np.array_equal(x, y) for x, y in ((a.p_WC, b.p_WC), (a.R_WC, b.R_WC), (a.cov, b.cov))
    )


@pytest.mark.parametrize("pose", POSES)
def test_the_trace_is_whole_and_consistent(pose):
    true = frame_at(1)
    trace = vo_of(pose=pose).trace(true.frame)
    n = len(trace.observations)
    assert n > 10
    assert len(trace.detections) == n + sum(trace.counts.values())
    assert trace.reason is None
    assert trace.tag_poses.R_CT.shape == trace.candidates.R_WC.shape == (n, 2, 3, 3)
    assert trace.tag_poses.cov.shape == (n, 2, 6, 6)
    assert len(trace.imu_poses) == len(trace.selected) == len(trace.candidates.branch) == n
    assert trace.selected[trace.kept].all()
    assert len(trace.fused.weights) == len(trace.kept)
    R_WC, p_WC = geo.compose(
        trace.fused.R_WI, trace.fused.p_WI, *geo.invert(CAMERA.R_CI, CAMERA.p_CI)
    )
    assert_allclose(trace.fused.R_WC, R_WC, atol=1e-12)
    assert_allclose(trace.fused.p_WC, p_WC, atol=1e-12)
    assert (trace.joint is None) == (pose == "fused")
    source = trace.fused if pose == "fused" else trace.joint
    assert_array_equal(trace.pose.p_WC, source.p_WC)
    assert np.linalg.eigvalsh(trace.pose.cov).min() > 0.0
    assert_array_equal(trace.pose.cov, trace.pose.cov.T)
    if pose == "fused":
        assert trace.pose.tag_ids == tuple(trace.observations.tag_id[trace.kept].tolist())


@pytest.mark.parametrize("select", SELECT)
@pytest.mark.parametrize("outliers", REJECT)
def test_stages_are_the_named_functions(select, outliers):
    """What the pipeline keeps is what the stages keep when they are called one after another."""
    for weights in WEIGHT:
        for mean in MEAN:
            vo = vo_of(pose="fused", select=select, outliers=outliers, weights=weights, mean=mean)
            trace = vo.trace(frame_at(2).frame)
            imu_poses = trace.imu_poses
            mask = SELECT[select](imu_poses)
            rows = np.flatnonzero(mask)[REJECT[outliers](imu_poses.p_WI[mask], vo.config.iqr)[0]]
            assert_array_equal(trace.kept, rows)
            w = WEIGHT[weights](imu_poses.level[rows])
            assert_allclose(trace.fused.p_WI, np.average(imu_poses.p_WI[rows], axis=0, weights=w))
            q = MEAN[mean](geo.quat_from_matrix(imu_poses.R_WI[rows]), w)[0]
            assert_allclose(trace.fused.R_WI, geo.matrix_from_quat(q), atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("height", [0.5, 1.0, 2.0])
def test_noise_free_corners_of_an_exact_map_give_the_exact_pose(pose, height):
    rng = np.random.default_rng(3)
    pose_true = pose_above(rng, height, [1.0, 1.5], [2.0, 3.5], tilt_deg=10.0)
    true = shot(MAP, CAMERA, *pose_true, rng, noise_px=0.0, lay=False)
    found = vo_of(pose=pose, refine=5)(true.frame)
    assert np.abs(error_of(found.p_WC, found.R_WC, true)).max() < 1e-5


@pytest.mark.parametrize("pose", POSES)
def test_a_frame_without_tags(pose):
    trace = vo_of(pose=pose).trace(Frame(5, detections=Detections.of([], np.zeros((0, 4, 2)))))
    assert (trace.pose, trace.reason, trace.t_ns) == (None, "no_tags", 5)


@pytest.mark.parametrize("pose", POSES)
def test_a_frame_whose_tags_are_all_unknown_or_broken(pose):
    det = frame_at(4).frame.detections
    corners = det.corners_px.copy()
    corners[:, 2, 1] = np.nan
    broken = vo_of(pose=pose).trace(Frame(0, detections=Detections.of(det.tag_id, corners)))
    assert (broken.pose, broken.reason) == (None, "no_usable_tags")
    assert broken.counts["not_finite"] == len(det)
    unknown = Detections.of(det.tag_id + 2000, det.corners_px)
    trace = vo_of(pose=pose).trace(Frame(0, detections=unknown))
    assert (trace.pose, trace.reason) == (None, "no_usable_tags")
    assert trace.counts["not_on_map"] == len(det)


@pytest.mark.parametrize("pose", POSES)
def test_broken_and_unknown_tags_among_good_ones_change_nothing(pose):
    frame, vo = frame_at(5).frame, vo_of(pose=pose)
    det = frame.detections
    bad = np.stack([np.full((4, 2), np.nan), det.corners_px[0] + 3.0])
    more = Detections.of(
        np.concatenate([[MAP.tag_id[-1]], det.tag_id, [2100]]),
        np.concatenate([bad[:1], det.corners_px, bad[1:]]),
    )
    assert same(vo(frame), vo(Frame(0, detections=more)))


@pytest.mark.parametrize("pose", POSES)
def test_the_camera_s_index_goes_with_the_frame_and_changes_nothing_else(pose):
    frame, vo = frame_at(5).frame, vo_of(pose=pose)
    trace = vo.trace(replace(frame, camera=2))
    assert (trace.observations.camera, trace.observations[:2].camera, trace.pose.camera) == (2,) * 3
    assert vo(frame).camera == 0
    assert same(vo(frame), trace.pose)


@pytest.mark.parametrize("pose", POSES)
def test_one_tag_gives_a_pose(pose):
    true = frame_at(6)
    det = true.frame.detections
    biggest = MAP.size[MAP.rows(det.tag_id)].argmax()
    one = Frame(0, detections=det[np.array([biggest])])
    found = vo_of(pose=pose)(one)
    assert found.tag_ids == (int(det.tag_id[biggest]),)
    if pose == "fused":
        assert "or_skipped" in found.flags
    error = error_of(found.p_WC, found.R_WC, true)
    assert error @ np.linalg.solve(found.cov, error) < 40.0


@pytest.mark.parametrize("pose", POSES)
@settings(max_examples=15)
@given(seeds, st.sampled_from([0.5, 1.0, 2.0]))
def test_the_order_of_detections_does_not_change_the_pose(pose, seed, height):
    frame, vo = frame_at(seed, height).frame, vo_of(pose=pose)
    det = frame.detections
    order = np.random.default_rng(seed).permutation(len(det))
    one, other = vo(frame), vo(Frame(0, detections=det[order]))
    if one is None:
        assert other is None
        return
    sigma = np.sqrt(np.diag(one.cov))
    assert (np.abs(one.p_WC - other.p_WC) < 1e-2 * sigma[:3]).all()
    assert (np.abs(geo.log(one.R_WC.T @ other.R_WC)) < 1e-2 * sigma[3:]).all()
    assert set(one.tag_ids) == set(other.tag_ids)
    assert one.flags == other.flags


@pytest.mark.parametrize("pose", POSES)
def test_the_same_frame_gives_the_same_bytes(pose):
    frame = frame_at(7).frame
    assert same(vo_of(pose=pose)(frame), vo_of(pose=pose)(frame))


@pytest.mark.parametrize("pose", POSES)
def test_inputs_are_left_as_they_are(pose):
    frame = frame_at(8).frame
    before = frame.detections.corners_px.copy(), MAP.R_WT.copy(), MAP.p_WT.copy()
    vo_of(pose=pose)(frame)
    after = frame.detections.corners_px, MAP.R_WT, MAP.p_WT
    assert all(np.array_equal(a, b) for a, b in zip(after, before, strict=True))


@settings(max_examples=40)
@given(seeds, st.sampled_from(POSES), st.sampled_from(["first", "consistent", "prior"]))
def test_rubbish_in_the_corners_never_crashes(seed, pose, ambiguity):
    """Random quads with ids of the map: no pose or a flagged one, never a traceback."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 12))
    centre = rng.uniform(20, 460, (n, 1, 2))
    square = np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
    corners = centre + rng.uniform(3, 40, (n, 1, 1)) * (
        square + 0.3 * rng.standard_normal((n, 4, 2))
    )
    corners *= rng.choice([1.0, np.nan], (n, 1, 1), p=[0.9, 0.1])
    det = Detections.of(rng.choice(MAP.tag_id, n), corners)
    trace = vo_of(pose=pose, ambiguity=ambiguity).trace(Frame(0, detections=det))
    assert (trace.pose is None) == (trace.reason is not None)
    if trace.pose is not None:
        assert np.isfinite(trace.pose.cov).all()
        assert_allclose(trace.pose.R_WC @ trace.pose.R_WC.T, np.eye(3), atol=1e-8)


def test_a_frame_with_neither_image_nor_detections_is_an_error():
    with pytest.raises(TagvoError, match="neither an image nor detections"):
        vo_of()(Frame(3))


def test_an_image_of_another_size_than_the_cameras_is_an_error():
    width, height = CAMERA.resolution
    with pytest.raises(TagvoError, match=f"{height}x{width} pixels.*{width}x{height}"):
        vo_of()(Frame(3, np.zeros((width, height), dtype=np.uint8)))


def test_laps_name_the_stages_in_order():
    names = []
    vo = TagVO(CAMERA, MAP, TagvoConfig(), lap=names.append)
    vo(frame_at(9).frame)
    assert names == ["detect", "tagpose", "select", "fuse", "joint"]


def test_corner_sigmas_of_the_detector_are_used():
    frame = frame_at(10).frame
    det = frame.detections
    sharp = Detections.of(det.tag_id, det.corners_px, sigma_px=np.full((len(det), 4), 0.03))
    vo = TagVO(CAMERA, MAP, TagvoConfig(floor={"focal_rel": 0.0, "principal_px": 0.0}))
    wide, narrow = vo(frame), vo(Frame(0, detections=sharp))
    assert_array_equal(vo.trace(Frame(0, detections=sharp)).observations.sigma_px, 0.03)
    assert np.linalg.det(narrow.cov) != np.linalg.det(wide.cov)


def test_tags_where_the_lens_has_no_inverse_are_counted():
    camera = pinhole()
    bent = type(camera)("radtan", camera.intrinsics, np.array([-0.9, 0.0, 0.0, 0.0]), (640, 480))
    tag_map = grid_map(2, 0.1)
    quad = np.array([[0.0, 0], [30, 0], [30, 30], [0, 30]]) + 8.0
    trace = TagVO(bent, tag_map).trace(Frame(0, detections=Detections.of([0], [quad])))
    assert (trace.reason, trace.counts["not_undistorted"]) == ("no_usable_tags", 1)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_tags_that_contradict_one_another_give_no_pose_or_a_degraded_one(seed):
    det = frame_at(seed).frame.detections
    turned = Detections.of(det.tag_id, np.roll(det.corners_px, 2, axis=1))
    pose = vo_of()(Frame(0, detections=turned))
    assert pose is None or "degraded" in pose.flags
    sound = vo_of()(Frame(0, detections=det))
    assert "degraded" not in sound.flags
