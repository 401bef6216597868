"""The live camera: stamps at mid-exposure, latest frame wins, gone and back, files as a camera."""

import threading
import time

import cv2
import numpy as np
import pytest
from fc_live import until

from tagvo.records import Frame
from vio.config.daemon import CameraConfig
from vio.errors import CameraLost, SourceError
from vio.sources.live import grab
from vio.sources.live.events import LiveEvents
from vio.sources.live.grab import Files, PiCamera, V4l2, folder_images, middle_ns, open_camera
from vio.sources.live.live_camera import Latest, LiveCamera

SIZE = (64, 48)
IMAGE = np.full((48, 64, 3), 90, np.uint8)


class Capture:
    """A cv2.VideoCapture whose driver stamps frames some ms ago; it can be pulled out."""

    def __init__(self, age_ms=12.0, exposure=40.0, image=IMAGE, clock=None):
        self.age_ms, self.exposure, self.image = age_ms, exposure, image
        self.clock = clock or (lambda: time.monotonic_ns() * 1e-6)
        self.plugged, self.closed, self.stamps = True, False, []

    def isOpened(self):
        return self.plugged

    def read(self):
        time.sleep(0.01)
        self.stamps.append(self.clock() - self.age_ms)
        return (True, self.image) if self.plugged else (False, None)

    def get(self, what):
        if what == cv2.CAP_PROP_POS_MSEC:
            return self.stamps[-1]
        height, width = self.image.shape[:2]
        return {cv2.CAP_PROP_EXPOSURE: self.exposure, cv2.CAP_PROP_FRAME_WIDTH: width,
                cv2.CAP_PROP_FRAME_HEIGHT: height}[what]  # fmt: skip

    def release(self):
        self.closed = True


def v4l2(capture, **keys):
    config = CameraConfig.model_validate({"readout_ms": 8.0, **keys})
    return V4l2(config, SIZE, lambda: capture)


@pytest.mark.parametrize(("stamp", "shift_ms"), [("start", 6.0), ("middle", 0.0), ("end", -6.0)])
def test_the_drivers_stamp_is_moved_to_mid_exposure(stamp, shift_ms):
    capture = Capture()
    shot = v4l2(capture, stamp=stamp).read()  # 4 ms exposure, 8 ms read-out
    assert shot.exact
    assert shot.t_ns == pytest.approx((capture.stamps[-1] + shift_ms) * 1e6, abs=2e3)


