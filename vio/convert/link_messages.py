"""ROS messages, of either ROS, as arrays: stamps, IMU samples, poses, tags, calibrations."""

from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.detect.apriltag import upright
from tagvo.geometry import Array
from tagvo.records import Detections
from vio.convert.topics import ODOMETRY, POSE, TRANSFORM

APRILTAG_MSGS = {  # no ROS's own type store has them
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y\n",
    "apriltag_msgs/msg/AprilTagDetection": "string family\nint32 id\nint32 hamming\n"
    "float32 goodness\nfloat32 decision_margin\napriltag_msgs/Point centre\n"
    "apriltag_msgs/Point[4] corners\nfloat64[9] homography\n",
    "apriltag_msgs/msg/AprilTagDetectionArray": "std_msgs/Header header\n"
    "apriltag_msgs/AprilTagDetection[] detections\n",
}
Pose = tuple[Array, Array, Array]


def stamp_ns(message: Any) -> int:
    """The stamp of a message's header [ns]."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def imu_values(message: Any) -> tuple[Array, Array]:
    """Gyro (3,) [rad/s] and specific force (3,) [m/s^2]."""
    return _xyz(message.angular_velocity), _xyz(message.linear_acceleration)


def pose_values(message: Any, kind: str) -> Pose:
    """p (3,), q (4,) wxyz and v (3,) in the world, NaN where the message has none."""
    v = np.full(3, np.nan)
    if kind == TRANSFORM:
        p, q = message.transform.translation, message.transform.rotation
    else:
        pose = message.pose if kind == POSE else message.pose.pose
        p, q = pose.position, pose.orientation
    q_WI = np.array([q.w, q.x, q.y, q.z], dtype=float)
    if kind == ODOMETRY and np.linalg.norm(q_WI) > 0.5:  # its twist is in the child's frame
        v = geo.matrix_from_quat(q_WI) @ _xyz(message.twist.twist.linear)
    return _xyz(p), q_WI, v


def family_of(message: Any) -> str:
    """The family that an apriltag_msgs array names; empty: it has no tag, or names none."""
    return str(message.detections[0].family) if len(message.detections) else ""


def tags_of(message: Any) -> Detections:
    """The tags of an apriltag_msgs array, whose corners are the AprilTag library's own."""
    found = message.detections
    corners = np.array([[(c.x, c.y) for c in tag.corners] for tag in found], dtype=float)
    corners = upright(corners.reshape(-1, 4, 2))
    return Detections.of(
        np.array([tag.id for tag in found], dtype=np.int64),
        corners,
        np.array([tag.hamming for tag in found], dtype=np.int64),
        np.array([tag.decision_margin for tag in found], dtype=float),
    )


def calibration(message: Any, rectified: bool = False) -> dict[str, Any] | None:
    """A CameraInfo as its YAML file would say it (ROS 1 has capital letters).

    rectified: of its rectified images: P without distortion. None where it is not calibrated.
    """
    k = message.K if hasattr(message, "K") else message.k
    d = message.D if hasattr(message, "D") else message.d
    p = message.P if hasattr(message, "P") else message.p
    if float(k[0]) == 0.0 or (rectified and float(p[0]) == 0.0):
        return None
    if rectified:
        return {
            "image_width": int(message.width),
            "image_height": int(message.height),
            "camera_matrix": {"data": [float(p[i]) for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)]},
            "distortion_model": "none",
        }
    return {
        "image_width": int(message.width),
        "image_height": int(message.height),
        "camera_matrix": {"data": [float(x) for x in k]},
        "distortion_model": str(message.distortion_model),
        "distortion_coefficients": {"data": [float(x) for x in d]},
    }


def _xyz(vector: Any) -> Array:
    return np.array([vector.x, vector.y, vector.z], dtype=float)
