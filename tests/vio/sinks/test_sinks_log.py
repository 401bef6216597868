"""What LogWriter writes is what FlightLog reads; and what it does to a log that is there."""

import errno
import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from simulated import grid_map, pinhole

from tagvo import geometry as geo
from tagvo.records import Detections, Frame
from vio.errors import LogError
from vio.records import ImuNoise, ImuSample, Phase
from vio.sinks.log_writer import LogWriter
from vio.sources.flight_log.log import FlightLog

T0 = 1_403_638_519_492_829_441  # odd: a float cannot hold it
CAMERA = pinhole(f=60.0, width=64, height=48, p_CI=np.array([0.1, 0.0, -0.05]), timeshift_s=1e-3)
NOISE = ImuNoise(2e-3, 3e-3, 1.7e-4, 1.9e-5, 200.0)
PHASES = (Phase("all", T0, T0 + 10**9), Phase("leg", T0, T0 + 7))


def image(k):
    return np.random.default_rng(k).integers(0, 256, (48, 64), dtype=np.uint8)


def found(rng, n):
    return Detections.of(
        rng.permutation(9)[:n], rng.uniform(0, 48, (n, 4, 2)), rng.integers(0, 2, n),
        rng.uniform(10, 90, n),
    )  # fmt: skip


@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 4), with_images=st.booleans())
@settings(max_examples=15)
def test_round_trip(tmp_path_factory, seed, n, with_images):
    rng, path = np.random.default_rng(seed), tmp_path_factory.mktemp("log") / "log"
    tags = [found(rng, int(rng.integers(1, 6))) for _ in range(n)]
    frames = [
        Frame(T0 + 10**8 * k, image(k) if with_images else None, tags[k], T0 + 10**8 * k + 5)
        for k in range(n)
    ]
    gyro, accel = rng.normal(size=(2, n, 3))
    samples = [ImuSample(T0 + 10**7 * k, gyro[k], accel[k], T0 + 10**7 * k + 3) for k in range(n)]
    p, v, R = rng.normal(size=(n, 3)), rng.normal(size=(n, 3)), geo.exp(rng.normal(size=(n, 3)))
    q = geo.quat_from_matrix(R)
    tag_map = grid_map()
    with LogWriter(path) as writer:
        writer.setup(tag_map, CAMERA, NOISE, "vehicle: {}\n")
        writer.phases(PHASES)
        for k in range(n):
            writer.frame(frames[k])
            writer.imu(samples[k])
            writer.truth(T0 + k, p[k], q[k], v[k])
    log = FlightLog.open(path)
    assert log.warnings == []
    assert_array_equal(log.tag_map.tag_id, tag_map.tag_id)
    assert_allclose(log.tag_map.corners_W, tag_map.corners_W, atol=1e-9)
    assert_array_equal(log.camera.intrinsics, CAMERA.intrinsics)
    assert log.camera.timeshift_s == CAMERA.timeshift_s
    assert (log.imu_noise, log.phases) == (NOISE, PHASES)
    assert log.config_path == path / "config.yaml"
    assert_array_equal(log.truth.t_ns, T0 + np.arange(n))
    assert_allclose(log.truth.p_WI, p, atol=1e-9)
    assert_allclose(log.truth.v_WI, v, atol=1e-9)
    assert_allclose(log.truth.q_WI, q, atol=1e-11)
    events = list(log.events())
    read = [e for e in events if isinstance(e, ImuSample)]
    assert [(s.t_ns, s.arrival_ns) for s in read] == [(s.t_ns, s.arrival_ns) for s in samples]
    assert_allclose([[*s.gyro_I, *s.accel_I] for s in read], np.hstack([gyro, accel]), atol=1e-11)
    seen = [e for e in events if isinstance(e, Frame)]
    assert [(f.t_ns, f.arrival_ns) for f in seen] == [(f.t_ns, f.arrival_ns) for f in frames]
    for there, given_frame in zip(seen, frames, strict=True):
        if with_images:
            assert_array_equal(there.image, given_frame.image)
    corners = FlightLog.open(path, use_detections=True).events()
    for there, tags_in in zip((e for e in corners if isinstance(e, Frame)), tags, strict=True):
        assert_array_equal(there.detections.tag_id, tags_in.tag_id)
        assert_allclose(there.detections.corners_px, tags_in.corners_px, atol=1e-6)
        assert_array_equal(there.detections.hamming, tags_in.hamming)
        assert_allclose(there.detections.margin, tags_in.margin, atol=1e-3)


def written(path, count, *, replace=False):
    writer = LogWriter(path, replace=replace)
    writer.setup(grid_map(), CAMERA)
    for k in range(count):
        writer.frame(Frame(T0 + k, image(k)))
    return writer


