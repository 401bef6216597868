"""Readers in a stranger's hands: nothing crashes, hangs, leads out of a folder or stays untold."""

import json
import os
import struct
import zlib
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from cli_calls import tagvio
from numpy.testing import assert_allclose, assert_array_equal
from small_log import CAMERA, TAG_MAP, write_log

from tagvo.camera.calibration import load_camera
from tagvo.errors import CameraError, MapError, TagvoError, shown
from tagvo.maps.check import check_map_data, summed_up
from tagvo.maps.formats import read_map_file
from tagvo.textfile import parse_yaml, read_text
from vio.config import load_config
from vio.convert.bags import paired
from vio.convert.dataflash import read_dataflash
from vio.convert.images import picture
from vio.convert.link_messages import calibration
from vio.convert.topics import IMAGE, Topic, choose, is_rectified
from vio.errors import LogError
from vio.mavlink.persistent_state import Saved, load_saved
from vio.records import ImuTrack
from vio.setup_check.unmapped_tags import UnmappedTags
from vio.sinks.log_writer import LogWriter
from vio.sources.flight_log.files import read_imu
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally
from vio.sources.image_file import decoded, image_size
from vio.sources.live.imu import unwrapped

T0 = 1_700_000_000_000_000_000


# YAML, text, names


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: &x [1]\nb: *x", "line 2: not valid YAML (an alias"),
        ("a: &x [*x]", "an alias"),
        ("a: !!timestamp x", "a tag (!)"),
        ("a: !!python/object:os.system x", "a tag (!)"),
        ('a: "x\\0y"', "holds a zero byte"),
        ("a: 0x" + "f" * 9999, "a whole number of 10001 digits"),
        ("[" * 5000, "not valid YAML"),
        ("a: 2026-13-45", "not valid YAML"),
    ],
)
def test_yaml_that_is_an_attack_is_one_short_line(text, said):
    with pytest.raises(TagvoError) as caught:
        parse_yaml(text, "a.yaml")
    assert said in str(caught.value)
    assert len(str(caught.value)) < 200
    assert "\n" not in str(caught.value)


def test_stars_and_ampersands_in_texts_are_no_aliases():
    assert parse_yaml("/**: {a: 'x & *y!'}", "a.yaml") == {"/**": {"a": "x & *y!"}}


def test_values_in_errors_are_short():
    deep: list[object] = [1]
    for _ in range(30):
        deep = [deep] * 10  # 10^30 elements, were they written out
    for value in (deep, "x" * 10**6, {i: i for i in range(10**4)}, 1 << 99_999):
        assert len(shown(value)) <= 80


def test_no_fifo_device_or_zero_byte_is_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    for path in (tmp_path / "fifo", Path("/dev/zero")):
        with pytest.raises(TagvoError, match="a regular file is needed"):
            read_text(path)
    with pytest.raises(TagvoError, match="zero byte"):
        read_text(Path("a\0b"))
    (tmp_path / "there.txt").write_text("x")
    (tmp_path / "link").symlink_to(tmp_path / "there.txt")
    assert read_text(tmp_path / "link") == "x"
    log = write_log(tmp_path)
    image = next((log / "mav0/cam0/data").glob("*.png"))
    image.unlink()
    os.mkfifo(image)
    opened = FlightLog.open(log)
    assert len(list(opened.events()))  # it does not wait for the FIFO
    assert opened.counters["image_missing"] == 1


def test_names_in_data_csv_stay_below_the_log(tmp_path):
    log = write_log(tmp_path)
    outside = tmp_path / "x.png"
    cv2.imwrite(str(outside), np.zeros((48, 64), np.uint8))
    path = log / "mav0/cam0/data.csv"
    rows = path.read_text().splitlines()
    names = [str(outside), "../../../../x.png", "a/../../../../../x.png"]
    rows[1:4] = [f"{row.split(',')[0]},{name}" for row, name in zip(rows[1:4], names, strict=True)]
    path.write_text("\n".join(rows) + "\n")
    opened = FlightLog.open(log)
    assert opened.counters["image_missing"] == 3
    assert all(p.is_relative_to(log) for p in opened.frames.image_path if p is not None)


