"""Writes a flight log, row by row while it flies, in the layout that `FlightLog` opens."""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Literal, TextIO

import numpy as np
import yaml

from tagvo.camera.calibration import save_camera
from tagvo.camera.model import Camera
from tagvo.geometry import Array
from tagvo.records import Detections, Frame
from tagvo.tags.tag_map import TagMap, save_map
from tagvo.textfile import write_atomic
from vio.errors import LogError
from vio.records import Ground, ImuNoise, ImuSample, Phase

_CAM = Path("mav0/cam0")
_TRUTH = Path("mav0/state_groundtruth_estimate0/data.csv")
_CORNERS = ",".join(f"{axis}_{corner}" for corner in ("tl", "tr", "br", "bl") for axis in "uv")
_SIGMAS = ",".join(f"sigma_{corner}" for corner in ("tl", "tr", "br", "bl"))
_HEADERS = {
    "frames": "#timestamp [ns],filename,arrival_ns,received_ns",
    "detections": f"#timestamp [ns],tag_id,{_CORNERS},hamming,decision_margin,{_SIGMAS}",
    "imu": "#timestamp [ns],w_x,w_y,w_z [rad/s],a_x,a_y,a_z [m/s^2],arrival_ns,mean",
    "imu_noted": "#timestamp [ns],w_x,w_y,w_z [rad/s],a_x,a_y,a_z [m/s^2],arrival [ns],mean",
    "ground": "#timestamp [ns],on_ground",
    "truth": "#timestamp [ns],p_x,p_y,p_z [m],q_w,q_x,q_y,q_z,v_x,v_y,v_z [m/s]",
    "truth_biases": "#timestamp [ns],p_x,p_y,p_z [m],q_w,q_x,q_y,q_z,v_x,v_y,v_z [m/s],"
    "bg_x,bg_y,bg_z [rad/s],ba_x,ba_y,ba_z [m/s^2]",
}
_FILE_MODE, _FOLDER_MODE = 0o640, 0o750  # a flight shows where and what: not for everybody
_TAIL_BYTES = 1 << 20  # longer than any row
_NOTES = ("scenario.yaml", "truth_rig.yaml")  # of a simulated log; nothing reads them in a run
_LAYOUT = (  # all that a log may hold: what `replace` removes
    "tagmap.yaml", "camchain-imucam.yaml", "imu.yaml", "config.yaml", "phases.csv", *_NOTES,
    "mav0/*/data.csv", "mav0/*/sensor.yaml", "mav0/cam0/detections.csv", "mav0/cam0/data/*.png",
    "flown/*",
)  # fmt: skip


