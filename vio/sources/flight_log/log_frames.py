"""Turns the camera's part of a log into frames: images read late, corners where there are none."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tagvo.geometry import IntArray
from tagvo.records import Detections, Frame
from tagvo.textfile import check_regular
from vio.errors import LogError
from vio.sources.flight_log.files import (
    DetectionTable,
    FrameList,
    read_detections,
    read_frame_list,
)
from vio.sources.flight_log.options import LogOptions
from vio.sources.flight_log.tally import Tally
from vio.sources.image_file import decoded

_BEYOND_PX = 3.0  # corners of a tag cut by the edge are extrapolated by up to a cell
_BEYOND_SHARE = 0.01  # of the tags: april, aviary and line5 have none
_NO_TAGS = Detections.of(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class FrameSource:
    """The frames of one camera, ready to be offered one by one.

    t_ns (n,), arrival_ns (n,); received_ns (n,): when an image came from the camera, before its
    tags were known; image_path of each, None: take its corners; corners: by stamp, None where the
    log has no detections.csv; first_ns, last_ns: stamps of the camera's first and latest
    frame, offered or not; resolution (width, height) [px] of the calibration.
    """

    t_ns: IntArray
    arrival_ns: IntArray
    received_ns: IntArray
    image_path: list[Path | None]
    corners: Mapping[int, Detections] | None
    first_ns: int
    last_ns: int
    resolution: tuple[int, int]
    tally: Tally

    def __len__(self) -> int:
        return len(self.t_ns)

    def frame(self, row: int) -> Frame | None:
        """One frame; None (and counted) where its image cannot be used."""
        t_ns, arrival_ns = int(self.t_ns[row]), int(self.arrival_ns[row])
        path = self.image_path[row]
        corners = (self.corners or {}).get(t_ns, _NO_TAGS)
        if path is None:
            return Frame(t_ns, detections=corners, arrival_ns=arrival_ns)
        image = read_image(path)
        if image is None and self.corners is not None:  # as after a power cut
            self.tally.count("image_unreadable", f"{path}: no image, its corners are taken")
            return Frame(t_ns, detections=corners, arrival_ns=arrival_ns)
        if image is None:
            self.tally.count("image_unreadable", f"{path}: no image, frame skipped")
            return None
        height, width = image.shape
        if (width, height) != self.resolution:
            needed = "x".join(map(str, self.resolution))
            text = f"{path}: {width}x{height} pixels, the camera file says {needed}; frame skipped"
            self.tally.count("image_size", text)
            return None
        return Frame(t_ns, image, arrival_ns=arrival_ns, received_ns=int(self.received_ns[row]))


def read_image(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]] | None:
    """Grey image (h, w) uint8 of a file, None where it is none."""
    try:
        check_regular(path, LogError)
        data = np.fromfile(path, dtype=np.uint8)
    except (OSError, LogError, MemoryError):
        return None
    return decoded(data)


def open_frames(
    folder: Path, resolution: tuple[int, int], options: LogOptions, t0_ns: int | None, tally: Tally
) -> FrameSource:
    """Frames of a cam0 folder; t0_ns: start of the log's time, None: at the first frame.

    LogError where there is neither a data.csv nor a detections.csv, or nothing is left to offer.
    """
    table = None
    if (folder / "detections.csv").exists():
        table = read_detections(folder / "detections.csv", tally)
        _doubt_resolution(table.tags, resolution, folder / "detections.csv", tally)
    frames = _frame_list(folder, table, tally)
    corners = None if table is None else _by_stamp(table, frames, folder, options, tally)
    if options.use_detections and corners is None:
        raise LogError(f"{folder}: no detections.csv; --detections needs one")
    images = _image_paths(folder, frames, options.use_detections)
    start = int(frames.t_ns[0]) if t0_ns is None else t0_ns
    usable = np.array([p is not None for p in images]) | (corners is not None)
    if not usable.any():
        raise LogError(f"{folder}: none of {len(frames)} images is there, nor a detections.csv")
    taken = np.arange(len(frames)) % options.every == 0
    shown = options.shown(frames.t_ns, start)
    tally.count("frame_blackout", f"{folder}: frames left out", int(np.sum(taken & ~shown)))
    text = f"{folder}: frames whose image is missing and that have no detections.csv, skipped"
    tally.count("image_missing", text, int(np.sum(taken & shown & ~usable)))
    rows = np.flatnonzero(taken & shown & usable)
    arrival = _arrivals(frames, table, images, options)
    received = arrival if frames.received_ns is None else frames.received_ns
    return FrameSource(
        frames.t_ns[rows],
        arrival[rows],
        received[rows],
        [images[i] for i in rows.tolist()],
        corners,
        int(frames.t_ns[0]),
        int(frames.t_ns.max()),
        resolution,
        tally,
    )


def _doubt_resolution(
    tags: Detections, resolution: tuple[int, int], path: Path, tally: Tally
) -> None:
    """Note corners that no image of the calibration's size can hold."""
    low, high = tags.corners_px.min(axis=1), tags.corners_px.max(axis=1)
    size = np.array(resolution)
    beyond = ((low < -_BEYOND_PX) | (high > size - 1 + _BEYOND_PX)).any(axis=-1)
    if beyond.sum() > _BEYOND_SHARE * len(tags):
        right, bottom = np.ceil(tags.corners_px.max(axis=(0, 1)) + 0.5).astype(int)
        needed = "x".join(map(str, resolution))
        tally.note(f"{path}: corners of {int(beyond.sum())} of {len(tags)} tags lie outside the"
                   f" camera file's {needed} pixels (they fill {right}x{bottom}): is it of another"
                   " camera or resolution?")  # fmt: skip


