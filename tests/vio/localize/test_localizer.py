"""The localizer: states carry stamp and arrival; beside it the VO's Kalman filter."""

from dataclasses import replace

import numpy as np
import pytest
from flights import CAMERA, CLEAN, fly, rms
from simulated import grid_map, pinhole, pose_above, shot
from study_flights import PoseNoise

from tagvo import geometry as geo
from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from tagvo.records import Frame, PosePrior
from vio.config import Config
from vio.localize.baselines import VoKf
from vio.localize.localizer import Localizer
from vio.records import ImuSample
from vio.sim.sensors.simple_imu import PIXHAWK


def test_it_answers_every_sample_once_started():
    flown = fly("T3", 0, CLEAN, seconds=5.0)
    localizer = Localizer(CAMERA, grid_map(), imu_noise=PIXHAWK)
    outputs, poses = [], list(flown.poses)
    for sample in flown.imu:
        late = ImuSample(sample.t_ns, sample.gyro_I, sample.accel_I, sample.t_ns + 2_000_000)
        while poses and poses[0][0] <= late.arrival_ns:
            arrival, pose = poses.pop(0)
            out = localizer.fuse(Frame(pose.t_ns, arrival_ns=arrival), pose)
            assert out is None or (out.known_ns == arrival and out.t_ns <= arrival)
        outputs.append(localizer.process(late))
    started = [o for o in outputs if o is not None]
    assert len(started) > 700
    assert all(o.known_ns - o.t_ns == 2_000_000 for o in started)
    assert started[-1].cov.shape == (9, 9)
    assert localizer.states["TRACKING"] > 700


def test_vo_kf_smooths_and_knows_its_velocity():
    noise = PoseNoise(white=(0.03, 0.5), slow=(0.0, 0.0), outliers=0.0, dropouts=0, stamp_s=0.0)
    flown = fly("T1", 0, noise, seconds=20.0)
    arm, raw, kept = VoKf(CAMERA), [], []
    for arrival, pose in flown.poses:
        out = arm.pose(Frame(pose.t_ns, arrival_ns=arrival), pose)
        truth = flown.flight(np.array([out.t_ns * 1e-9]))
        kept.append(np.concatenate([out.p_WI - truth.p_WI[0], out.v_WI - truth.v_WI[0]]))
        raw.append(pose.p_WC + pose.R_WC @ CAMERA.p_CI - truth.p_WI[0])
    kept, raw = np.array(kept)[20:], np.array(raw)[20:]
    assert rms(kept[:, :3]) < 0.85 * rms(raw)
    assert rms(kept[:, 3:]) < 0.25


def test_vo_kf_starts_again_after_a_gap_and_drops_old_stamps():
    flown = fly("T1", 1, CLEAN, seconds=6.0)
    arm = VoKf(CAMERA)
    for _, pose in flown.poses[:40]:
        arm.pose(Frame(pose.t_ns), pose)
    assert arm.pose(Frame(0), flown.poses[5][1]) is None
    far = flown.poses[-1][1]
    assert np.linalg.norm(arm.pose(Frame(far.t_ns), far).v_WI) < 1e-12
    assert arm.pose(Frame(far.t_ns), None) is None


class Expecting:
    """A filter that knows where the camera is, and keeps the poses that it is given."""

    def __init__(self, prior):
        self.known, self.taken = prior, []

    def prior(self, t_ns):
        return self.known

    def pose(self, measured):
        self.taken.append(measured)

    def nav(self, known_ns):
        return None


@pytest.mark.parametrize("knows", [True, False])
def test_an_ambiguous_frame_is_looked_at_again_where_the_filter_knows(knows):
    """A lone tag taken for its mirrored branch: with the prior of the filter it is the true one."""
    rng, tag_map = np.random.default_rng(4), grid_map(1, 0.1, 0.16)
    camera, vo_config = pinhole(), TagvoConfig(ambiguity="consistent")
    vo, first, second = TagVO(camera, tag_map, vo_config), [], []
    for _ in range(12):
        R_WC, p_WC = pose_above(rng, 1.0, [-0.02, -0.02], [0.02, 0.02])
        true = shot(tag_map, camera, R_WC, p_WC, rng)
        trace = vo.trace(replace(true.frame, t_ns=0))
        assert trace.pose is not None
        if "ambiguous" not in trace.pose.flags:
            continue
        prior = PosePrior(0, p_WC, R_WC, 1e-6 * np.eye(6)) if knows else None
        localizer = Localizer(camera, tag_map, Config(tagvo=vo_config))
        localizer.filter = Expecting(prior)
        localizer.fuse(Frame(0), trace.pose, trace.observations)
        (taken,) = localizer.filter.taken
        assert (taken is trace.pose) is not knows
        first.append(np.degrees(geo.angle(R_WC.T @ trace.pose.R_WC)))
        second.append(np.degrees(geo.angle(R_WC.T @ taken.R_WC)))
    changed = [(a, b) for a, b in zip(first, second, strict=True) if abs(a - b) > 1.0]
    assert bool(changed) is knows, "some of them were of the other branch"
    assert all(b < a for a, b in changed), "and this one is nearer to the truth"


def test_without_an_imu_a_frame_gives_the_state_of_visual_odometry():
    rng, tag_map, camera = np.random.default_rng(1), grid_map(), pinhole(timeshift_s=0.02)
    R_WC, p_WC = pose_above(rng, 0.8, [0.0, 0.0], [0.05, 0.05])
    frame = replace(shot(tag_map, camera, R_WC, p_WC, rng).frame, t_ns=5, arrival_ns=9)
    localizer = Localizer(camera, tag_map, imu=False)
    assert localizer.process(ImuSample(1, np.zeros(3), np.zeros(3), 1)) is None
    state = localizer.process(frame)
    assert (state.t_ns, state.known_ns) == (5 + 20_000_000, 9)
    assert np.linalg.norm(state.p_WI - p_WC) < 0.02
    assert localizer.prior(5) is None
    assert localizer.trace.pose is not None