class LogWriter:
    """Owns the files of one log; a file exists from its first row on, and every row is whole.

    A crash of the program loses nothing that was written; `sync` (and `close`) also survive a
    power cut. Where the disk is full a file ends with its last whole row (and OSError names it).
    Times are integer ns as in the contracts: frames in the camera's clock.
    """

    def __init__(self, path: Path, *, replace: bool = False) -> None:
        """path: made where missing; LogError where it holds a log, unless that is to be replaced.

        replace: remove the files of the log that is there, and nothing else; links that lead out of
        it are not followed: LogError where a folder of the log is one.
        """
        self.path = path
        self._files: dict[Path, TextIO] = {}
        there = [f for pattern in _LAYOUT for f in path.glob(pattern) if _is_own(f, path)]
        if there and not replace:
            raise LogError(f"{path}: holds a log already ({there[0].name}); name another folder")
        self._refuse_linked_folders()
        for file in there:
            file.unlink()
        make_private_folder(path)

    def _refuse_linked_folders(self) -> None:
        """A folder of the log that is a link would take elsewhere what is written and replaced."""
        for one in (self.path / "mav0", *self.path.glob("mav0/*"), self.path / _CAM / "data",
                    self.path / "flown"):  # fmt: skip
            if one.is_symlink() and one.is_dir():
                raise LogError(f"{one}: is a link to {one.resolve()}; a folder of the log's own is"
                               " needed, remove the link")  # fmt: skip

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def setup(
        self,
        tag_map: TagMap | None,
        camera: Camera | None,
        noise: ImuNoise | None = None,
        config_text: str | None = None,
    ) -> None:
        """Write what holds for the whole log: map, calibration, IMU noise, configuration.

        A run needs map and calibration; a log without them waits for its owner to add them.
        """
        if tag_map is not None:
            save_map(tag_map, self.path / "tagmap.yaml")
        if camera is not None:
            save_camera(camera, self.path / "camchain-imucam.yaml")
        if noise is not None:
            write_atomic(self.path / "imu.yaml", _noise_yaml(noise))
        if config_text is not None:
            write_atomic(self.path / "config.yaml", config_text)

    def frame(self, frame: Frame) -> None:
        """A row for the frame; its image as PNG and its detections, where it has them."""
        name = "" if frame.image is None else f"{frame.t_ns}.png"
        if frame.image is not None:
            _write_png(self.path / _CAM / "data" / name, frame.image)
        if frame.detections is not None:
            self._tags(frame.t_ns, frame.detections)
        arrival = frame.t_ns if frame.arrival_ns is None else frame.arrival_ns
        received = arrival if frame.received_ns is None else frame.received_ns
        self._row(_CAM / "data.csv", "frames", f"{frame.t_ns},{name},{arrival},{received}")

    def imu(self, sample: ImuSample, name: str = "imu0", noted_ns: int | None = None) -> None:
        """A row for an IMU sample in mav0/NAME; noted_ns: its arrival in another clock, if so."""
        values = _exact([*sample.gyro_I, *sample.accel_I])
        known_ns = sample.arrival_ns if noted_ns is None else noted_ns
        row = f"{sample.t_ns},{values},{known_ns},{int(sample.mean)}"
        kind = "imu" if noted_ns is None else "imu_noted"
        self._row(Path("mav0") / name / "data.csv", kind, row)

    def ground(self, ground: Ground) -> None:
        """A row for a change between ground and air."""
        row = f"{ground.arrival_ns},{int(ground.on_ground)}"
        self._row(Path("mav0/vehicle0/data.csv"), "ground", row)

    def truth(
        self, t_ns: int, p_WI: Array, q_WI: Array, v_WI: Array, biases: Array | None = None
    ) -> None:
        """A row of truth; p (3,) [m], q (4,) wxyz, v (3,) [m/s].

        biases (6,): of gyro [rad/s] and accelerometer [m/s^2]; in each row of a log or in none.
        """
        row = f"{t_ns},{_numbers(p_WI, 9)},{_numbers(q_WI, 12)},{_numbers(v_WI, 9)}"
        if biases is None:
            self._row(_TRUTH, "truth", row)
        else:
            self._row(_TRUTH, "truth_biases", f"{row},{_numbers(biases, 12)}")

    def note(self, name: str, text: str) -> None:
        """A file for people beside the log's own: scenario.yaml or truth_rig.yaml."""
        if name not in _NOTES:
            raise ValueError(f"{name} is no note of a log: {', '.join(_NOTES)}")
        write_atomic(self.path / name, text)

    def phases(self, phases: tuple[Phase, ...]) -> None:
        """The named parts of the flight, all at once."""
        rows = [f"{p.name},{p.t_start_ns},{p.t_end_ns}" for p in phases]
        write_atomic(
            self.path / "phases.csv", "\n".join(["name,t_start_ns,t_end_ns", *rows]) + "\n"
        )

    def line(self, name: str, row: str, header: str | None = None) -> None:
        """A line of a file of the caller's own below the log; header: the first line."""
        self._append(Path(name), header, row)

    def sync(self) -> None:
        """Bring every row written so far to the disk itself."""
        for file in self._files.values():
            file.flush()
            os.fsync(file.fileno())

    def close(self) -> None:
        """Sync and close; rows written afterwards open their files again."""
        with ExitStack() as files:
            for name in list(self._files):
                files.callback(self._close, name)

    def _close(self, name: Path) -> None:
        with self._whole(name):
            self._files[name].flush()
            os.fsync(self._files[name].fileno())
            self._files.pop(name).close()

    def _tags(self, t_ns: int, found: Detections) -> None:
        """The rows of one frame, all in one write."""
        rows = [
            f"{t_ns},{found.tag_id[i]},{_exact(found.corners_px[i].ravel())},"
            f"{found.hamming[i]},{_exact([found.margin[i]])},{_exact(found.sigma_px[i])}"
            for i in range(len(found))
        ]
        if rows:
            self._row(_CAM / "detections.csv", "detections", "\n".join(rows))

    def _row(self, name: Path, kind: str, row: str) -> None:
        self._append(name, _HEADERS[kind], row)

    def _append(self, name: Path, header: str | None, row: str) -> None:
        """Append a row to a file below the log, opened (with its header) where it is not yet."""
        file = self._files.get(name)
        if file is None:
            path = self.path / name
            make_private_folder(path.parent)
            fresh = not path.exists()
            file = self._files[name] = opened_private(path, "a")
            row = f"{header}\n{row}" if fresh and header is not None else row
        with self._whole(name):
            file.write(row + "\n")

    @contextmanager
    def _whole(self, name: Path) -> Iterator[None]:
        """Where writing a file fails, close it, cut off its torn last row, and name it."""
        try:
            yield
        except OSError as err:
            with suppress(OSError, KeyError):
                self._files.pop(name).close()
            _cut(self.path / name)
            raise OSError(err.errno, err.strerror, str(self.path / name)) from None


