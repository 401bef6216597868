"""Logs of other systems that end at once, or claim what cannot be: one line, exit code 1."""

import struct

import cv2
import numpy as np
import pytest
from cli_calls import tagvio

from vio.convert.video import read_video
from vio.sources.flight_log.tally import Tally

pytest.importorskip("rosbags")
MAGIC = b"\x89MCAP0\r\n"
FMT_COLUMNS = b"Type,Length,Name,Format,Columns"


def record(opcode: int, content: bytes, size: int | None = None) -> bytes:
    """A record of MCAP that says that it is `size` long."""
    claimed = len(content) if size is None else size
    return bytes([opcode]) + struct.pack("<Q", claimed) + content


HEADER = record(1, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))
MCAPS = {
    "empty": b"",
    "half a magic": MAGIC[:5],
    "magic alone": MAGIC,
    "magic twice": MAGIC + MAGIC,
    "header alone": MAGIC + HEADER,
    "header cut": MAGIC + HEADER[:-6],
    "no header": MAGIC + record(2, b"\0" * 20) + MAGIC,
    "not mcap": b"a" * 300,
    **{
        f"opcode {opcode} of {size} bytes": MAGIC + HEADER + record(opcode, b"\1" * 40, size) + end
        for opcode, size, end in (
            (3, 9 * 10**18, b""),
            (3, 2**64 - 1, MAGIC),
            (4, 2**63, MAGIC),
            (6, 9 * 10**18, b""),
            (6, 2**40, MAGIC),
            (8, 2**31, b""),
        )
    },
}


def fmt(kind: int, length: int, name: bytes, types: bytes, columns: bytes) -> bytes:
    """DataFlash's description of a message."""
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, length, name, types, columns)


FMT = fmt(128, 89, b"FMT", b"BBnNZ", FMT_COLUMNS)
IMU = (200, 35, b"IMU")
IMU_COLUMNS = b"TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
ROW = b"\xa3\x95\xc8" + struct.pack("<Qffffff", 10**6, 0, 0, 0, 0, 0, -9.8)
DATAFLASH = {
    "empty": b"",
    "one byte": b"\xa3",
    "unknown format character": FMT + fmt(*IMU, b"Q&fffff", IMU_COLUMNS) + 9 * ROW,
    "bytes for formats": FMT + fmt(*IMU, b"\xff\x80\x7f\xfb", IMU_COLUMNS) + 9 * ROW,
    "fewer columns than formats": FMT + fmt(*IMU, b"Qffffff", b"TimeUS,GyrX") + 9 * ROW,
    "more columns than formats": FMT + fmt(*IMU, b"Qf", IMU_COLUMNS) + 9 * ROW,
    "texts where numbers are": FMT + fmt(*IMU, b"QNfffff", IMU_COLUMNS) + 9 * ROW,
    "arrays where numbers are": FMT + fmt(*IMU, b"Qafffff", IMU_COLUMNS) + 9 * ROW,
    "no formats": FMT + fmt(*IMU, b"", IMU_COLUMNS) + 9 * ROW,
    "length zero": FMT + fmt(200, 0, b"IMU", b"Qffffff", IMU_COLUMNS) + 9 * ROW,
    "length 255": FMT + fmt(200, 255, b"IMU", b"Qffffff", IMU_COLUMNS) + 9 * ROW,
    "FMT of itself changed": fmt(128, 89, b"FMT", b"ZZZZZ", FMT_COLUMNS) + FMT + 9 * ROW,
    "columns that are no text": FMT + fmt(*IMU, b"Qffffff", b"\xff\x80,\xfe,,,,") + 9 * ROW,
    "not dataflash": b"a" * 300,
}
INPUTS = [
    pytest.param(name, content, id=f"{name}: {kind}")
    for name, kinds in (("a.mcap", MCAPS), ("a.bin", DATAFLASH))
    for kind, content in kinds.items()
]


@pytest.mark.parametrize(("name", "content"), INPUTS)
def test_a_broken_log_is_refused_in_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    done = tagvio("convert", tmp_path / name, "--out", tmp_path / "log")
    errors = [line for line in done.err.splitlines() if not line.startswith("warning: ")]
    assert done.code == 1, done
    assert len(errors) == 1, done.err
    assert name in errors[0]
    assert len(errors[0]) < 600


def test_the_rows_that_the_broken_ones_are_made_of_are_read(tmp_path):
    """So that the refusals above are of what was broken."""
    rows = b"".join(
        ROW[:3] + struct.pack("<Qffffff", 10**6 + 2500 * i, 0, 0, 0, 0, 0, -9.8) for i in range(9)
    )
    (tmp_path / "a.bin").write_bytes(FMT + fmt(*IMU, b"Qffffff", IMU_COLUMNS) + rows)
    done = tagvio("convert", tmp_path / "a.bin", "--out", tmp_path / "log")
    assert done.code == 0, done
    assert len((tmp_path / "log/mav0/imu0/data.csv").read_text().splitlines()) == 10


def test_a_video_that_claims_millions_of_frames_has_no_more_than_its_bytes_hold(tmp_path):
    path = tmp_path / "flight.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (64, 48))
    for _ in range(3):
        writer.write(np.full((48, 64, 3), 90, dtype=np.uint8))
    writer.release()
    data = bytearray(path.read_bytes())
    at = data.index(b"strh") + 8 + 32  # dwLength of the stream
    data[at : at + 4] = (0xFFFFFF).to_bytes(4, "little")
    path.write_bytes(data)
    assert cv2.VideoCapture(str(path)).get(cv2.CAP_PROP_FRAME_COUNT) > 1e6
    found = read_video(path, None, Tally())
    assert found.frames is not None
    assert found.frames.total <= len(data) // 8
