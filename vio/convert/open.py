"""Knows a file of another system by its name and first bytes, and reads it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from tagvo.textfile import check_regular
from vio.convert.records import Foreign
from vio.errors import LogError
from vio.sources.flight_log.tally import Tally

KINDS = {  # ending -> kind
    ".bag": "bag", ".db3": "bag", ".mcap": "bag",
    ".bin": "dataflash", ".log": "dataflash",
    ".ulg": "ulog", ".ulog": "ulog",
    ".tlog": "tlog",
    ".mp4": "video", ".avi": "video", ".mkv": "video", ".mov": "video", ".webm": "video",
    ".m4v": "video", ".h264": "video",
}  # fmt: skip
ALLOWED = (
    "a ROS 1 bag (.bag), a ROS 2 bag (its folder, .mcap, .db3), ArduPilot's .bin, PX4's .ulg, a"
    " .tlog, a video (.mp4, .avi, .mkv, .mov, .webm) or a flight log is needed"
)
_PACKED = {".gz", ".zip", ".xz", ".bz2", ".zst", ".7z"}


def kind_of(path: Path) -> str:
    """bag, dataflash, ulog, tlog, video or flightlog; LogError says what is allowed."""
    if path.is_dir():
        if (path / "metadata.yaml").exists():
            return "bag"
        if (path / "mav0").is_dir():
            return "flightlog"
        inside = sorted({p.suffix for p in path.iterdir() if p.suffix.lower() in KINDS})
        hint = f" (it holds files of {', '.join(inside)}: name one)" if inside else ""
        raise LogError(f"{path}: a folder that is no log{hint}; {ALLOWED}")
    if not path.exists():
        raise LogError(f"{path}: no such file; {ALLOWED}")
    check_regular(path, LogError)
    kind = KINDS.get(path.suffix.lower())
    if path.suffix.lower() in _PACKED:
        raise LogError(f"{path}: unpack it first; {ALLOWED}")
    if kind is None:
        raise LogError(f"{path}: of no kind that we know; {ALLOWED}")
    return kind


def read_foreign(
    path: Path,
    tally: Tally,
    topics: Mapping[str, str],
    stamps: Path | None = None,
    rectified: bool | None = None,
) -> Foreign:
    """What one file or folder holds; topics, rectified: of bags; stamps: of a video."""
    kind = kind_of(path)
    if kind == "bag":
        from vio.convert.bags import read_bag

        return read_bag(path, topics, tally, rectified)
    if kind == "dataflash":
        from vio.convert.dataflash import read_dataflash

        return read_dataflash(path, tally)
    if kind == "ulog":
        from vio.convert.ulog import read_ulog

        return read_ulog(path, tally)
    if kind == "tlog":
        from vio.convert.tlog import read_tlog

        return read_tlog(path, tally)
    if kind == "video":
        from vio.convert.video import read_video

        return read_video(path, stamps, tally)
    from vio.convert.flightlog import read_flight_log

    return read_flight_log(path, tally)


def together(parts: Sequence[tuple[Path, Foreign]]) -> Foreign:
    """Several files of one flight as one; LogError where two of them hold the same thing."""
    whole = Foreign()
    for path, part in parts:
        for name in part.imus:
            if name in whole.imus:
                raise LogError(f"{path}: a second {name}; convert it to a log of its own")
        for what in ("truth", "camera", "frames"):
            if getattr(part, what) is not None and getattr(whole, what) is not None:
                raise LogError(f"{path}: a second {what}; convert it to a log of its own")
        whole = Foreign(
            {**whole.imus, **part.imus},
            {**whole.noted_ns, **part.noted_ns},
            whole.truth if part.truth is None else part.truth,
            whole.camera if part.camera is None else part.camera,
            whole.frames if part.frames is None else part.frames,
            whole.notes + part.notes,
            whole.rectified or part.rectified,
            whole.image_topic or part.image_topic,
        )
    return whole


def shifted(found: Foreign, shift_m: Sequence[float]) -> Foreign:
    """The same with its truth moved by (3,) [m] in W: where the map's origin is elsewhere."""
    if found.truth is None or not any(shift_m):
        return found
    truth = replace(found.truth, p_WI=found.truth.p_WI + np.asarray(shift_m, dtype=float))
    return replace(found, truth=truth)