def test_replace_never_follows_a_link(tmp_path):
    precious = tmp_path / "precious"
    precious.mkdir()
    (precious / "holiday.png").touch()
    log = tmp_path / "log"
    (log / "mav0/cam0").mkdir(parents=True)
    (log / "tagmap.yaml").touch()
    (log / "mav0/cam0/data").symlink_to(precious)
    with pytest.raises(LogError, match="is a link to"):
        LogWriter(log, replace=True)
    assert (precious / "holiday.png").exists()
    assert (log / "tagmap.yaml").exists()
    (log / "mav0/cam0/data").unlink()
    (precious / "map.yaml").write_text("x")
    (log / "tagmap.yaml").unlink()
    (log / "tagmap.yaml").symlink_to(precious / "map.yaml")
    LogWriter(log, replace=True)
    assert not (log / "tagmap.yaml").is_symlink()
    assert (precious / "map.yaml").read_text() == "x"


def test_recordings_are_closed_to_others(tmp_path):
    before = os.umask(0)
    try:
        with LogWriter(tmp_path / "a/log") as writer:
            writer.line("flown/sent.jsonl", "{}")
    finally:
        os.umask(before)
    file = tmp_path / "a/log/flown/sent.jsonl"
    assert file.stat().st_mode & 0o777 == 0o640
    assert [p.stat().st_mode & 0o777 for p in (file.parent, tmp_path / "a/log")] == [0o750] * 2


# images


def chunk(kind: bytes, body: bytes, length: int | None = None) -> bytes:
    said = len(body) if length is None else length
    return struct.pack(">I", said) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(width: int, height: int, claim: int | None = None) -> np.ndarray:
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"x" * 8, claim)
    return np.frombuffer(data, dtype=np.uint8)


def test_images_are_judged_by_their_header():
    image = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    for end in (".png", ".jpg", ".bmp", ".pgm"):
        data = cv2.imencode(end, image)[1].ravel()
        assert image_size(data) == (64, 48), end
        seen = decoded(data)
        assert seen is not None
        assert np.abs(seen.astype(int) - image).mean() < 6.0
    assert image_size(png(64, 48, claim=2**31 - 1)) is None  # break 10: a chunk of 2 GB
    assert decoded(png(60_000, 60_000)) is None
    assert image_size(png(0, 48)) is None
    for n in range(60):
        decoded(png(64, 48)[:n])


def message(encoding: str, data: np.ndarray, step: int, h: int = 4, w: int = 6) -> SimpleNamespace:
    return SimpleNamespace(encoding=encoding, height=h, width=w, step=step, is_bigendian=0,
                           data=data.tobytes())  # fmt: skip


def test_what_usb_cam_v4l2_and_realsense_send():
    luma = np.arange(24, dtype=np.uint8).reshape(4, 6)
    packed = np.full((4, 12), 128, dtype=np.uint8)
    packed[:, ::2] = luma
    for name in ("yuv422_yuy2", "yuyv"):
        assert_array_equal(picture(message(name, packed, 12)), luma)
    for name in ("yuv422", "uyvy"):
        assert_array_equal(picture(message(name, np.roll(packed, 1), 12)), luma)
    planes = np.concatenate([luma, np.full((2, 6), 128, np.uint8)])
    for name in ("nv12", "i420", "NV21"):
        assert_array_equal(picture(message(name, planes, 6)), luma)
    for name in ("bayer_rggb16", "bayer_x8", "32FC1", "yuv411"):
        assert picture(message(name, planes, 6)) is None
    assert picture(message("yuyv", packed, 6)) is None  # rows shorter than their pixels


def test_a_log_without_one_readable_image_is_an_error(tmp_path):
    log = write_log(tmp_path)
    for image in (log / "mav0/cam0/data").glob("*.png"):
        image.write_bytes(png(64, 48, claim=2**31 - 1).tobytes())
    done = tagvio("run", log, "--out", tmp_path / "out", "--vo-only")
    assert done.code == 1
    assert "not one of 20 images could be read" in done.err
    done = tagvio("convert", log, "--out", tmp_path / "again")
    assert done.code == 1


# maps


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (("size: 0.2", "size: 5e-324"), "0.001 to 10 m is a tag's side"),
        (("size: 0.2", "size: 11"), "0.001 to 10 m"),
        (("p: [0, 0, 0]", "p: [0, 10001, 0]"), "at most 10000 m from the origin"),
    ],
)
def test_sizes_and_places_of_tags_are_bounded(tmp_path, edit, said):
    (tmp_path / "m.yaml").write_text(TAG_MAP.replace(*edit, 1))
    done = tagvio("map", "check", tmp_path / "m.yaml")
    assert done.code == 1
    assert said in done.out
    with pytest.raises(MapError, match="tag 3"):
        read_map_file(tmp_path / "m.yaml")


