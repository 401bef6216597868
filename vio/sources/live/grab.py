"""Images and their stamps from where they come: V4L2, picamera2, a folder or a video file.

Every stamp is the middle of the exposure in `time.monotonic_ns`, as well as the driver allows.
"""

import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from vio.config.daemon import CameraConfig
from vio.errors import CameraLost, SourceError
from vio.sources.flight_log.log_frames import read_image

Image = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]
_OLDEST_NS = 1_000_000_000  # an image that waited longer is not worth looking at
_FOREIGN_NS = 60_000_000_000  # a stamp further in the past, or in the future, is of another clock
_STALE = 16  # images of a filled driver queue that are passed over at most
_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".pgm", ".tif", ".tiff"}
_READ_TIMEOUT_MS = 700
_ALLOWED = (
    "a V4L2 device (/dev/video0 or 0), picamera2 (or picamera2:1), a folder of images or a video"
    " file is needed"
)


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """An image and the middle of its exposure [ns, monotonic]; exact: the driver's own stamp."""

    image: Image
    t_ns: int
    exact: bool = True


class Grabber(Protocol):
    """An open camera."""

    def read(self) -> Shot | None:
        """The next image; None: there are no more. CameraLost where the camera has gone."""

    def close(self) -> None:
        """Give the camera back."""


def middle_ns(stamp_ns: int, kind: str, exposure_ns: int, readout_ns: int) -> int:
    """Middle of the exposure of the middle row from a driver's stamp.

    kind: start (of the first row's exposure), end (of the last row's read-out), middle. Rows are
    read one after another within readout_ns; 0 is a global shutter.
    """
    if kind == "start":
        return stamp_ns + (exposure_ns + readout_ns) // 2
    return stamp_ns if kind == "middle" else stamp_ns - (exposure_ns + readout_ns) // 2


def open_camera(config: CameraConfig, size: tuple[int, int], where: Path) -> Grabber:
    """Open what `device` names, for images of this size; relative paths start at `where`.

    SourceError where it names nothing that can be a camera, or the images have another size.
    """
    device = config.device
    if re.fullmatch(r"picamera2(:\d+)?", device):
        return PiCamera(config, size)
    if re.fullmatch(r"\d+|/dev/.+", device):
        return V4l2(config, size)
    path = where / Path(device).expanduser()
    if path.is_dir():
        return Files(config, size, lambda: folder_images(path), f"camera {path}")
    if path.is_file():
        return Files(config, size, lambda: video_images(path), f"camera {path}")
    raise SourceError(f"daemon.camera.device {device}: no such folder or file; {_ALLOWED}")


def check_size(image: Image, size: tuple[int, int], where: str) -> None:
    """SourceError where the image is not of the calibration's size (width, height)."""
    height, width = image.shape[:2]
    if (width, height) != size:
        raise SourceError(
            f"{where}: images of {width}x{height}; the calibration is for {size[0]}x{size[1]}"
        )


