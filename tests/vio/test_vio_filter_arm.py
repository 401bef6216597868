"""The arms: outputs carry stamp and arrival; the VO's Kalman filter smooths and restarts."""

import numpy as np
from flights import CAMERA, CLEAN, fly, rms

from tagvo.records import Frame
from vio.estimator import Estimator
from vio.filter_arm import VioArm, VoKfArm
from vio.records import ImuSample
from vio.settings import VioConfig
from vio.sim.inertial import PIXHAWK
from vio.sim.poses import PoseNoise


def test_vio_arm_answers_every_sample_once_started():
    flown = fly("T3", 0, CLEAN, seconds=5.0)
    arm = VioArm(Estimator(VioConfig(), CAMERA, PIXHAWK))
    outputs, poses = [], list(flown.poses)
    for sample in flown.imu:
        late = ImuSample(sample.t_ns, sample.gyro_I, sample.accel_I, sample.t_ns + 2_000_000)
        while poses and poses[0][0] <= late.arrival_ns:
            arrival, pose = poses.pop(0)
            out = arm.pose(Frame(pose.t_ns, arrival_ns=arrival), pose)
            assert out is None or (out.known_ns == arrival and out.t_ns <= arrival)
        outputs.append(arm.imu(late))
    started = [o for o in outputs if o is not None]
    assert len(started) > 700
    assert all(o.known_ns - o.t_ns == 2_000_000 for o in started)
    assert started[-1].cov.shape == (6, 6)
    assert arm.states["TRACKING"] > 700


def test_vo_kf_smooths_and_knows_its_velocity():
    noise = PoseNoise(white=(0.03, 0.5), slow=(0.0, 0.0), outliers=0.0, dropouts=0, stamp_s=0.0)
    flown = fly("T1", 0, noise, seconds=20.0)
    arm, raw, kept = VoKfArm(CAMERA), [], []
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
    arm = VoKfArm(CAMERA)
    for _, pose in flown.poses[:40]:
        arm.pose(Frame(pose.t_ns), pose)
    assert arm.pose(Frame(0), flown.poses[5][1]) is None
    far = flown.poses[-1][1]
    assert np.linalg.norm(arm.pose(Frame(far.t_ns), far).v_WI) < 1e-12
    assert arm.pose(Frame(far.t_ns), None) is None