def test_a_hundred_thousand_findings_are_twenty_lines():
    tags = [{"id": i % 500, "size": -1.0, "p": [i, 0], "q": [1, 0, 0, 0]} for i in range(12_000)]
    found = check_map_data({"family": "tag36h11", "tags": tags}, "m.yaml")
    lines = summed_up(found)
    assert len(found) > 24_000
    assert len(lines) <= 20
    assert "(and 11999 more like it)" in lines[0]


def test_many_tags_in_one_place_end_soon():
    tags = [{"id": i % 500, "size": 0.1, "p": [0, 0, 0], "q": [1, 0, 0, 0]} for i in range(3000)]
    lines = summed_up(check_map_data({"family": "tag36h11", "tags": tags}, "m.yaml"))
    assert any("overlap" in line for line in lines)


def test_wpilib_csv_and_a_list_of_tags(tmp_path):
    """Inches and degrees; yaw, then pitch: WPILib's JSON of 2025 has the same poses."""
    path = tmp_path / "a.csv"
    path.write_text(
        "ID,X,Y,Z,Z-Rotation,Y-Rotation\n4,325.68,241.64,73.54,0,30\n1,657.37,25.8,58.5,126,0\n"
    )
    tags = read_map_file(path, size=0.1651).tag_map
    assert_allclose(tags.p_WT[0], [8.272272, 6.137656, 1.867916], atol=1e-9)
    out_W = tags.R_WT[0][:, 2]  # out of the face: along x, pitched 30 degrees down
    assert_allclose(out_W, [np.cos(np.pi / 6), 0.0, -0.5], atol=1e-12)
    assert_allclose(tags.R_WT[1][:, 2], [np.cos(np.radians(126)), np.sin(np.radians(126)), 0.0],
                    atol=1e-12)  # fmt: skip
    old = tmp_path / "b.csv"
    old.write_text("ID,X,Y,Z,Rotation\n1,593.68,9.68,53.38,120\n")
    assert_allclose(
        read_map_file(old, size=0.1651).tag_map.p_WT[0], [15.079472, 0.245872, 1.355852]
    )
    listed = tmp_path / "c.json"
    listed.write_text(json.dumps([{"id": 5, "size": 0.2, "p": [1, 2, 3], "q": [1, 0, 0, 0]}]))
    assert read_map_file(listed, family="tag36h11").tag_map.tag_id.tolist() == [5]


# calibrations


def test_of_two_cameras_none_is_taken_unasked(tmp_path):
    path = tmp_path / "cams.yaml"
    other = CAMERA.replace("cam0:", "cam1:").replace("60.0, 60.0", "70.0, 70.0")
    path.write_text(CAMERA + "  rostopic: /a/image_raw\n" + other + "  rostopic: /b/image_raw\n")
    with pytest.raises(CameraError, match=r"2 cameras: cam0 \(/a/image_raw\), cam1 \(/b"):
        load_camera(path)
    assert load_camera(Path(f"{path}:cam1")).intrinsics[0] == 70.0
    assert load_camera(path, topic="/b/image_raw/compressed").intrinsics[0] == 70.0
    with pytest.raises(CameraError, match="none alone is of /c/image_raw"):
        load_camera(path, topic="/c/image_raw")
    with pytest.raises(CameraError, match="no `cam7`; it has cam0, cam1"):
        load_camera(Path(f"{path}:cam7"))


def test_t265(tmp_path):
    path = tmp_path / "t265.json"
    path.write_text(json.dumps({"width": 848, "height": 800, "ppx": 420.0, "ppy": 401.0,
                                "fx": 286.0, "fy": 286.5, "model": "kannala_brandt4",
                                "coeffs": [-0.006, 0.04, -0.037, 0.006, 0.0]}))  # fmt: skip
    camera = load_camera(path)
    assert (camera.model, camera.resolution) == ("equidistant", (848, 800))
    assert camera.intrinsics.tolist() == [286.0, 286.5, 420.0, 401.0]


