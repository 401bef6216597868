"""The camera's stream and its calibration: each fault alone, and as big as it is said to be."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from simulated import arena, corners_seen, grid_map, pinhole, pose_above

from tagvo import geometry as geo
from tagvo.camera.model import project
from vio.sim.sensors.camera_stream import CalibrationError, CameraStream, exposures, said_camera
from vio.sim.sensors.clocks import Clock
from vio.sim.sensors.perfect_detector import SightingConfig, sighted
from vio.sim.world import course as crs
from vio.sim.world.airframe import Vehicle, mount
from vio.sim.world.dynamics import body_flight
from vio.sim.world.trajectory import t3_command

CLOCK = Clock(1_700_000_000_000_000_000)
EXACT = SightingConfig(sigma_px=0.0, least_side_px=0.0)


def seen(seed=0, seconds=40.0, clock=CLOCK, **keys):
    stream = CameraStream(**keys)
    return exposures(stream, (0.0, seconds), clock, np.random.default_rng(seed))


def test_a_perfect_stream():
    frames = seen(rate_hz=20.0, start_s=0.2, seconds=2.0)
    assert_allclose(frames.t_s, 0.2 + np.arange(36) / 20.0)
    assert_array_equal(frames.t_ns, CLOCK.shows(frames.t_s))
    assert_array_equal(frames.arrival_ns, frames.t_ns)


def test_stamps_are_off_by_the_time_shift_and_drift():
    frames = seen(timeshift_s=0.03, drift_ppm=500.0)
    t_imu = CLOCK.shows(frames.t_s)
    assert_allclose((t_imu - frames.t_ns) * 1e-9, 0.03 - 5e-4 * frames.t_s, atol=2e-9)
    assert_array_equal(frames.arrival_ns, t_imu)  # known in the IMU's clock
    both = seen(clock=Clock(CLOCK.zero_ns, 5e-4), drift_ppm=500.0, timeshift_s=0.03)
    assert_array_equal(Clock(CLOCK.zero_ns, 5e-4).shows(both.t_s) - both.t_ns, 30_000_000)


def test_jitter_latency_and_slow_frames():
    jitter = (seen(stamp_jitter_s=1e-3).t_ns - seen().t_ns) * 1e-9
    assert 0.8e-3 < jitter.std() < 1.2e-3
    frames = seen(latency_s=(0.06, 0.12), slow_share=0.1, slow_s=0.3, in_order=False)
    late = (frames.arrival_ns - frames.t_ns) * 1e-9
    assert 0.06 <= late.min() < 0.062
    assert 0.02 < (late > 0.12).mean() < 0.13
    assert (np.diff(frames.arrival_ns) < 0).any()
    ordered = seen(latency_s=(0.06, 0.12), slow_share=0.1, slow_s=0.3)
    assert (np.diff(ordered.arrival_ns) >= 0).all()
    assert (ordered.arrival_ns >= frames.arrival_ns).all()


def test_lost_frames_dropouts_and_stalls():
    whole = seen()
    lost = seen(drop_share=0.2)
    assert 0.14 < 1 - len(lost) / len(whole) < 0.26
    assert np.isin(lost.t_ns, whole.t_ns).all()
    gaps = np.diff(seen(dropouts=3, dropout_s=(0.5, 3.0), seed=3).t_s)
    assert 1 <= (gaps > 0.4).sum() <= 3
    assert gaps.max() < 6.1
    assert seen(dropouts=3, dropouts_after_s=10.0).t_s[:290].max() < 10.0
    stalled = seen(stalls=2, stall_s=0.5)
    assert_array_equal(stalled.t_ns, whole.t_ns)
    late = (stalled.arrival_ns - stalled.t_ns) * 1e-9
    together = np.diff(stalled.arrival_ns) == 0
    assert together.any()
    assert 0.0 < late.max() <= 0.5


def test_one_fault_does_not_move_the_draws_of_another():
    one, two = seen(stamp_jitter_s=1e-3), seen(stamp_jitter_s=1e-3, latency_s=(0.1, 0.2))
    assert_array_equal(one.t_ns, two.t_ns)


def test_the_calibration_is_off_by_what_it_is_said_to_be():
    R_CI, p_CI = mount(Vehicle(name="x", camera_p_I=(0.1, 0.0, -0.05), camera_rpy_deg=(1, 2, 3)))
    true, stream = pinhole(R_CI=R_CI, p_CI=p_CI), CameraStream(timeshift_s=0.03)
    exact = said_camera(true, stream, CalibrationError(), np.random.default_rng(0))
    assert_allclose(exact.R_CI, true.R_CI, atol=1e-15)
    assert_allclose(exact.p_CI, true.p_CI, atol=1e-15)
    assert exact.timeshift_s == 0.03
    error = CalibrationError(
        rotation_deg=2.0, position_m=0.01, focal_rel=1e-3, principal_px=0.5, timeshift_s=0.02
    )
    said = [said_camera(true, stream, error, np.random.default_rng(k)) for k in range(200)]
    for camera in said:
        R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
        assert np.degrees(geo.angle(true.R_CI @ R_IC)) == pytest.approx(2.0)
        assert np.linalg.norm(p_IC - [0.1, 0.0, -0.05]) == pytest.approx(0.01)
        assert camera.timeshift_s == pytest.approx(0.01)
    focal = np.array([c.intrinsics[0] / true.intrinsics[0] - 1.0 for c in said])
    centre = np.array([c.intrinsics[2:] - true.intrinsics[2:] for c in said])
    assert 0.8e-3 < focal.std() < 1.2e-3
    assert 0.42 < centre.std() < 0.58


def test_the_camera_is_where_the_vehicle_carries_it():
    """Ahead and below, looking down: what is ahead is up in the image, what is left is left."""
    R_CI, p_CI = mount(Vehicle(name="x", camera_p_I=(0.25, 0.0, -0.05)))
    ahead, left = ([1.25, 0.0, -1.05], [0.25, 1.0, -1.05])
    assert_allclose(R_CI @ np.array(ahead) + p_CI, [0.0, -1.0, 1.0], atol=1e-12)
    assert_allclose(R_CI @ np.array(left) + p_CI, [-1.0, 0.0, 1.0], atol=1e-12)
    R_CI, _ = mount(Vehicle(name="x", camera_p_I=(0, 0, 0), camera_rpy_deg=(0.0, -20.0, 0.0)))
    axis_I = R_CI.T @ [0.0, 0.0, 1.0]
    assert axis_I[0] > 0.3  # nose up: it looks ahead


def still(R_WC, p_WC):
    return lambda t: (np.tile(R_WC, (len(t), 1, 1)), np.tile(p_WC, (len(t), 1)))


def test_exact_corners_are_the_projections():
    rng, camera, tag_map = np.random.default_rng(1), pinhole(), grid_map(5, [0.1, 0.2], 0.35)
    counts = []
    for _ in range(20):
        R_WC, p_WC = pose_above(rng, rng.uniform(0.4, 2.0), [-0.5, -0.5], [0.5, 0.5], tilt_deg=15)
        found = sighted(tag_map, camera, still(R_WC, p_WC), 0.0, EXACT, rng)
        rows, pixels = corners_seen(tag_map, camera, R_WC, p_WC)
        assert_array_equal(found.tag_id, tag_map.tag_id[rows])
        assert_allclose(found.corners_px, pixels[rows], atol=1e-9)
        counts.append(len(found))
    assert max(counts) > 10
    behind = np.diag([1.0, 1.0, 1.0]), np.array([0.0, 0.0, -1.0])  # below the floor, looking up
    assert len(sighted(tag_map, camera, still(*behind), 0.0, EXACT, rng)) == 0


def test_noise_and_misses_of_corners():
    rng, camera, tag_map = np.random.default_rng(1), pinhole(), grid_map(5, 0.1, 0.15)
    down = np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0])
    exact = sighted(tag_map, camera, still(*down), 0.0, EXACT, rng)
    noisy = SightingConfig(sigma_px=0.3, least_side_px=0.0, miss_share=0.4)
    rest, count = [], 0
    for _ in range(100):
        found = sighted(tag_map, camera, still(*down), 0.0, noisy, rng)
        rows = np.searchsorted(exact.tag_id, found.tag_id)
        rest.append((found.corners_px - exact.corners_px[rows]).ravel())
        count += len(found)
    assert 0.29 < np.concatenate(rest).std() < 0.31
    assert 0.55 < count / (100 * len(exact)) < 0.65
    far = SightingConfig(least_side_px=60.0)
    assert len(sighted(tag_map, camera, still(*down), 0.0, far, rng)) == 0


def test_a_rolling_shutter_sees_each_row_at_its_own_time():
    """Each corner lies where the camera of its own row's time sees it, by bisection here."""
    flight, camera = body_flight(crs.faster(crs.followed(t3_command()), 4.0)), pinhole()
    tag_map, readout, t0 = arena(), 0.03, 3.0
    R_IC, p_IC = geo.invert(*mount(Vehicle(name="x", camera_p_I=(0.1, 0.0, -0.05))))

    def pose_at(t):
        motion = flight(t)
        return geo.compose(motion.R_WI, motion.p_WI, R_IC, p_IC)

    found = sighted(
        tag_map, camera, pose_at, t0, EXACT, np.random.default_rng(0), readout_s=readout
    )
    assert len(found) >= 4
    moved = []
    for tag_id, corners in zip(found.tag_id[:3], found.corners_px[:3], strict=True):
        points = tag_map.corners_W[tag_map.rows(np.array([tag_id]))[0]]
        for point, pixel in zip(points, corners, strict=True):
            low, high = t0 - readout, t0 + readout
            for _ in range(30):
                t = 0.5 * (low + high)
                expected = _pixel(camera, pose_at, t, point)
                early = t0 + (expected[1] / 479.0 - 0.5) * readout > t
                low, high = (t, high) if early else (low, t)
            assert_allclose(pixel, expected, atol=0.01)
            moved.append(np.abs(pixel - _pixel(camera, pose_at, t0, point)).max())
    assert max(moved) > 1.0


def _pixel(camera, pose_at, t, point):
    R_WC, p_WC = (x[0] for x in pose_at(np.array([t])))
    return project(camera, R_WC.T @ (point - p_WC))[0]
