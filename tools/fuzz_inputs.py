"""Small good inputs of every reader, made here, and what reads each: what tools/fuzz.py damages."""

import json
import os
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tagvo.camera.calibration import load_camera
from tagvo.errors import MapError
from tagvo.maps.check import check_map_data, summed_up
from tagvo.maps.formats import FORMATS, read_map_file, write_map_file
from tagvo.records import Detections, Frame
from tagvo.tags.tag_map import load_map, map_from_dict
from tagvo.textfile import read_yaml
from vio.config import load_config
from vio.convert.bag_writer import BagWriter
from vio.convert.open import read_foreign
from vio.mavlink.codec import read_key
from vio.mavlink.persistent_state import load_saved
from vio.records import ImuSample, Truth
from vio.sinks.tum import read_tum
from vio.sources.flight_log.files import (
    read_detections,
    read_frame_list,
    read_ground,
    read_imu,
    read_imu_noise,
    read_phases,
    read_truth,
)
from vio.sources.flight_log.log_frames import read_image
from vio.sources.flight_log.tally import Tally

T0 = 1_700_000_000_000_000_000
STEP = 5_000_000
ROWS = 12


@dataclass(frozen=True, slots=True)
class Reader:
    """One reader: the name of its file, good contents of it, what reads it, how many of the inputs
    it gets beside others (slow readers fewer)."""

    name: str
    file: str
    inputs: list[bytes]
    read: Callable[[Path], object]
    weight: float = 1.0


def readers(scratch: Path) -> list[Reader]:
    """All readers; scratch: an empty folder for files that only a library can write."""
    return [*_tables(), *_settings(scratch), *_logs(scratch), *_images(scratch), _mavlink()]


def _csv(header: str, rows: list[str]) -> list[bytes]:
    return ["\n".join([header, *rows]).encode() + b"\n"]


def _tables() -> list[Reader]:
    stamps = [T0 + i * STEP for i in range(ROWS)]
    imu = _csv("#timestamp [ns],w_x,w_y,w_z,a_x,a_y,a_z,arrival_ns,mean",
               [f"{t},0.1,-0.2,3e-3,0.5,0.25,9.81,{t + 9},0" for t in stamps])  # fmt: skip
    truth = _csv("#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z,v_x,v_y,v_z",
                 [f"{t},1,2,3.5,1,0,0,0,0.1,0.2,nan" for t in stamps])  # fmt: skip
    frames = _csv("#timestamp [ns],filename,arrival_ns", [f"{t},{t}.png,{t}" for t in stamps])
    corners = ",".join(f"{axis}_{c}" for c in ("tl", "tr", "br", "bl") for axis in "uv")
    seen = [f"{t},{i},10,10,20,10,20,20,10,20,0,50.5" for i, t in enumerate(stamps)]
    tags = _csv(f"#timestamp [ns],tag_id,{corners},hamming,decision_margin", seen)
    ground = _csv("#timestamp [ns],on_ground", [f"{t},{i % 2}" for i, t in enumerate(stamps)])
    phases = _csv("name,t_start_ns,t_end_ns", [f"a,{t},{t + STEP}" for t in stamps])
    tum = ["\n".join(f"{1e-9 * t:.9f} 1 2 3 0 0 0 1" for t in stamps).encode()]
    return [
        Reader("imu", "data.csv", imu, _tallied(read_imu), 2.0),
        Reader("truth", "data.csv", truth, _tallied(read_truth)),
        Reader("frames", "data.csv", frames, _tallied(read_frame_list)),
        Reader("detections", "detections.csv", tags, _tallied(read_detections)),
        Reader("ground", "data.csv", ground, _tallied(read_ground)),
        Reader("phases", "phases.csv", phases, _tallied(read_phases)),
        Reader("tum", "a.tum", tum, read_tum),
    ]


