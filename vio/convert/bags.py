"""ROS 1 bags, ROS 2 bags (sqlite3, MCAP) by rosbags, without a ROS installation."""

import sqlite3
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tagvo.camera.calibration import camera_of
from tagvo.camera.model import Camera
from tagvo.errors import shown
from tagvo.geometry import Array, IntArray
from tagvo.records import Detections, Frame
from vio.convert.images import ENCODINGS, picture, unpacked
from vio.convert.link_messages import (
    APRILTAG_MSGS,
    calibration,
    family_of,
    imu_values,
    pose_values,
    stamp_ns,
    tags_of,
)
from vio.convert.records import Foreign, FrameReel, said
from vio.convert.topics import COMPRESSED, Topic, choose, is_rectified
from vio.errors import LogError, VioError
from vio.records import ImuTrack, Truth
from vio.sources.flight_log.tally import Tally

_SAME_CLOCK_NS = 2_000_000_000  # recorded within so much of its stamp: the same clock
T = TypeVar("T")
_LATEST_NS = 2**62  # differences of stamps must fit in int64
_MARK = 200  # messages whose lag is looked at for that
_BROKEN = (ValueError, KeyError, IndexError, AttributeError, struct.error, sqlite3.Error,
           AssertionError, EOFError, OSError, RuntimeError, UnicodeError, TypeError,
           OverflowError, MemoryError, LookupError, ArithmeticError)  # fmt: skip


def read_bag(
    path: Path, named: Mapping[str, str], tally: Tally, rectified: bool | None = None
) -> Foreign:
    """IMU, truth, camera and frames of a bag; topics are guessed unless named (`topics.choose`).

    rectified: whether pixels are of rectified images, None: as the topics say.

    Stamps are those of the headers; arrivals are the times of recording, where these are in the
    same clock. LogError where the file is no bag or has neither IMU nor frames.
    """
    with _opened(path) as reader:
        topics = [Topic(name, info.msgtype or "", info.msgcount)
                  for name, info in reader.topics.items()]  # fmt: skip
        chosen, notes = choose(topics, named, str(path))
        if not {"imu", "image", "detections"} & set(chosen):
            kinds = ", ".join(f"{t.name} ({t.type})" for t in topics) or "no topic at all"
            raise LogError(f"{path}: neither an IMU nor images nor tags in it; it has {kinds}")
        bag = _Bag(path, reader, chosen, tally)
        imu, truth = bag.imu(notes), bag.truth()
        tags = bag.tags()
        flat = _of_rectified(chosen, bag.family, notes, path) if rectified is None else rectified
        camera = bag.camera(flat, notes)
        late = bag.same_clock()
    if not late:
        notes.append(f"{path}: recorded in another clock than stamped, so arrivals are not known")
    if "truth" in chosen:
        notes.append(f"{path}: {chosen['truth'].name} is taken for the pose of the IMU in the map")
    imus = {} if imu is None else {"imu0": imu if late else _at_stamps(imu)}
    reel = _reel(path, chosen, tags, late, tally)
    image = chosen["image"].name if "image" in chosen else None
    return Foreign(
        imus, truth=truth, camera=camera, frames=reel, notes=tuple(notes), rectified=flat,
        image_topic=image,
    )  # fmt: skip


def _of_rectified(chosen: Mapping[str, Topic], family: str, notes: list[str], path: Path) -> bool:
    """Whether the pixels are of rectified images: by the image topic's name, and those of the
    apriltag node (which subscribes to image_rect) where there are tags alone."""
    if "image" in chosen:
        flat = is_rectified(chosen["image"].name)
    else:
        flat = "detections" in chosen and family != ""  # our own bags name no family: raw pixels
    if flat:
        what = chosen["image" if "image" in chosen else "detections"].name
        notes.append(f"{path}: {what} is taken for rectified (P of camera_info, no distortion);"
                     " --rectified no takes K and D")  # fmt: skip
    return flat