class V4l2:
    """A camera of the kernel through OpenCV, which hands the driver's stamp on.

    UVC drivers stamp the start of the exposure, others as a rule the end of the frame; `stamp`
    says otherwise. A stamp that is not of the last second (another clock) is replaced by the
    arrival, as the end of a frame. What remains is constant: the filter's time offset takes it.
    """

    def __init__(
        self, config: CameraConfig, size: tuple[int, int], make: Callable[[], Any] | None = None
    ) -> None:
        """make: gives the cv2.VideoCapture; None: OpenCV's own."""
        self._where = f"camera {config.device}"
        self._config, self._size = config, size
        self._capture = _capture(config, size) if make is None else make()
        if not self._capture.isOpened():
            self.close()
            raise CameraLost(f"{self._where}: {_why_closed(config.device)}; {_ALLOWED}")
        _check_mode(self._capture, size, self._where)
        driver = _driver(config.device)
        self._kind = config.stamp
        if self._kind == "auto":
            self._kind = "start" if driver == "uvcvideo" else "end"
        rate = config.rate_hz
        readout = 0.0 if config.stamp == "middle" else 0.8e3 / rate
        self._readout_ns = round(
            1e6 * (readout if config.readout_ms is None else config.readout_ms)
        )

    def read(self) -> Shot | None:
        import cv2

        for _ in range(_STALE):
            done, image = self._capture.read()
            arrival = time.monotonic_ns()
            if not done or image is None:
                raise CameraLost(f"{self._where}: no image")
            stamp = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
            if not _OLDEST_NS < arrival - stamp < _FOREIGN_NS:
                break
        else:
            raise CameraLost(f"{self._where}: only old images")
        check_size(image, self._size, self._where)
        exposure = self._exposure_ns(self._capture.get(cv2.CAP_PROP_EXPOSURE))
        if 0 <= arrival - stamp <= _OLDEST_NS:
            return Shot(image, middle_ns(stamp, self._kind, exposure, self._readout_ns))
        return Shot(image, middle_ns(arrival, "end", exposure, self._readout_ns), exact=False)

    def _exposure_ns(self, told: float) -> int:
        """Of V4L2_CID_EXPOSURE_ABSOLUTE [100 us], held to the frame's period."""
        if self._config.exposure_ms is not None:
            return round(self._config.exposure_ms * 1e6)
        return round(min(max(told, 0.0) * 1e5, 1e9 / self._config.rate_hz))

    def close(self) -> None:
        self._capture.release()


def _capture(config: CameraConfig, size: tuple[int, int]) -> Any:
    import cv2

    name: Any = int(config.device) if config.device.isdigit() else config.device
    code = config.pixel_format
    wanted = [
        (cv2.CAP_PROP_FRAME_WIDTH, size[0]),
        (cv2.CAP_PROP_FRAME_HEIGHT, size[1]),
        (cv2.CAP_PROP_FPS, config.rate_hz),
        (cv2.CAP_PROP_BUFFERSIZE, 2),
    ]
    capture = cv2.VideoCapture(
        name, cv2.CAP_V4L2, [cv2.CAP_PROP_READ_TIMEOUT_MSEC, _READ_TIMEOUT_MS]
    )
    if not capture.isOpened():  # a build of OpenCV that does not know the timeout
        capture = cv2.VideoCapture(name, cv2.CAP_V4L2)
    if code is not None:
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*code))
    for what, value in wanted:
        capture.set(what, value)
    if config.exposure_ms is not None:
        capture.set(cv2.CAP_PROP_AUTO_EXPOSURE, 1)  # V4L2_EXPOSURE_MANUAL
        capture.set(cv2.CAP_PROP_EXPOSURE, round(config.exposure_ms * 10.0))
    return capture


def _check_mode(capture: Any, size: tuple[int, int], where: str) -> None:
    """SourceError where the driver has not taken the size that was asked for."""
    import cv2

    told = capture.get(cv2.CAP_PROP_FRAME_WIDTH), capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
    width, height = (round(x) for x in told)
    if width > 0 and (width, height) != size:
        raise SourceError(
            f"{where}: images of {width}x{height}; the calibration is for {size[0]}x{size[1]}"
        )


def _device_path(device: str) -> Path:
    return Path(f"/dev/video{device}" if device.isdigit() else device)


def _driver(device: str) -> str:
    """Name of the kernel's driver of a device, or an empty text."""
    name = _device_path(device).resolve().name
    try:
        return Path(f"/sys/class/video4linux/{name}/device/driver").resolve(strict=True).name
    except OSError:
        return ""


def _why_closed(device: str) -> str:
    path = _device_path(device)
    if not path.exists():
        return "no such device"
    try:
        with path.open("rb"):
            return "it gives no video"
    except OSError as err:
        return err.strerror or str(err)