def _tallied(read: Callable[[Path, Tally], object]) -> Callable[[Path], object]:
    def run(path: Path) -> object:
        tally = Tally()
        return read(path, tally), tally.warnings

    return run


_MAP = """family: tag36h11
size_kind: border
sigma: {xy: 0.002, z: 0.001, yaw_deg: 0.3, tilt_deg: 0.1}
gravity: {dir: [0, 0, -1], sigma_deg: 1.0}
tags:
  - {id: 3, size: 0.2, p: [0, 0, 0], q: [1, 0, 0, 0]}
  - {id: 7, size: 0.1, p: [0.5, 0, 0], q: [1, 0, 0, 0], sigma: {xy: 0.001}}
"""
_CAMERA = """cam0:
  camera_model: pinhole
  intrinsics: [60.0, 60.0, 31.5, 23.5]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.0, 0.0]
  T_cam_imu: [[0, -1, 0, 0.1], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
  timeshift_cam_imu: 0.001
  resolution: [64, 48]
"""
_ROS = """image_width: 640
image_height: 480
camera_matrix: {rows: 3, cols: 3, data: [530, 0.2, 320, 0, 530, 240, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.05, 0.001, 0.0, 0.0]}
"""
_PHOTON = {
    "resolution": {"width": 640, "height": 480},
    "cameraIntrinsics": {"rows": 3, "cols": 3, "data": [530, 0, 320, 0, 530, 240, 0, 0, 1]},
    "distCoeffs": {"rows": 1, "cols": 5, "data": [-0.2, 0.05, 0.001, 0, 0]},
}
_OST = """# oST version 5.0 parameters

[image]

width
640

height
480

[narrow_stereo]

camera matrix
530.0 0.0 319.5
0.0 530.0 239.5
0.0 0.0 1.0

distortion
-0.18 0.05 0.001 -0.0005 0.0
"""
_NOISE = """update_rate: 200.0
accelerometer_noise_density: 2e-3
accelerometer_random_walk: 3.0e-3
gyroscope_noise_density: 1.7e-04
gyroscope_random_walk: 1e-5
"""
_CONFIG = """tagvo: {pose: joint, noise: {corner_px: 0.3}, detector: {threads: 1}}
vio: {update: pose, gate: 1.0, prior: {position_m: 0.5}, recovery: {rejects: 5}}
vehicle:
  T_BI: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
mavlink: {url: 'udpin:127.0.0.1:14540', origin: {lat_deg: 47.3, lon_deg: 8.5, alt_m: 400}}
daemon: {map: tagmap.yaml, camera: {device: /dev/video0, rate_hz: 30}, record: {folder: null}}
"""
_WPILIB_CSV = "ID,X,Y,Z,Z-Rotation,Y-Rotation\n1,467.6,292.3,35,180,0\n2,469.1,182.6,44.25,90,30\n"


def _settings(scratch: Path) -> list[Reader]:
    cameras = [_CAMERA, _ROS, json.dumps(_PHOTON), _OST]
    maps = [_WPILIB_CSV.encode(), b"1\t0.33\t0\t0\t0\t0\t0\t0\n2 0.2 1 1\n"]
    (scratch / "m.yaml").write_text(_MAP)
    tag_map = load_map(scratch / "m.yaml")
    for name in FORMATS:
        try:
            write_map_file(tag_map, scratch / "m.txt", name)
        except MapError:  # a board of tags at other places than a grid
            continue
        maps.append((scratch / "m.txt").read_bytes())
    saved = json.dumps({"reset_counter": 7, "signing_timestamp": 35_000_000_000_000}).encode()
    sized = partial(read_map_file, size=0.165)
    return [
        Reader("map", "tagmap.yaml", [_MAP.encode()], _map, 2.0),
        Reader("camera", "camera.yaml", [text.encode() for text in cameras], load_camera, 2.0),
        Reader("noise", "imu.yaml", [_NOISE.encode()], read_imu_noise),
        Reader("config", "config.yaml", [_CONFIG.encode()], load_config),
        Reader("mapformats", "map.txt", maps, sized, 2.0),
        Reader("state", "mavlink.json", [saved], load_saved, 2.0),
        Reader(
            "key", "key", [b"00112233445566778899aabbccddeeff" * 2, b"a passphrase\n"], read_key
        ),
    ]