@cache
def _types() -> Any:
    """The messages of ROS 2 and of apriltag_msgs; made once, which takes a while."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in APRILTAG_MSGS.items():
        store.register(get_types_from_msg(text, name))
    return store


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open rosbags reader; what it cannot open is a LogError."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
    except ImportError:
        raise VioError("bags need rosbags: pip install 'tagvio[logs]'") from None
    try:
        reader = AnyReader([path], default_typestore=_types())
        reader.open()
    except (AnyReaderError, *_BROKEN) as err:
        hint = "; `rosbag reindex` or `ros2 bag reindex` may help" if path.exists() else ""
        raise LogError(f"{path}: not a bag that can be read ({said(err)}){hint}") from None
    try:
        yield reader
    finally:
        reader.close()


class _Bag:
    """One pass each over the topics of an open bag."""

    def __init__(self, path: Path, reader: Any, chosen: Mapping[str, Topic], tally: Tally) -> None:
        self._path, self._reader, self._chosen, self._tally = path, reader, chosen, tally
        self._lags: list[int] = []
        self.family = ""

    def messages(self, what: str, values: Callable[[Any], T]) -> Iterator[tuple[int, T]]:
        """Time of recording [ns] and the values of each message; ends where the bag is broken.

        A bag brings the definitions of its messages: any field may be missing or of another type.
        Both are counted.
        """
        topic = self._chosen.get(what)
        if topic is None:
            return
        ways = [c for c in self._reader.connections if c.topic == topic.name]
        rows = self._reader.messages(connections=ways)
        while True:
            try:
                connection, recorded_ns, raw = next(rows)
            except StopIteration:
                return
            except Exception as err:  # whatever a broken file makes of a decoder
                self._tally.count(
                    "bag_broken", f"{self._path}: {topic.name} ends here ({said(err)})"
                )
                return
            try:
                message = self._reader.deserialize(raw, connection.msgtype)
                stamp, found = stamp_ns(message), values(message)
            except Exception as err:  # of a decoder, or of a message of other fields
                text = f"{self._path}: a message of {topic.name} is broken ({said(err)})"
                self._tally.count("bag_message_broken", text)
                continue
            if not 0 <= recorded_ns < _LATEST_NS:
                text = f"{self._path}: a message of {topic.name} recorded at {recorded_ns} ns"
                self._tally.count("bag_message_broken", text)
                continue
            if len(self._lags) < _MARK and what in ("imu", "image", "detections"):
                self._lags.append(recorded_ns - stamp)
            yield int(recorded_ns), found

    def same_clock(self) -> bool:
        """Whether times of recording and stamps are of one clock, as far as was read."""
        if not self._lags:
            next(self.messages("image", stamp_ns), None)
        return not self._lags or abs(float(np.median(self._lags))) < _SAME_CLOCK_NS

    def imu(self, notes: list[str]) -> ImuTrack | None:
        """The IMU, its halves put together where they have a topic each; None: there is none."""
        track = self._imu_of("imu")
        half = self._imu_of("accel")
        if track is not None and half is not None:
            track = paired(track, half)
            names = self._chosen["imu"].name, self._chosen["accel"].name
            notes.append(f"{self._path}: gyro of {names[0]}, accelerometer of {names[1]}, put"
                         " together at the gyro's stamps")  # fmt: skip
        if track is not None and len(track) and track.accel_I.any() and track.gyro_I.any():
            return track
        if track is not None:
            what = "angular rate" if len(track) and track.accel_I.any() else "specific force"
            notes.append(f"{self._path}: {self._chosen['imu'].name} has no {what} (0 throughout),"
                         " so it is no IMU and is left out; --topic imu=NAME, accel=NAME take"
                         " others")  # fmt: skip
        return None

    def _imu_of(self, what: str) -> ImuTrack | None:
        rows = list(self.messages(what, lambda m: (stamp_ns(m), *imu_values(m))))
        if not rows:
            return None
        known_ns, samples = zip(*rows, strict=True)
        t_ns, gyro, accel = zip(*samples, strict=True)
        return ImuTrack(_whole(t_ns), np.stack(gyro), np.stack(accel), _whole(known_ns))

    def truth(self) -> Truth | None:
        topic = self._chosen.get("truth")
        if topic is None:
            return None
        kind = topic.type
        rows = self.messages("truth", lambda m: (stamp_ns(m), *pose_values(m, kind)))
        return truth_of([row for _, row in rows], self._path, self._tally)

    def camera(self, rectified: bool, notes: list[str]) -> Camera | None:
        for _, data in self.messages("camera", lambda m: calibration(m, rectified)):
            topic = self._chosen["camera"].name
            if data is not None:
                return camera_of(data, Path(f"{self._path} {topic}"))
            notes.append(f"{self._path}: {topic} is not calibrated (K{' or P' * rectified} is 0):"
                         " give --camera")  # fmt: skip
            return None
        return None

    def tags(self) -> dict[int, tuple[int, Detections]]:
        """By stamp: when known, and the tags."""
        out = {}
        values = self.messages("detections", lambda m: (stamp_ns(m), tags_of(m), family_of(m)))
        for ns, (t_ns, tags, family) in values:
            out[t_ns] = ns, tags
            self.family = self.family or family
        return out


def paired(gyro: ImuTrack, accel: ImuTrack) -> ImuTrack:
    """One track of a gyro's and an accelerometer's: at the gyro's stamps, the specific force
    straight between the samples around; known once both are. Stamps outside the other's go."""
    order = np.argsort(accel.t_ns, kind="stable")
    a_ns, known_ns = accel.t_ns[order], accel.arrival_ns[order]
    rows = np.flatnonzero((gyro.t_ns >= a_ns[0]) & (gyro.t_ns <= a_ns[-1]))
    t_ns = gyro.t_ns[rows]
    since = (t_ns - a_ns[0]).astype(float)
    force = [np.interp(since, (a_ns - a_ns[0]).astype(float), accel.accel_I[order, k])
             for k in range(3)]  # fmt: skip
    later = np.searchsorted(a_ns, t_ns)
    known = np.maximum(gyro.arrival_ns[rows], known_ns[later])
    return ImuTrack(t_ns, gyro.gyro_I[rows], np.stack(force, axis=-1), known)