def test_rectified_takes_p_and_zeros_are_no_calibration():
    k, p = [9.0, 0, 3, 0, 9, 2, 0, 0, 1], [8.0, 0, 3.5, 0, 0, 7, 2.5, 0, 0, 0, 1, 0]
    info = SimpleNamespace(k=k, d=[0.1] * 5, p=p, width=6, height=4, distortion_model="plumb_bob")
    flat = calibration(info, rectified=True)
    assert flat["camera_matrix"]["data"] == [8.0, 0, 3.5, 0, 7, 2.5, 0, 0, 1]
    assert flat["distortion_model"] == "none"
    info.k = [0.0] * 9
    assert calibration(info) is None
    assert is_rectified("/camera/image_rect/compressed")
    assert is_rectified("/cam/rect")
    assert not is_rectified("/direct/image_raw")


def test_raw_goes_before_rectified_and_halves_are_found():
    imu = "sensor_msgs/msg/Imu"
    topics = [Topic("/c/image_rect", IMAGE, 9), Topic("/c/image_raw", IMAGE, 9),
              Topic("/c/accel/sample", imu, 5), Topic("/c/gyro/sample", imu, 9)]  # fmt: skip
    chosen, _ = choose(topics, {}, "x")
    assert {k: t.name for k, t in chosen.items()} == {
        "image": "/c/image_raw", "imu": "/c/gyro/sample", "accel": "/c/accel/sample"}  # fmt: skip
    chosen, _ = choose([*topics, Topic("/c/imu", imu, 3)], {}, "x")
    assert chosen["imu"].name == "/c/imu"
    assert "accel" not in chosen


def test_a_split_imu_is_interpolated_at_the_gyros_stamps():
    t = np.arange(5, dtype=np.int64) * 100 + T0
    gyro = ImuTrack(t, np.ones((5, 3)), np.zeros((5, 3)), t + 7)
    a = np.array([T0 + 50, T0 + 250, T0 + 350], dtype=np.int64)
    force = np.array([[0.0, 0, 0], [2, 4, 6], [3, 5, 7]])
    both = paired(gyro, ImuTrack(a, np.zeros((3, 3)), force, a + 1000))
    assert both.t_ns.tolist() == [T0 + 100, T0 + 200, T0 + 300]
    assert_allclose(both.accel_I[:, 0], [0.5, 1.5, 2.5])
    assert both.arrival_ns.tolist() == [T0 + 1250, T0 + 1250, T0 + 1350]  # once both are known


# logs


def dataflash(messages: list[tuple[str, str, str, list]], path: Path) -> Path:
    fmt = struct.Struct("<BB4s16s64s")
    out = b"\xa3\x95\x80" + fmt.pack(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    for number, (name, form, columns, _) in enumerate(messages, start=140):
        size = struct.calcsize("<" + form) + 3
        head = fmt.pack(number, size, name.encode(), form.encode(), columns.encode())
        out += b"\xa3\x95\x80" + head
    for number, (_, form, _, rows) in enumerate(messages, start=140):
        for row in rows:
            out += b"\xa3\x95" + bytes([number]) + struct.pack("<" + form, *row)
    path.write_bytes(out)
    return path


def test_dataflash_of_3_6_has_a_message_an_instance(tmp_path):
    us = [1_000_000 + 2500 * i for i in range(4)]
    path = dataflash(
        [(f"GYR{n}", "QQfff", "TimeUS,SampleUS,GyrX,GyrY,GyrZ", [(u, u, n, 0, 0) for u in us])
         for n in (1, 2)]
        + [(f"ACC{n}", "QQfff", "TimeUS,SampleUS,AccX,AccY,AccZ", [(u, u, 0, 0, -9) for u in us])
           for n in (1, 2)],
        tmp_path / "a.bin",
    )  # fmt: skip
    found = read_dataflash(path, Tally())
    assert sorted(found.imus) == ["imu0", "imu1"]
    assert found.imus["imu1"].gyro_I[0].tolist() == [2.0, 0.0, 0.0]
    assert found.imus["imu0"].accel_I[0].tolist() == [0.0, 0.0, 9.0]
    logged = "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"
    row = (0.1, 0, 0, 0, 0, -9.8, 0, 0, 20.0, 1, 1, 1000, 1000)
    path = dataflash([(name, "QffffffIIfBBHH", logged, [(u, *row) for u in us])
                      for name in ("IMU", "IMU2")], tmp_path / "b.bin")  # fmt: skip
    found = read_dataflash(path, Tally())
    assert sorted(found.imus) == ["imu0", "imu1"]
    assert found.imus["imu1"].t_ns.tolist() == [1000 * u for u in us]


def test_a_dataflash_log_with_broken_places_is_read_around_them(tmp_path):
    rows = [(1_000_000 + 2500 * i, 0.1, 0, 0, 0, 0, -9.8) for i in range(50)]
    path = dataflash([("IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", rows)],
                     tmp_path / "a.bin")  # fmt: skip
    data = bytearray(path.read_bytes())
    data[-10 * 35 : -10 * 35 + 2] = b"zz"
    data += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 99, 0, b"ZERO", b"", b"")  # no length
    data += b"\xa3\x95\x63" * 50
    path.write_bytes(bytes(data))
    tally = Tally()
    assert len(read_dataflash(path, tally).imus["imu0"]) == 49
    assert tally.counters["dataflash_broken"] > 0