def _map(path: Path) -> object:
    data = read_yaml(path, MapError)
    lines = summed_up(check_map_data(data, str(path)))
    return lines, map_from_dict(data, str(path)).corners_W


def _logs(scratch: Path) -> list[Reader]:
    mcap = _ros2_bag(scratch / "two")
    tally = partial(_foreign, stamps=None)
    return [
        Reader("mcap", "a.mcap", [mcap], tally, 0.4),
        Reader("ros1", "a.bag", [_ros1_bag(scratch / "one.bag")], tally, 0.4),
        Reader("dataflash", "a.bin", [_dataflash(True), _dataflash(False)], tally, 0.7),
        Reader("ulog", "a.ulg", [_ulog()], tally),
        Reader("tlog", "a.tlog", [_tlog(scratch / "a.tlog")], tally, 0.4),
    ]


def _foreign(path: Path, stamps: Path | None) -> object:
    tally = Tally()
    found = read_foreign(path, tally, {}, stamps)
    frames = [] if found.frames is None else list(found.frames.open())
    return len(frames), tally.warnings


def _ros2_bag(path: Path) -> bytes:
    tags = Detections.of(np.array([3]), np.array([[[9.0, 9], [20, 9], [20, 20], [9, 20]]]))
    image = np.arange(256, dtype=np.uint8).reshape(16, 16)
    camera = replace(load_camera_text(path.parent), resolution=(16, 16))
    truth = Truth(np.array([T0]), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]), np.zeros((1, 3)))
    with BagWriter(path) as bag:
        for i in range(4):
            t = T0 + i * STEP
            bag.imu(ImuSample(t, np.ones(3), np.array([0.0, 0, 9.8]), t + 99))
        bag.truth(truth, 0)
        bag.frame(Frame(T0, image, tags, T0 + 5), camera)
    return next(path.glob("*.mcap")).read_bytes()


def load_camera_text(folder: Path) -> Any:
    (folder / "c.yaml").write_text(_CAMERA)
    return load_camera(folder / "c.yaml")