class PiCamera:
    """A camera of a Raspberry Pi through picamera2 (of the system, not of PyPI).

    libcamera stamps the moment at which the first row's read-out begins: the end of that row's
    exposure, in the clock that also runs while the computer sleeps.
    """

    def __init__(
        self, config: CameraConfig, size: tuple[int, int], make: Callable[[int], Any] | None = None
    ) -> None:
        """make: gives the Picamera2 of a number; None: picamera2's own."""
        number = int(config.device.partition(":")[2] or 0)
        self._where = f"camera {config.device}"
        self._size, self._stamp = size, config.stamp
        readout = 0.0 if config.readout_ms is None else config.readout_ms
        self._readout_ns = round(readout * 1e6)
        try:
            self._camera = (make or _picamera2)(number)
            controls: dict[str, Any] = {"FrameRate": config.rate_hz}
            if config.exposure_ms is not None:
                controls |= {"ExposureTime": round(config.exposure_ms * 1e3), "AeEnable": False}
            setup = self._camera.create_video_configuration(
                main={"size": size, "format": "YUV420"}, controls=controls, buffer_count=3
            )
            self._camera.configure(setup)
            self._camera.start()
        except (RuntimeError, IndexError, OSError) as err:
            raise CameraLost(f"{self._where}: {err}; {_ALLOWED}") from None

    def read(self) -> Shot | None:
        try:
            request = self._camera.capture_request()
            try:
                data = request.get_metadata()
                plane = request.make_array("main")
            finally:
                request.release()
        except (RuntimeError, OSError, TimeoutError) as err:
            raise CameraLost(f"{self._where}: {err}") from None
        image = np.ascontiguousarray(plane[: self._size[1], : self._size[0]])  # Y of YUV420
        check_size(image, self._size, self._where)
        to_monotonic = time.monotonic_ns() - time.clock_gettime_ns(time.CLOCK_BOOTTIME)
        stamp = int(data["SensorTimestamp"]) + to_monotonic
        exposure = int(data.get("ExposureTime", 0)) * 1000
        if self._stamp == "auto":  # first row's exposure ends at the stamp
            return Shot(image, stamp - exposure // 2 + self._readout_ns // 2)
        return Shot(image, middle_ns(stamp, self._stamp, exposure, self._readout_ns))

    def close(self) -> None:
        self._camera.stop()
        self._camera.close()


def _picamera2(number: int) -> Any:
    try:
        from picamera2 import Picamera2
    except ImportError:
        raise SourceError(
            "daemon.camera.device picamera2: the package picamera2 cannot be imported; install it"
            " with apt (python3-picamera2) and make the environment with --system-site-packages"
        ) from None
    return Picamera2(number)


class Files:
    """Images of files as if a camera took them now, at the configured rate."""

    def __init__(
        self,
        config: CameraConfig,
        size: tuple[int, int],
        images: Callable[[], Iterator[Image]],
        where: str,
    ) -> None:
        self._again, self._repeat = images, config.repeat
        self._size, self._where = size, where
        self._period_ns = round(1e9 / config.rate_hz)
        self._images = images()
        self._next: Image | None = next(self._images, None)
        if self._next is None:
            raise SourceError(f"{where}: no image there; {_ALLOWED}")
        check_size(self._next, size, where)
        self._due_ns: int | None = None

    def read(self) -> Shot | None:
        image = self._next
        if image is None:
            return None
        check_size(image, self._size, self._where)
        now = time.monotonic_ns()
        due = now if self._due_ns is None else self._due_ns
        time.sleep(max(0, due - now) * 1e-9)
        if now - due > self._period_ns:  # whoever reads has been away: do not catch up
            due = now
        self._due_ns = due + self._period_ns
        self._next = next(self._images, None)
        if self._next is None and self._repeat:
            self._images = self._again()
            self._next = next(self._images, None)
        return Shot(image, due)

    def close(self) -> None:
        self._next = None


def folder_images(folder: Path) -> Iterator[Image]:
    """Grey images of a folder by number, else by name; what is no image is passed over."""
    paths = [p for p in folder.iterdir() if p.suffix.lower() in _PICTURES]
    for path in sorted(paths, key=lambda p: (int(p.stem) if p.stem.isdigit() else -1, p.name)):
        image = read_image(path)
        if image is not None:
            yield image


def video_images(path: Path) -> Iterator[Image]:
    """Grey images of a video file."""
    import cv2

    capture = cv2.VideoCapture(str(path))
    try:
        while True:
            done, image = capture.read()
            if not done:
                return
            grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
            yield np.asarray(grey, dtype=np.uint8)
    finally:
        capture.release()
