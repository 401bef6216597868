"""A flight log of our own, or any EuRoC folder, in the same terms as other people's logs."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from tagvo.camera.calibration import load_camera
from tagvo.camera.model import Camera
from tagvo.records import Frame
from vio.convert.records import Foreign, FrameReel
from vio.errors import LogError
from vio.sources.flight_log.arrivals import read_imu_of
from vio.sources.flight_log.files import read_truth
from vio.sources.flight_log.log_frames import FrameSource, open_frames
from vio.sources.flight_log.options import LogOptions
from vio.sources.flight_log.tally import Tally

_TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


def read_flight_log(path: Path, tally: Tally) -> Foreign:
    """All IMUs, truth, camera and frames that are there; LogError where none of it is."""
    names = sorted(p.parent.name for p in path.glob("mav0/*imu*/data.csv"))
    imus = {name: read_imu_of(path, name, tally) for name in names}
    truth = read_truth(path / _TRUTH, tally) if (path / _TRUTH).exists() else None
    camera = _camera(path)
    source = None if camera is None else _frames(path, camera, tally)
    if not imus and source is None:
        raise LogError(f"{path}: no log that we know: no mav0 with an IMU or a camera's frames")
    reel = None if source is None else FrameReel(len(source), partial(_readable, source))
    return Foreign(imus, truth=truth, camera=camera, frames=reel)


def _readable(source: FrameSource) -> Iterator[Frame]:
    for row in range(len(source)):
        frame = source.frame(row)
        if frame is not None:
            yield frame


def _camera(path: Path) -> Camera | None:
    files = [path / "camchain-imucam.yaml", path / "mav0/cam0/sensor.yaml"]
    file = next((p for p in files if p.exists()), None)
    return None if file is None else load_camera(file, "cam0")


def _frames(path: Path, camera: Camera, tally: Tally) -> FrameSource | None:
    folder = path / "mav0/cam0"
    if not ((folder / "data.csv").exists() or (folder / "detections.csv").exists()):
        return None
    options = LogOptions("imu0", False, None, 1, None, 0.0)
    return open_frames(folder, camera.resolution, options, None, tally)