def test_a_log_can_be_read_while_it_is_written(tmp_path):
    """No close, no sync: what was written is there, as after a crash of the program."""
    writer = written(tmp_path, 3)
    assert FlightLog.open(tmp_path).frame_count == 3
    writer.frame(Frame(T0 + 3, image(3)))
    writer.sync()
    assert FlightLog.open(tmp_path).frame_count == 4
    writer.close()
    writer.frame(Frame(T0 + 4, image(4)))  # opens the file again, no second header
    writer.close()
    log = FlightLog.open(tmp_path)
    assert (log.frame_count, log.counters) == (5, {})


def test_a_log_is_not_overwritten_by_accident(tmp_path):
    written(tmp_path, 3).close()
    with pytest.raises(LogError, match="holds a log already"):
        LogWriter(tmp_path)
    assert FlightLog.open(tmp_path).frame_count == 3


def test_replace_removes_the_old_log_and_nothing_else(tmp_path):
    with written(tmp_path, 3) as writer:
        writer.imu(ImuSample(T0, np.zeros(3), np.zeros(3), T0), "imu_mavlink")
    mine = [tmp_path / "notes.txt", tmp_path / "mav0" / "cam0" / "data" / "photo.jpg"]
    for path in mine:
        path.write_text("keep")
    written(tmp_path, 1, replace=True).close()
    assert FlightLog.open(tmp_path).frame_count == 1
    assert all(path.read_text() == "keep" for path in mine)
    assert not list(tmp_path.glob("mav0/imu_mavlink/*"))
    assert len(list(tmp_path.rglob("*.png"))) == 1


def test_true_biases_and_the_notes_of_a_simulation(tmp_path):
    biases = np.array([1e-3, -2e-3, 3e-3, 0.1, -0.2, 0.3])
    with written(tmp_path, 2) as writer:
        for k in range(3):
            writer.truth(T0 + k, np.ones(3), np.array([1.0, 0, 0, 0]), np.zeros(3), k * biases)
        writer.note("scenario.yaml", "seed: 1\n")
        with pytest.raises(ValueError, match=r"scenario\.yaml, truth_rig\.yaml"):
            writer.note("mav0.yaml", "")
    log = FlightLog.open(tmp_path)
    assert_allclose(log.truth.b_g, np.outer(np.arange(3), biases[:3]), atol=1e-12)
    assert_allclose(log.truth.b_a, np.outer(np.arange(3), biases[3:]), atol=1e-12)
    assert (tmp_path / "scenario.yaml").read_text() == "seed: 1\n"
    written(tmp_path, 1, replace=True).close()
    assert not (tmp_path / "scenario.yaml").exists()


@pytest.mark.parametrize("torn", ["", "1", "1403638519492829443,0.1,0.2"])
def test_where_writing_fails_a_file_ends_with_its_last_whole_row(tmp_path, torn):
    """The row that did not fit is cut off, whatever of it the disk took."""
    writer = written(tmp_path, 2)
    samples = [ImuSample(T0 + k, np.ones(3), np.ones(3), T0 + k) for k in range(3)]
    for sample in samples[:2]:
        writer.imu(sample)
    path = tmp_path / "mav0/imu0/data.csv"
    whole = path.read_bytes()
    writer._files[path.relative_to(tmp_path)] = Full(path, torn)
    with pytest.raises(OSError, match=r"No space left on device: '.*imu0/data\.csv'"):
        writer.imu(samples[2])
    assert path.read_bytes() == whole
    assert len(FlightLog.open(tmp_path).imu) == 2
    writer.imu(samples[2])  # there is room again
    writer.close()
    assert len(FlightLog.open(tmp_path).imu) == 3


def test_a_file_whose_first_row_did_not_fit_is_none(tmp_path):
    writer = written(tmp_path, 2)
    path = tmp_path / "mav0/imu0/data.csv"
    path.parent.mkdir(parents=True)
    path.write_text("#timestamp [ns],w_x,w_y,w_z [rad/s],a_x,a_y,a_z [m/s^2],arrival_ns\n")
    writer._files[path.relative_to(tmp_path)] = Full(path, "12,")
    with pytest.raises(OSError, match="No space left"):
        writer.imu(ImuSample(T0, np.ones(3), np.ones(3), T0))
    assert not path.exists()
    assert FlightLog.open(tmp_path).imu is None


class Full:
    """A file on a disk that takes but the beginning of what is written."""

    def __init__(self, path, torn):
        self.path, self.torn = path, torn

    def write(self, text):
        with self.path.open("a") as file:
            file.write(self.torn)
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def close(self):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
