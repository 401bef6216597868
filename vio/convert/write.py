"""Writes what was read from another system: a flight log, a ROS 2 bag, a trajectory."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from heapq import merge
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vio.convert.records import Foreign
from vio.errors import LogError

if TYPE_CHECKING:
    from tagvo.camera.model import Camera
    from tagvo.records import Frame
    from tagvo.tags.tag_map import TagMap
    from vio.records import ImuNoise
    from vio.sources.flight_log.tally import Tally

Step = Callable[[], None]
Stop = Callable[[], bool]
Row = tuple[int, int, Any]  # time, what it is, the thing
_IMU, _TRUTH, _FRAME = 0, 1, 2
Files = tuple[Path | None, Path | None, Path | None]  # of map, camera, IMU noise


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """What a flight log holds beside its rows; None where nobody knows."""

    tag_map: "TagMap | None"
    camera: "Camera | None"
    noise: "ImuNoise | None"


@dataclass(frozen=True, slots=True)
class Written:
    """What was written: in words, and how many frames."""

    text: str
    frames: int


def read_rig(found: Foreign, files: Files, tally: "Tally") -> Rig:
    """The rig of the files named, else what the log itself says; doubts go to the tally."""
    from tagvo.camera.calibration import load_camera
    from tagvo.maps.formats import read_map_file
    from vio.sources.flight_log.files import read_imu_noise

    map_file, camera_file, noise_file = files
    camera = found.camera
    if camera_file is not None:
        camera = load_camera(camera_file, topic=found.image_topic)
    for text in () if camera is None else camera.notes:
        tally.note(text)
    if camera is not None and found.rectified and camera.coeffs.any():
        tally.note(f"{camera.source}: its distortion is of raw images, and these are taken for"
                   " rectified; without --camera the P of camera_info is taken; --rectified no"
                   " says that they are raw")  # fmt: skip
    imported = None if map_file is None else read_map_file(map_file)
    for text in () if imported is None else imported.notes:
        tally.note(f"{map_file}: {text}")
    return Rig(
        None if imported is None else imported.tag_map,
        camera,
        None if noise_file is None else read_imu_noise(noise_file, "imu0"),
    )


def write_flight_log(
    out: Path, found: Foreign, rig: Rig, step: Step, stop: Stop, *, replace: bool = False
) -> Written:
    """A flight log of what was found; what it holds and what `tagvio run` still lacks, in words."""
    from vio.sinks.log_writer import LogWriter

    tag_map, camera, noise = rig.tag_map, rig.camera, rig.noise
    done = 0
    with LogWriter(out, replace=replace) as writer:
        writer.setup(tag_map, camera, noise)
        for name, track in found.imus.items():
            noted = found.noted_ns.get(name)
            for row in range(len(track)):
                noted_ns = None if noted is None else int(noted[row])
                writer.imu(track.sample(row), name, noted_ns)
        truth = found.truth
        if truth is not None:
            v = np.full((len(truth), 3), np.nan) if truth.v_WI is None else truth.v_WI
            for row in range(len(truth)):
                writer.truth(int(truth.t_ns[row]), truth.p_WI[row], truth.q_WI[row], v[row])
        for frame in _frames(found, stop):
            writer.frame(frame)
            step()
            done += 1
    lacks = [
        what
        for what, has in (
            ("a tag map (--map)", tag_map),
            ("a calibration (--camera)", camera),
            ("frames", done or None),
        )
        if has is None
    ]
    words = _held(found, done)
    text = f"{words}; for tagvio run it lacks {', '.join(lacks)}" if lacks else words
    return Written(text, done)


def write_bag(out: Path, found: Foreign, step: Step, stop: Stop) -> Written:
    """A ROS 2 bag (MCAP), in the order in which things arrived."""
    from vio.convert.bag_writer import BagWriter

    done = 0
    truth = found.truth
    with BagWriter(out) as bag:
        for _, kind, item in merge(*_rows(found), _stamped(found, stop), key=lambda r: r[:2]):
            if kind == _IMU:
                name, sample = item
                bag.imu(sample, name)
            elif kind == _TRUTH and truth is not None:
                bag.truth(truth, item)
            else:
                bag.frame(item, found.camera)
                step()
                done += 1
    return Written(_held(found, done), done)


def write_truth(out: Path, found: Foreign) -> Written:
    """The truth as a TUM trajectory; LogError where there is none."""
    from vio.sinks.tum import write_tum

    if found.truth is None:
        raise LogError(f"{out}: a .tum holds the truth, and none was found")
    write_tum(out, found.truth.t_ns, found.truth.p_WI, found.truth.q_WI)
    return Written(f"{len(found.truth)} poses", 0)


def _frames(found: Foreign, stop: Stop) -> "Iterator[Frame]":
    if found.frames is not None:
        for frame in found.frames.open():
            yield frame
            if stop():
                return


def _rows(found: Foreign) -> Iterator[Iterator[Row]]:
    """IMU samples at their arrival and truth at its stamps, each in order of time."""
    for name, track in found.imus.items():
        order = np.argsort(track.arrival_ns, kind="stable").tolist()
        yield iter([(int(track.arrival_ns[i]), _IMU, (name, track.sample(i))) for i in order])
    if found.truth is not None:
        yield iter([(t_ns, _TRUTH, row) for row, t_ns in enumerate(found.truth.t_ns.tolist())])


def _stamped(found: Foreign, stop: Stop) -> Iterator[Row]:
    for frame in _frames(found, stop):
        yield (frame.t_ns if frame.arrival_ns is None else frame.arrival_ns), _FRAME, frame


def _held(found: Foreign, frames: int) -> str:
    parts = [f"{name} {len(track)} samples" for name, track in found.imus.items()]
    parts += [f"truth {len(found.truth)} rows"] if found.truth is not None else []
    parts += [f"{frames} frames"] if found.frames is not None else []
    return ", ".join(parts)