def _ros1_bag(path: Path) -> bytes:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    make = store.types
    with Writer(path) as bag:
        way = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for i in range(4):
            stamp = make["builtin_interfaces/msg/Time"](sec=T0 // 10**9, nanosec=i * STEP)
            head = make["std_msgs/msg/Header"](seq=i, stamp=stamp, frame_id="i")
            xyz = make["geometry_msgs/msg/Vector3"](x=0.1, y=0.2, z=9.8)
            turn = make["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0)
            nine = np.zeros(9)
            imu = make["sensor_msgs/msg/Imu"](head, turn, nine, xyz, nine, xyz, nine)
            bag.write(way, T0 + i * STEP, store.serialize_ros1(imu, "sensor_msgs/msg/Imu"))
    return path.read_bytes()


def _dataflash(raw: bool) -> bytes:
    """A DataFlash log: FMT of each message, then its rows; raw: GYR and ACC, else IMU and IMU2."""
    kinds = {
        True: [("GYR", "QBQfff", "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ"),
               ("ACC", "QBQfff", "TimeUS,I,SampleUS,AccX,AccY,AccZ")],
        False: [("IMU", "Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
                ("SIM", "Qffff", "TimeUS,Q1,Q2,Q3,Q4"),
                ("SIM2", "Qffffff", "TimeUS,PN,PE,PD,VN,VE,VD")],
    }[raw]  # fmt: skip
    fmt = struct.Struct("<BB4s16s64s")
    out = b"\xa3\x95\x80" + fmt.pack(128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    for number, (name, form, columns) in enumerate(kinds, start=150):
        row = struct.Struct("<" + form)
        head = fmt.pack(number, row.size + 3, name.encode(), form.encode(), columns.encode())
        out += b"\xa3\x95\x80" + head
    for i in range(6):
        for number, (_, form, _) in enumerate(kinds, start=150):
            row = struct.Struct("<" + form)
            us = [1_000_000 + 5000 * i, 0, 1_000_000 + 5000 * i] if raw else [10**6 + 5000 * i]
            values = [1.0, 0.0, 0.0, 0.0, 0.0, 9.8][: len(form) - len(us)]
            out += b"\xa3\x95" + bytes([number]) + row.pack(*us, *values)
    return out


def _ulog() -> bytes:
    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message("B", bytes(40))
    text = b"sensor_combined:uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    out += message("F", text) + message("I", b"\x0bchar[4] sysPX4_")
    out += message("A", struct.pack("<BH", 0, 1) + b"sensor_combined")
    for i in range(6):
        row = struct.pack("<HQ6f", 1, 10**6 + 5000 * i, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8)
        out += message("D", row)
    return out + message("O", struct.pack("<H", 5))


def _mavlink_frames() -> list[bytes]:
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    link = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    out = [link.heartbeat_encode(2, 3, 81, 0, 4).pack(link)]
    for i in range(4):
        us = 10**6 + 5000 * i
        out.append(
            link.highres_imu_encode(us, 0, 0, -9.8, 0.1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 63).pack(link)
        )
        out.append(link.scaled_imu_encode(us // 1000, 0, 0, -1000, 9, 0, 0, 0, 0, 0).pack(link))
    out.append(link.timesync_encode(10**9, 10**9 + 5).pack(link))
    out.append(link.attitude_encode(1000, 0, 0, 0, 0, 0, 0).pack(link))
    out.append(link.system_time_encode(T0 // 1000, 1000).pack(link))
    return out


def _tlog(path: Path) -> bytes:
    frames = _mavlink_frames()
    return b"".join(struct.pack(">Q", T0 // 1000 + i) + f for i, f in enumerate(frames))


def _images(scratch: Path) -> list[Reader]:
    image = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    files = [cv2.imencode(end, image)[1].tobytes() for end in (".png", ".jpg", ".bmp", ".pgm")]
    wide = cv2.VideoWriter_fourcc(*"MJPG")  # type: ignore[attr-defined]
    writer = cv2.VideoWriter(str(scratch / "v.avi"), wide, 10.0, (64, 48), isColor=False)
    for _ in range(3):
        writer.write(image)
    writer.release()
    video = (scratch / "v.avi").read_bytes()
    return [
        Reader("image", "1.png", files, read_image, 2.0),
        Reader("video", "a.avi", [video], partial(_foreign, stamps=None), 0.1),
    ]


def _mavlink() -> Reader:
    """Frames as they come from a socket, into the codec and what listens to it."""
    from vio.config import Config
    from vio.mavlink.bridge import Bridge

    config = Config().mavlink.model_copy(update={"state_file": os.devnull})

    def read(path: Path) -> object:
        from pymavlink.dialects.v20 import ardupilotmega as dialect

        from vio.sources.live.imu import MavlinkImu

        codec = dialect.MAVLink(None)
        codec.robust_parsing = True
        companion = Bridge(config, np.eye(3), np.zeros(3)).companion
        imu = MavlinkImu(companion, np.eye(3), lambda sample: None)
        now = T0
        for message in codec.parse_buffer(path.read_bytes()) or []:
            now += STEP
            if message.get_type() != "BAD_DATA":
                companion.heard(message, now)
                imu.heard(message, now)
        return companion.counters, imu.counters

    return Reader("mavlink", "frames", [b"".join(_mavlink_frames())], read, 1.0)