def _frame_list(folder: Path, table: DetectionTable | None, tally: Tally) -> FrameList:
    path = folder / "data.csv"
    if path.exists():
        return read_frame_list(path, tally)
    if table is None:
        raise LogError(f"{folder}: no data.csv; it (or a detections.csv) lists the frames")
    tally.note(f"{folder}: no data.csv; the stamps of detections.csv are taken as frames")
    _, first = np.unique(table.t_ns, return_index=True)
    t_ns = table.t_ns[np.sort(first)]
    return FrameList(t_ns, t_ns, [f"{t}.png" for t in t_ns.tolist()])


def _image_paths(folder: Path, frames: FrameList, use_detections: bool) -> list[Path | None]:
    if use_detections or not (folder / "data").is_dir():
        return [None] * len(frames)
    paths = [folder / "data" / name if _stays_below(name) else None for name in frames.filename]
    return [path if path is not None and _is_file(path) else None for path in paths]


def _stays_below(name: str) -> bool:
    """Whether a name out of a file is one of a file below its folder: who wrote the log must not
    choose among the reader's other files. (Links that lie there are the user's own.)"""
    parts = name.replace("\\", "/").split("/")
    return bool(name) and not name.startswith(("/", "~")) and ".." not in parts


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name too long, or with a zero byte in it
        return False


def _by_stamp(
    table: DetectionTable, frames: FrameList, folder: Path, options: LogOptions, tally: Tally
) -> dict[int, Detections]:
    """The tags of each stamp; rows of stamps that are no frame are counted and left out."""
    order = np.argsort(table.t_ns, kind="stable")
    stamps, starts = np.unique(table.t_ns[order], return_index=True)
    groups = np.split(order, starts[1:])
    known = np.isin(stamps, frames.t_ns)
    stray = sum(len(g) for g, k in zip(groups, known, strict=True) if not k)
    text = f"{folder / 'detections.csv'}: rows whose stamp is no frame of data.csv"
    tally.count("detections_no_frame", text, stray)
    out = {}
    for stamp, rows, is_frame in zip(stamps.tolist(), groups, known, strict=True):
        if options.only_tags is not None:
            rows = rows[np.isin(table.tags.tag_id[rows], options.only_tags)]
        if is_frame:
            out[stamp] = table.tags[rows]
    return out


def _arrivals(
    frames: FrameList,
    table: DetectionTable | None,
    images: list[Path | None],
    options: LogOptions,
) -> IntArray:
    """When each frame is known [ns]; a frame of corners when its last tag is; (n,)."""
    if options.latency_ns:
        return frames.t_ns + options.latency_ns
    if table is None or table.arrival_ns is None:
        return frames.arrival_ns
    stamps, group = np.unique(table.t_ns, return_inverse=True)
    last = np.full(len(stamps), np.iinfo(np.int64).min)
    np.maximum.at(last, group, table.arrival_ns)
    at = np.minimum(np.searchsorted(stamps, frames.t_ns), len(stamps) - 1)
    known = (stamps[at] == frames.t_ns) & np.array([p is None for p in images])
    return np.where(known, last[at], frames.arrival_ns)