def test_a_slow_imu_and_a_clock_that_steps_are_told(tmp_path):
    def warnings(stamps) -> list[str]:
        rows = "".join(f"{t},0,0,0,0,0,9.8\n" for t in stamps)
        (tmp_path / "data.csv").write_text(f"#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z\n{rows}")
        tally = Tally()
        read_imu(tmp_path / "data.csv", tally)
        return tally.warnings

    slow = [T0 + i * 250_000_000 for i in range(20)]
    assert any("the IMU comes at 4 Hz" in w for w in warnings(slow))
    good = [T0 + i * 5_000_000 for i in range(20)]
    assert warnings(good) == []
    stepped = [t if i < 10 else t + 3_600 * 10**9 for i, t in enumerate(good)]
    assert any("clock steps 1 times, by up to 3.6e+03 s" in w for w in warnings(stepped))


def test_time_boot_wraps_after_49_days():
    wrap = (1 << 32) * 1_000_000
    assert unwrapped(5_000_000, 5_100_000) == 5_000_000
    assert unwrapped(3_000_000, wrap + 2_000_000) == wrap + 3_000_000
    assert unwrapped(wrap - 1_000_000, 3 * wrap + 1_000_000) == 3 * wrap - 1_000_000


# configuration, state, tags


@pytest.mark.parametrize("key", ["gate", "r_inflation", "prior.position_m", "health.lost_after_s",
                                 "recovery.after_s", "start.span_s", "buffer_s"])  # fmt: skip
@pytest.mark.parametrize("value", [".inf", "-1", "1e300", ".nan"])
def test_the_filters_settings_are_bounded(key, value):
    with pytest.raises(TagvoError, match=key):
        load_config(None, [f"vio.{key}={value}"])


@pytest.mark.parametrize("text", ["", "[]", "{", '{"reset_counter": 1e999}', "[" * 9999,
                                  '{"reset_counter": "7", "signing_timestamp": 1}',
                                  '{"reset_counter": true, "signing_timestamp": 1}',
                                  '{"reset_counter": ' + "9" * 5000 + ', "signing_timestamp": 1}',
                                  "\0"])  # fmt: skip
def test_a_state_file_may_hold_anything(tmp_path, text):
    path = tmp_path / "mavlink.json"
    path.write_text(text)
    assert load_saved(path) == Saved()
    assert load_saved(tmp_path) == Saved()
    path.write_text('{"reset_counter": 300, "signing_timestamp": 99}')
    assert load_saved(path) == Saved(44, 99)


def test_strange_tags_are_told_once_and_only_where_they_matter():
    from simulated import grid_map

    from tagvo.records import Detections

    tag_map, seen = grid_map(2, [0.1], 0.3), UnmappedTags()
    square = np.zeros((1, 4, 2))
    stranger = Detections.of(np.array([500]), square)
    for i in range(100):
        known = Detections.of(tag_map.tag_id[:1], square)
        seen.take(stranger if i == 0 else known, {"not_on_map": int(i == 0)}, tag_map)
    assert seen.words(tag_map, with_pose=99) == []  # a misread code
    assert "tags 500 (in 1 frame) are seen" in seen.words(tag_map, with_pose=0)[0]
    for _ in range(5):
        seen.take(stranger, {"not_on_map": 1}, tag_map)
    assert len(seen.news(tag_map, 99)) == 1
    assert seen.news(tag_map, 99) == []
    twice = Detections.of(np.array([500, 500]), np.zeros((2, 4, 2)))
    for _ in range(5):
        seen.take(twice, {"not_on_map": 2, "duplicate": 2}, tag_map)
    assert any("seen twice in a frame" in line for line in seen.words(tag_map, 99))
