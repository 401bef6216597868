"""Bags of a flight log by rosbags' writers, message by message, apart from our own writer."""

from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from vio.convert.link_messages import APRILTAG_MSGS
from vio.sources.flight_log.log import FlightLog


class Bag:
    """One bag that is being written; kind: ros1, sqlite3 or mcap."""

    def __init__(self, path: Path, kind: str):
        self.one = kind == "ros1"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.one else Stores.ROS2_HUMBLE)
        self.writer = Writer1(path) if self.one else Writer2(
            path, version=9, storage_plugin=StoragePlugin[kind.upper()])  # fmt: skip
        self.ways, self.seq = {}, 0
        if not self.one:
            for name, text in APRILTAG_MSGS.items():
                self.store.register(get_types_from_msg(text, name))

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *exc):
        self.writer.close()

    def new(self, kind, **fields):
        return self.store.types[kind](**fields)

    def head(self, t_ns, frame="x"):
        stamp = self.new("builtin_interfaces/msg/Time", sec=t_ns // 10**9, nanosec=t_ns % 10**9)
        more = {"seq": self.seq} if self.one else {}
        return self.new("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def put(self, topic, message, t_ns):
        kind = message.__msgtype__
        if topic not in self.ways:
            self.ways[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        pack = self.store.serialize_ros1 if self.one else self.store.serialize_cdr
        self.writer.write(self.ways[topic], t_ns, pack(message, kind))

    def vector(self, v, kind="Vector3"):
        x, y, z = map(float, v)
        return self.new(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, q):
        w, x, y, z = map(float, q)
        return self.new("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def imu(self, topic, s):
        nine = np.zeros(9)
        self.put(topic, self.new(
            "sensor_msgs/msg/Imu", header=self.head(s.t_ns),
            orientation=self.quaternion([1, 0, 0, 0]), orientation_covariance=nine,
            angular_velocity=self.vector(s.gyro_I), angular_velocity_covariance=nine,
            linear_acceleration=self.vector(s.accel_I),
            linear_acceleration_covariance=nine), s.arrival_ns)  # fmt: skip

    def image(self, topic, frame, encoding="mono8", data=None, step=None):
        h, w = frame.image.shape[:2]
        data = frame.image.reshape(-1) if data is None else data
        self.put(topic, self.new(
            "sensor_msgs/msg/Image", header=self.head(frame.t_ns), height=h, width=w,
            encoding=encoding, is_bigendian=0, step=step or w, data=data),
            frame.arrival_ns)  # fmt: skip

    def pose(self, topic, t_ns, p, q):
        pose = self.new("geometry_msgs/msg/Pose", position=self.vector(p, "Point"),
                        orientation=self.quaternion(q))  # fmt: skip
        message = self.new("geometry_msgs/msg/PoseStamped", header=self.head(t_ns), pose=pose)
        self.put(topic, message, t_ns)


def bag_of(log: FlightLog, path: Path, kind: str) -> Path:
    """All that a flight log offers, recorded as it arrived."""
    with Bag(path, kind) as bag:
        for event in log.events():
            if hasattr(event, "gyro_I"):
                bag.imu("/imu/data_raw", event)
            elif hasattr(event, "image"):
                bag.image("/camera/image_raw", event)
        for row in range(len(log.truth)):
            truth = log.truth
            bag.pose("/vicon/drone", int(truth.t_ns[row]), truth.p_WI[row], truth.q_WI[row])
    return path