def test_mid_exposure_of_a_rolling_shutter_is_that_of_its_middle_row():
    exposure, readout, first = 4_000_000, 10_000_000, 500
    rows = [(first + readout * r // 48, first + readout * r // 48 + exposure) for r in range(49)]
    middle = sum(rows[24]) // 2
    assert middle_ns(rows[0][0], "start", exposure, readout) == middle
    assert middle_ns(rows[-1][1], "end", exposure, readout) == middle


def test_a_stamp_of_another_clock_is_replaced_by_the_arrival():
    capture = Capture(clock=lambda: time.time_ns() * 1e-6)
    before = time.monotonic_ns()
    shot = v4l2(capture).read()
    assert not shot.exact
    assert before - 6e6 <= shot.t_ns <= time.monotonic_ns() - 6e6


def test_images_that_waited_in_the_driver_are_passed_over():
    capture = Capture()
    ages = iter([3000.0, 2990.0, 12.0])
    capture.clock = lambda: time.monotonic_ns() * 1e-6 - next(ages) + 12.0
    shot = v4l2(capture, stamp="middle").read()
    assert len(capture.stamps) == 3
    assert time.monotonic_ns() - shot.t_ns < 1e9


def test_a_wrong_size_and_a_missing_device_are_one_line():
    with pytest.raises(SourceError, match="images of 32x24; the calibration is for 64x48"):
        v4l2(Capture(image=IMAGE[:24, :32])).read()
    with pytest.raises(CameraLost, match="/dev/video93: no such device; a V4L2"):
        open_camera(CameraConfig(device="/dev/video93"), SIZE, None)
    with pytest.raises(SourceError, match="picamera2"):
        PiCamera(CameraConfig(device="picamera2"), SIZE)


class Pi:
    """A picamera2 that gives a YUV420 picture with its metadata."""

    def __init__(self, number):
        self.number, self.request = number, self

    def create_video_configuration(self, **keys):
        self.setup = keys
        return keys

    def configure(self, setup):
        assert setup["main"] == {"size": SIZE, "format": "YUV420"}

    def start(self):
        self.running = True

    def capture_request(self):
        return self

    def get_metadata(self):
        boot = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        return {"SensorTimestamp": boot - 15_000_000, "ExposureTime": 6000}

    def make_array(self, name):
        return np.vstack([IMAGE[..., 0], np.zeros((24, 64), np.uint8)])

    def release(self):
        pass


def test_picamera2_stamps_come_into_the_monotonic_clock():
    camera = PiCamera(CameraConfig(device="picamera2:1", readout_ms=10.0), SIZE, Pi)
    shot = camera.read()
    assert time.monotonic_ns() - shot.t_ns == pytest.approx(13e6, abs=3e6)  # 15 + 3 - 5 ms ago
    assert shot.image.shape == (48, 64)


def test_the_newest_frame_wins_and_the_others_are_counted():
    latest = Latest()
    for t in range(5):
        latest.put(Frame(t))
    assert latest.take().t_ns == 4
    assert latest.dropped == 4
    threading.Timer(0.05, latest.close).start()
    assert latest.take() is None


def test_unplugged_and_back():
    captures = [Capture()]
    frames, said = [], []

    def plug():
        if not captures[-1].plugged:
            raise CameraLost("camera /dev/video0: no such device")
        return v4l2(captures[-1])

    camera = LiveCamera(plug, frames.append, lambda text, bad: said.append((text, bad)))
    camera.start()
    until(lambda: len(frames) > 5)
    captures[-1].plugged = False
    until(lambda: not camera.present)
    n = len(frames)
    time.sleep(0.5)
    assert len(frames) == n
    assert captures[0].closed
    captures.append(Capture())
    until(lambda: len(frames) > n + 5)
    camera.stop()
    assert camera.counters["camera_lost"] == camera.counters["camera_returned"] == 1
    assert said == [("camera lost", True), ("camera is back", False)]
    stamps = [f.t_ns for f in frames]
    assert stamps == sorted(set(stamps))
    assert frames[0].image.ndim == 2, "grey: what is recorded is what was looked at"


def write_images(folder, n=4):
    folder.mkdir()
    for i in range(n):
        cv2.imwrite(str(folder / f"{i * 5 + 8}.png"), np.full((48, 64), 10 * i, np.uint8))
    (folder / "10.png").write_bytes(b"no image")
    (folder / "notes.txt").write_text("no image either")
    return folder


def test_a_folder_is_a_camera_at_its_rate(tmp_path):
    write_images(tmp_path / "images")
    config = CameraConfig(device="images", rate_hz=100.0)
    camera = open_camera(config, SIZE, tmp_path)
    assert isinstance(camera, Files)
    start = time.monotonic_ns()
    shots = [camera.read() for _ in range(4)]
    assert [int(s.image[0, 0]) for s in shots] == [0, 10, 20, 30]
    assert np.diff([s.t_ns for s in shots]).tolist() == [10_000_000] * 3
    assert shots[0].t_ns >= start
    assert camera.read() is None
    again = open_camera(config.model_copy(update={"repeat": True}), SIZE, tmp_path)
    assert [int(again.read().image[0, 0]) for _ in range(6)] == [0, 10, 20, 30, 0, 10]


def test_a_video_is_a_camera(tmp_path):
    path = tmp_path / "flight.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, SIZE)
    for i in range(3):
        writer.write(np.full((48, 64, 3), 60 * i, np.uint8))
    writer.release()
    camera = open_camera(CameraConfig(device=str(path), rate_hz=200.0), SIZE, tmp_path)
    greys = [int(camera.read().image[20, 20]) for _ in range(3)]
    assert np.abs(np.array(greys) - [0, 60, 120]).max() < 6
    assert camera.read() is None


def test_a_folder_without_images_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(SourceError, match="no image there"):
        open_camera(CameraConfig(device="empty"), SIZE, tmp_path)
    with pytest.raises(SourceError, match="no such folder or file"):
        open_camera(CameraConfig(device="nowhere"), SIZE, tmp_path)
    assert list(folder_images(tmp_path / "empty")) == []


def test_events_keep_their_order_and_frames_go_first_where_it_is_full():
    clock = iter([5, 5, 5, 4, *range(10, 3000)])
    events = LiveEvents(lambda: False, lambda: next(clock))
    events.put(Frame(9))
    assert next(iter(events)).t_ns == 9  # the loop has begun
    for t in range(4):
        events.put(Frame(t))
    assert events.counters == {"queue_dropped_frames": 1}
    events.close()
    taken = list(events)
    assert [e.t_ns for e in taken] == [1, 2, 3]
    assert [e.arrival_ns for e in taken] == [7, 8, 10], "no two at one nanosecond"


def test_what_a_filter_starts_from_is_kept_until_the_loop_begins():
    """15 frames, half a second at 30 Hz: they come while compiled code is still loaded."""
    events = LiveEvents(lambda: False)
    for t in range(17):
        events.put(Frame(t))
    assert events.counters == {"queue_dropped_frames": 2}
    events.close()
    assert [e.t_ns for e in events] == list(range(2, 17))


def test_files_do_not_catch_up_after_a_stall(tmp_path, monkeypatch):
    """A reader away for 0.5 s: the next image is of now, and then each at its period again."""
    write_images(tmp_path / "images")
    config = CameraConfig(device="images", rate_hz=100.0, repeat=True)
    camera, now = open_camera(config, SIZE, tmp_path), [1_000_000_000]
    monkeypatch.setattr(grab.time, "monotonic_ns", lambda: now[0])
    monkeypatch.setattr(grab.time, "sleep", lambda s: now.append(now.pop() + round(s * 1e9)))
    before = [camera.read().t_ns for _ in range(2)]
    now[0] += 500_000_000
    after = [camera.read().t_ns for _ in range(3)]
    assert np.diff(before).tolist() == [10_000_000]
    assert after == [1_510_000_000 + k * 10_000_000 for k in range(3)]
