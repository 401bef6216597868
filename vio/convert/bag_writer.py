"""Writes a ROS 2 bag in MCAP by rosbags, for those whose tools read nothing else."""

from pathlib import Path
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.detect.apriltag import as_library
from tagvo.geometry import Array
from tagvo.records import Detections, Frame
from vio.convert.link_messages import APRILTAG_MSGS
from vio.errors import LogError, VioError
from vio.records import ImuSample, Truth

MAP, BODY, CAMERA = "map", "imu0", "cam0"
_MODELS = {"radtan": "plumb_bob", "equidistant": "equidistant", "none": "plumb_bob"}


class BagWriter:
    """Owns a ROS 2 bag that is being written; topics: /imu0, /cam0/image_raw, /cam0/camera_info,
    /tags (apriltag_msgs), /truth (Odometry). Messages are recorded at their arrival.
    """

    def __init__(self, path: Path) -> None:
        """path: a folder that is not there yet; LogError where it is."""
        try:
            from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
            from rosbags.typesys import Stores, get_types_from_msg, get_typestore
        except ImportError:
            raise VioError("bags need rosbags: pip install 'tagvio[logs]'") from None
        self._store = get_typestore(Stores.ROS2_HUMBLE)
        for name, text in APRILTAG_MSGS.items():
            self._store.register(get_types_from_msg(text, name))
        try:
            self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
        except WriterError as err:
            raise LogError(f"{path}: {err}; name a folder that is not there yet") from None
        self._ways: dict[str, Any] = {}

    def __enter__(self) -> "BagWriter":
        return self

    def __exit__(self, *exc: object) -> None:
        self._writer.close()

    def imu(self, sample: ImuSample, name: str = BODY) -> None:
        """An IMU sample; its covariances are unknown (zero)."""
        nine, one = np.zeros(9), self._make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0,
                                            w=1.0)  # fmt: skip
        unknown = nine.copy()
        unknown[0] = -1.0  # no orientation
        message = self._make(
            "sensor_msgs/msg/Imu", header=self._header(sample.t_ns, BODY), orientation=one,
            orientation_covariance=unknown, angular_velocity=self._vector(sample.gyro_I),
            angular_velocity_covariance=nine, linear_acceleration=self._vector(sample.accel_I),
            linear_acceleration_covariance=nine,
        )  # fmt: skip
        self._write(f"/{name}", message, sample.arrival_ns)

    def truth(self, truth: Truth, row: int) -> None:
        """A pose of the IMU in the map, with its velocity in the IMU's frame."""
        q_WI = truth.q_WI[row]
        v_W = np.zeros(3) if truth.v_WI is None else np.nan_to_num(truth.v_WI[row])
        w, x, y, z = (float(c) for c in q_WI)
        pose = self._make(
            "geometry_msgs/msg/Pose",
            position=self._vector(truth.p_WI[row], "Point"),
            orientation=self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        twist = self._make(
            "geometry_msgs/msg/Twist", linear=self._vector(geo.matrix_from_quat(q_WI).T @ v_W),
            angular=self._vector(np.zeros(3)),
        )  # fmt: skip
        zero = np.zeros(36)
        t_ns = int(truth.t_ns[row])
        message = self._make(
            "nav_msgs/msg/Odometry", header=self._header(t_ns, MAP), child_frame_id=BODY,
            pose=self._make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=zero),
            twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=zero),
        )  # fmt: skip
        self._write("/truth", message, t_ns)

    def frame(self, frame: Frame, camera: Camera | None) -> None:
        """An image with the camera's calibration, where that is known; tags, where it has some."""
        known_ns = frame.t_ns if frame.arrival_ns is None else frame.arrival_ns
        if frame.detections is not None:
            self._write("/tags", self._tags(frame.t_ns, frame.detections), known_ns)
        if frame.image is None:
            return
        height, width = frame.image.shape[:2]
        channels = 1 if frame.image.ndim == 2 else 3
        message = self._make(
            "sensor_msgs/msg/Image", header=self._header(frame.t_ns, CAMERA), height=height,
            width=width, encoding="mono8" if channels == 1 else "bgr8", is_bigendian=0,
            step=width * channels, data=np.ascontiguousarray(frame.image).reshape(-1),
        )  # fmt: skip
        self._write("/cam0/image_raw", message, known_ns)
        if camera is not None:
            self._write("/cam0/camera_info", self._calibration(camera, frame.t_ns), known_ns)

    def _tags(self, t_ns: int, found: Detections) -> Any:
        """An apriltag_msgs array: the AprilTag library's corners; a corner's sigma is lost."""
        tags = []
        for i, corners in enumerate(as_library(found.corners_px)):
            centre, points = corners.mean(axis=0), [*corners]
            tags.append(self._make(
                "apriltag_msgs/msg/AprilTagDetection", family="", id=int(found.tag_id[i]),
                hamming=int(found.hamming[i]), goodness=0.0,
                decision_margin=float(np.nan_to_num(found.margin[i])), homography=np.zeros(9),
                centre=self._point(centre), corners=[self._point(p) for p in points],
            ))  # fmt: skip
        return self._make(
            "apriltag_msgs/msg/AprilTagDetectionArray", header=self._header(t_ns, CAMERA),
            detections=tags,
        )  # fmt: skip

    def _point(self, pixel: Array) -> Any:
        u, v = (float(x) for x in pixel)
        return self._make("apriltag_msgs/msg/Point", x=u, y=v)

    def _calibration(self, camera: Camera, t_ns: int) -> Any:
        fu, fv, pu, pv = (float(x) for x in camera.intrinsics)
        coeffs = np.zeros(5 if len(camera.coeffs) < 5 else len(camera.coeffs))
        coeffs[: len(camera.coeffs)] = camera.coeffs
        if camera.model == "equidistant":
            coeffs = coeffs[:4]
        model = "rational_polynomial" if len(coeffs) > 5 else _MODELS[camera.model]
        return self._make(
            "sensor_msgs/msg/CameraInfo", header=self._header(t_ns, CAMERA),
            height=camera.resolution[1], width=camera.resolution[0], distortion_model=model,
            d=coeffs, k=np.array([fu, 0.0, pu, 0.0, fv, pv, 0.0, 0.0, 1.0]),
            r=np.eye(3).reshape(-1),
            p=np.array([fu, 0.0, pu, 0.0, 0.0, fv, pv, 0.0, 0.0, 0.0, 1.0, 0.0]),
            binning_x=0, binning_y=0,
            roi=self._make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0,
                           width=0, do_rectify=False),
        )  # fmt: skip

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _header(self, t_ns: int, frame: str) -> Any:
        seconds, rest = divmod(t_ns, 1_000_000_000)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        return self._make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def _vector(self, values: Any, kind: str = "Vector3") -> Any:
        x, y, z = (float(v) for v in values)
        return self._make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _write(self, topic: str, message: Any, t_ns: int) -> None:
        kind = message.__msgtype__
        if topic not in self._ways:
            self._ways[topic] = self._writer.add_connection(topic, kind, typestore=self._store)
        self._writer.write(self._ways[topic], t_ns, self._store.serialize_cdr(message, kind))
