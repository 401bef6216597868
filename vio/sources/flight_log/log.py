"""Opens a flight log and offers what is in it as one stream of events, in order of arrival."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from tagvo.camera.calibration import load_camera
from tagvo.camera.model import Camera
from tagvo.geometry import IntArray
from tagvo.records import Frame
from tagvo.tags.tag_map import TagMap, load_map
from vio.errors import LogError
from vio.records import Ground, ImuNoise, ImuSample, ImuTrack, Phase, Truth
from vio.sources.flight_log.files import (
    read_ground,
    read_imu,
    read_imu_noise,
    read_phases,
    read_truth,
)
from vio.sources.flight_log.log_frames import FrameSource, open_frames
from vio.sources.flight_log.options import LogOptions, only_tags_of
from vio.sources.flight_log.tally import Tally

NEEDS = (
    "a flight log needs tagmap.yaml, camchain-imucam.yaml (or mav0/cam0/sensor.yaml) and"
    " mav0/cam0 with data.csv or detections.csv"
)
Event = ImuSample | Frame | Ground
T = TypeVar("T")
_GROUND = "mav0/vehicle0/data.csv"
_END_NS = 1_000_000_000  # a camera may start before its IMU, and end after it, by less
_CLOCKS_NS = 100_000_000  # what two clocks, and the middle of an exposure, may differ
_FARTHEST_M = 1e4  # of a vehicle from the middle of its flight: as far as a map's tags may lie
_TRUTH = "mav0/state_groundtruth_estimate0/data.csv"


@dataclass(frozen=True, slots=True, eq=False)
class FlightLog:
    """A flight log, opened and checked; images are read when their turn comes.

    imu, imu_noise, truth, config_path: None where the log has none; ground: empty there; t0_ns: the
    first IMU stamp, without IMU the first frame's: times for --skip and --blackout count from it.
    """

    path: Path
    tag_map: TagMap
    camera: Camera
    imu: ImuTrack | None
    imu_noise: ImuNoise | None
    truth: Truth | None
    phases: tuple[Phase, ...]
    ground: tuple[Ground, ...]
    config_path: Path | None
    t0_ns: int
    frames: FrameSource
    tally: Tally

    @staticmethod
    def open(
        path: Path,
        *,
        imu: str = "imu0",
        use_detections: bool = False,
        only_tags: Sequence[int] | None = None,
        every: int = 1,
        blackout: tuple[float, float] | None = None,
        latency_s: float = 0.0,
    ) -> "FlightLog":
        """Read all but the images; LogError (or tagvo's errors) in one line where it cannot be."""
        ids = only_tags_of(only_tags)
        options = LogOptions(imu, use_detections, ids, every, blackout, latency_s)
        camera_path = _check_folder(path)
        tally = Tally()
        tag_map = load_map(path / "tagmap.yaml")
        if ids is not None:
            tag_map = tag_map.only(np.array(ids, dtype=np.int64))
        camera = load_camera(camera_path, "cam0")
        track = _open_imu(path, imu, tally)
        t0_ns = None if track is None else int(track.t_ns[0])
        frames = open_frames(path / "mav0/cam0", camera.resolution, options, t0_ns, tally)
        log = FlightLog(
            path,
            tag_map,
            camera,
            track,
            _optional(path / "imu.yaml", lambda p: read_imu_noise(p, imu)),
            _optional(path / _TRUTH, lambda p: read_truth(p, tally)),
            _optional(path / "phases.csv", lambda p: read_phases(p, tally)) or (),
            _optional(path / _GROUND, lambda p: read_ground(p, tally)) or (),
            _optional(path / "config.yaml", lambda p: p),
            frames.first_ns if t0_ns is None else t0_ns,
            frames,
            tally,
        )
        _warn(log)
        return log

    @property
    def frame_count(self) -> int:
        """How many frames `events` will offer at most (an image may prove unreadable)."""
        return len(self.frames)

    @property
    def imu_count(self) -> int:
        """How many IMU samples `events` will offer."""
        return 0 if self.imu is None else len(self.imu)

    @property
    def end_ns(self) -> int:
        """The last stamp that any sensor of the log has."""
        last = [int(self.frames.t_ns.max())] if len(self.frames) else [self.t0_ns]
        return max([*last, int(self.imu.t_ns.max())] if self.imu is not None else last)

    @property
    def counters(self) -> dict[str, int]:
        """Faults met so far, by cause; grows while `events` reads images."""
        return self.tally.counters

    @property
    def warnings(self) -> list[str]:
        """What a person should know of this log, a line each; grows as `counters` does."""
        return self.tally.warnings

    def events(self) -> Iterator[Event]:
        """What the log holds in order of arrival, at equal times IMU first, then frames."""
        return (event for _, event in self._by(self.frames.arrival_ns))

    def as_received(self) -> Iterator[tuple[int, Event]]:
        """The same, with its times, for those who look for tags themselves: images as they came."""
        images = np.array([path is not None for path in self.frames.image_path], dtype=bool)
        return self._by(np.where(images, self.frames.received_ns, self.frames.arrival_ns))

    def _by(self, frame_ns: IntArray) -> Iterator[tuple[int, Event]]:
        n, frames = self.imu_count, len(self.frames)
        imu_ns = np.zeros(0, dtype=np.int64) if self.imu is None else self.imu.arrival_ns
        ground_ns = np.array([g.arrival_ns for g in self.ground], dtype=np.int64)
        times = np.concatenate([imu_ns, frame_ns, ground_ns])
        for i in np.argsort(times, kind="stable").tolist():  # stable: IMU rows stand first
            event: Event | None
            if i < n and self.imu is not None:
                event = self.imu.sample(i)
            elif i < n + frames:
                event = self.frames.frame(i - n)
            else:
                event = self.ground[i - n - frames]
            if event is not None:
                yield int(times[i]), event


def _check_folder(path: Path) -> Path:
    """The camera file of a log folder; LogError names all that is missing."""
    if not path.is_dir():
        what = "is a file" if path.exists() else "no such folder"
        raise LogError(f"{path}: {what}; {NEEDS}")
    cameras = [path / "camchain-imucam.yaml", path / "mav0/cam0/sensor.yaml"]
    camera = next((p for p in cameras if p.exists()), None)
    cam0 = path / "mav0/cam0"
    missing = [] if (path / "tagmap.yaml").exists() else ["tagmap.yaml"]
    if camera is None:
        missing.append("camchain-imucam.yaml")
    if not ((cam0 / "data.csv").exists() or (cam0 / "detections.csv").exists()):
        missing.append("mav0/cam0/data.csv")
    if camera is None or missing:
        raise LogError(f"{path}: no {', no '.join(missing)}; {NEEDS}")
    return camera


def _open_imu(path: Path, name: str, tally: Tally) -> ImuTrack | None:
    file = path / "mav0" / name / "data.csv"
    if file.exists():
        return read_imu(file, tally)
    there = sorted(p.parent.name for p in path.glob("mav0/*imu*/data.csv"))
    if name != "imu0":
        has = f"it has {', '.join(there)}" if there else "it has no IMU"
        raise LogError(f"{path}: no IMU {name!r} (mav0/{name}/data.csv); {has}")
    if there:
        tally.note(f"{path}: no mav0/imu0, so no IMU is used; --imu takes {', '.join(there)}")
    return None


def _optional(path: Path, read: Callable[[Path], T]) -> T | None:
    return read(path) if path.exists() else None


def _warn(log: FlightLog) -> None:
    """Note what is strange about a log as a whole."""
    t_ns, tally = log.frames.t_ns, log.tally
    for text in log.camera.notes:
        tally.note(text)
    if log.truth is not None and _apart(t_ns, log.truth.t_ns):
        tally.note(f"{log.path}: truth and frames do not overlap in time")
    _note_ends(log)
    _note_impossible(log)
    if log.imu is None:
        return
    if log.imu_noise is None:
        tally.note(f"{log.path}: no imu.yaml, so the noise of the IMU is not known")
    if _apart(t_ns, log.imu.t_ns):
        tally.note(f"{log.path}: IMU and frames do not overlap in time; are the clocks the same?")
    if not log.camera.p_CI.any() and np.array_equal(log.camera.R_CI, np.eye(3)):
        tally.note(f"{log.camera.source}: the camera's pose is that of the IMU; no T_cam_imu?")
    early = int(np.sum(t_ns < log.imu.t_ns.min()))
    tally.count("frame_before_imu", f"{log.path}: frames before the first IMU sample", early)


def _note_ends(log: FlightLog) -> None:
    """Note what begins later or ends earlier than another of IMU, frames and truth, in seconds."""
    shift_ns = round(log.camera.timeshift_s * 1e9)
    spans = {"frames": (log.frames.first_ns + shift_ns, log.frames.last_ns + shift_ns)}
    for name, track in (("IMU", log.imu), ("truth", log.truth)):
        if track is not None:
            spans[name] = int(track.t_ns.min()), int(track.t_ns.max())
    if any(a[0] > b[1] for a in spans.values() for b in spans.values()):
        return  # they do not overlap, which is said already
    for name, (first, last) in spans.items():
        if name == "frames" and "IMU" not in spans:
            continue
        other = "IMU sample" if name == "frames" else "frame"
        beside = spans["IMU" if name == "frames" else "frames"]
        late, early = first - beside[0], beside[1] - last
        if late > _END_NS:
            text = f"begin{'s' * (name != 'frames')} {1e-9 * late:.1f} s after the first {other}"
            log.tally.note(f"{log.path}: the {name} {text}")
        if early > _END_NS:
            text = f"end{'s' * (name != 'frames')} {1e-9 * early:.1f} s before the last {other}"
            log.tally.note(f"{log.path}: the {name} {text}")


def _note_impossible(log: FlightLog) -> None:
    """Count what cannot be: known before it was captured, truth that leaps away."""
    shift_ns = round(log.camera.timeshift_s * 1e9)
    early = int(np.sum(log.frames.arrival_ns < log.frames.t_ns + shift_ns - _CLOCKS_NS))
    text = f"{log.path}: frames known before their own capture; is arrival_ns in the IMU's clock?"
    log.tally.count("frame_arrival_before_capture", text, early)
    if log.imu is not None:
        early = int(np.sum(log.imu.arrival_ns < log.imu.t_ns - _CLOCKS_NS))
        text = f"{log.path}: IMU samples known before their own stamp; is arrival_ns in its clock?"
        log.tally.count("imu_arrival_before_stamp", text, early)
    if log.truth is not None:
        p_W = log.truth.p_WI
        far = np.linalg.norm(p_W - np.median(p_W, axis=0), axis=-1) > _FARTHEST_M
        text = f"{log.path}: truth more than {_FARTHEST_M:g} m from its median, and judged by"
        log.tally.count("truth_far", text, int(far.sum()))


def _apart(a_ns: IntArray, b_ns: IntArray) -> bool:
    both = len(a_ns) > 0 and len(b_ns) > 0
    return both and bool(a_ns.max() < b_ns.min() or b_ns.max() < a_ns.min())