def opened_private(path: Path, mode: Literal["a", "w"]) -> TextIO:
    """A text file opened for writing (w, a) that others than owner and group cannot read."""

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags, _FILE_MODE)

    return open(path, mode, encoding="utf-8", buffering=1, opener=opener)


def make_private_folder(path: Path) -> None:
    """Make a folder, and those above that are missing, closed to others; what is there stays."""
    for one in [*reversed(path.parents), path]:
        if not one.exists():
            one.mkdir(mode=_FOLDER_MODE, exist_ok=True)


def _is_own(file: Path, root: Path) -> bool:
    """Whether a file is the log's own: no folder on the way to it below root is a link.

    A link itself is one too: it goes, what it leads to stays.
    """
    above = [one for one in file.parents if one.is_relative_to(root) and one != root]
    return not any(one.is_symlink() for one in above)


def _cut(path: Path) -> None:
    """Take away what stands after the last end of a line; a file without a row is none.

    Only of a regular file, and read from its end: a recording may be as large as the disk.
    """
    if not path.is_file():
        return
    with suppress(OSError):
        with path.open("rb") as file:
            start = max(0, path.stat().st_size - _TAIL_BYTES)
            file.seek(start)
            tail = file.read(_TAIL_BYTES)
        if start == 0 and tail.count(b"\n") < 2:
            path.unlink()
        elif b"\n" in tail:
            os.truncate(path, start + tail.rfind(b"\n") + 1)


def _numbers(values: "Array | list[float]", digits: int) -> str:
    return ",".join(f"{float(value):.{digits}f}" for value in values)


def _exact(values: "Array | list[float]") -> str:
    """As few digits as give the same number again; blank where it is not known."""
    numbers = np.asarray(values, dtype=float).tolist()
    return ",".join("" if value != value else repr(value) for value in numbers)


def _write_png(path: Path, image: "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]") -> None:
    """A grey or BGR image as PNG; the name appears when the file is whole."""
    import cv2

    done, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise LogError(f"{path}: an image of shape {image.shape} cannot be written as PNG")
    make_private_folder(path.parent)
    temporary = path.with_suffix(".tmp")
    try:
        with open(temporary, "wb", opener=lambda n, flags: os.open(n, flags, _FILE_MODE)) as file:
            file.write(data.tobytes())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def _noise_yaml(noise: ImuNoise) -> str:
    block: dict[str, object] = {"rostopic": "/imu0"}
    if noise.rate_hz is not None:
        block["update_rate"] = noise.rate_hz
    block |= {
        "accelerometer_noise_density": noise.accel_density,
        "accelerometer_random_walk": noise.accel_walk,
        "gyroscope_noise_density": noise.gyro_density,
        "gyroscope_random_walk": noise.gyro_walk,
    }
    return yaml.safe_dump(block, sort_keys=False)