def truth_of(rows: Sequence[tuple[int, Array, Array, Array]], path: Path, tally: Tally) -> Truth:
    """Rows of stamp, p, q, v in the order of time; those without a pose are counted out."""
    good = [r for r in rows if np.isfinite(np.concatenate(r[1:3])).all()
            and abs(np.linalg.norm(r[2]) - 1.0) < 1e-2]  # fmt: skip
    tally.count("truth_no_pose", f"{path}: truth without a pose", len(rows) - len(good))
    if not good:
        raise LogError(f"{path}: the truth has no valid row; unit quaternions are needed")
    first = {row[0]: row for row in reversed(good)}
    tally.count("truth_repeated", f"{path}: truth with a stamp again", len(good) - len(first))
    t_ns, p, q, v = zip(*(first[t] for t in sorted(first)), strict=True)
    quats, speeds = np.stack(q), np.stack(v)
    quats = quats / np.linalg.norm(quats, axis=-1, keepdims=True)
    return Truth(_whole(t_ns), np.stack(p), quats, speeds if np.isfinite(speeds).any() else None)


def _reel(
    path: Path,
    chosen: Mapping[str, Topic],
    tags: dict[int, tuple[int, Detections]],
    late: bool,
    tally: Tally,
) -> FrameReel | None:
    """Images with the tags of their stamps, or the tags alone."""
    if "image" not in chosen:
        if not tags:
            return None
        alone = [Frame(t, None, found, ns if late else None) for t, (ns, found) in tags.items()]
        return FrameReel(len(alone), lambda: iter(alone))

    def frames() -> Iterator[Frame]:
        with _opened(path) as reader:
            bag = _Bag(path, reader, chosen, tally)
            packed = chosen["image"].type == COMPRESSED
            for ns, (t_ns, image, encoding) in bag.messages("image", partial(_image, packed)):
                if image is None:
                    text = f"{path}: an image of encoding {shown(encoding)} cannot be read"
                    tally.count("image_unreadable", f"{text}; {ENCODINGS}, JPEG or PNG can")
                    continue
                _, found = tags.get(t_ns, (0, None))
                yield Frame(t_ns, image, found, ns if late else None)

    return FrameReel(chosen["image"].count, frames)


def _image(packed: bool, message: Any) -> tuple[int, Any, str]:
    """Stamp [ns], grey image (None: it cannot be read) and encoding of an image message."""
    if packed:
        return stamp_ns(message), unpacked(message.data), str(message.format)
    return stamp_ns(message), picture(message), str(message.encoding)


def _at_stamps(track: ImuTrack) -> ImuTrack:
    return ImuTrack(track.t_ns, track.gyro_I, track.accel_I, track.t_ns, track.mean)


def _whole(values: Iterable[int]) -> IntArray:
    return np.array(list(values), dtype=np.int64)
