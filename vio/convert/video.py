"""A video file with its stamps, IMU and truth in CSV files beside it."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from tagvo.geometry import IntArray
from tagvo.records import Frame
from vio.convert.records import Foreign, FrameReel
from vio.errors import LogError
from vio.sources.flight_log.columns import Layout
from vio.sources.flight_log.csv_table import read_table
from vio.sources.flight_log.tally import Tally

STAMPS = Layout("stamps", "timestamp [ns] of each frame, in its order", ("t_ns",), ("t_ns",))

_FRAME_BYTES = 8  # the header of a chunk: no frame of any container takes less


def read_video(path: Path, stamps: Path | None, tally: Tally) -> Foreign:
    """Frames of a video, grey, at the stamps of a CSV file or, without one, at the file's rate.

    LogError where it is no video, or has another number of frames than there are stamps.
    """
    total, rate = _measure(path)
    if stamps is None:
        if not rate > 0.0:
            raise LogError(f"{path}: the video does not say its rate; --stamps FILE is needed")
        t_ns = np.rint(np.arange(total) * 1e9 / rate).astype(np.int64)
        notes: tuple[str, ...] = (
            f"{path}: no --stamps, so frames are at 0 s, {1.0 / rate:.4f} s, ...: a video's rate"
            " is nominal, and no IMU will fit it",
        )
    else:
        t_ns, notes = read_table(stamps, STAMPS, tally).ints["t_ns"], ()
        if total and abs(total - len(t_ns)) > 1:
            raise LogError(
                f"{stamps}: {len(t_ns)} stamps, {path} has {total} frames; one a frame is needed"
            )
    return Foreign(frames=FrameReel(len(t_ns), lambda: _frames(path, t_ns, tally)), notes=notes)


def _measure(path: Path) -> tuple[int, float]:
    video = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise LogError(f"{path}: not a video that OpenCV can read")
        count, rate = video.get(cv2.CAP_PROP_FRAME_COUNT), video.get(cv2.CAP_PROP_FPS)
        most = path.stat().st_size // _FRAME_BYTES  # a header may claim any number
        return min(max(0, int(count)), most), float(rate)
    finally:
        video.release()


def _frames(path: Path, t_ns: IntArray, tally: Tally) -> Iterator[Frame]:
    video = cv2.VideoCapture(str(path))
    try:
        for i, stamp in enumerate(t_ns.tolist()):
            try:
                there, image = video.read()
            except cv2.error:  # a damaged place; what it says is for programmers
                there, image = False, None
            if not there or image is None:
                missing = len(t_ns) - i
                tally.count("video_short", f"{path}: no image for these stamps", missing)
                return
            grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
            yield Frame(stamp, np.asarray(grey, dtype=np.uint8))
    finally:
        video.release()
