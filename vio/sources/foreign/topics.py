"""Which topic of a bag is the camera, which the IMU, which the truth: guessed, or as named."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vio.errors import LogError

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
ODOMETRY, TRANSFORM = "nav_msgs/msg/Odometry", "geometry_msgs/msg/TransformStamped"
POSE, POSE_COV = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped"
TAGS = "apriltag_msgs/msg/AprilTagDetectionArray"
TYPES = {  # what we look for -> the message types that may hold it
    "imu": ("sensor_msgs/msg/Imu",),
    "image": (IMAGE, COMPRESSED),
    "truth": (ODOMETRY, POSE, POSE_COV, TRANSFORM),
    "camera": ("sensor_msgs/msg/CameraInfo",),
    "detections": (TAGS,),
}
_LIKE = {  # names that speak for a topic
    "imu": r"imu",
    "image": r"(image_raw|image_mono|image_rect|image|cam)",
    "truth": r"(ground|truth|\bgt\b|vicon|mocap|optitrack|leica|qualisys)",
    "camera": r"camera_info",
    "detections": r"(tag|detections)",
}
_UNLIKE = {  # and against one: the second camera, a depth image
    "image": r"(depth|disparity|right|cam1|infra2|overlay|debug|mask)",
    "camera": r"(depth|right|cam1|infra2)",
    "imu": r"(mag|temp)",
}


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: its name, the type of its messages, how many there are."""

    name: str
    type: str
    count: int


def choose(
    topics: Sequence[Topic], named: Mapping[str, str], where: str
) -> tuple[dict[str, Topic], list[str]]:
    """The topic for each thing that the bag has, and in words what was chosen among what.

    named: by thing, a topic's name, or `none` for that thing to be left out. LogError where one
    that is named is not there or is of another type.
    """
    chosen, words = {}, []
    for what, types in TYPES.items():
        fit = [t for t in topics if t.type in types and t.count > 0]
        name = named.get(what)
        if name == "none":
            continue
        if name is not None:
            chosen[what] = _named(what, name, topics, where)
            continue
        if not fit:
            continue
        best = max(fit, key=lambda t: _likeness(what, t))
        chosen[what] = best
        rest = [t.name for t in fit if t is not best]
        among = f", not {', '.join(rest)}" if rest else ""
        words.append(f"{where}: {what} is {best.name} ({best.type}, {best.count}){among};"
                     f" --topic {what}=NAME takes another, {what}=none nothing")  # fmt: skip
    return chosen, words


def _named(what: str, name: str, topics: Sequence[Topic], where: str) -> Topic:
    for topic in topics:
        if topic.name == name:
            if topic.type in TYPES[what]:
                return topic
            allowed = ", ".join(TYPES[what])
            raise LogError(f"{where}: {what} topic {name} is a {topic.type}; {allowed} is needed")
    there = ", ".join(sorted(t.name for t in topics)) or "none at all"
    raise LogError(f"{where}: no topic {name}; it has {there}")


def _likeness(what: str, topic: Topic) -> tuple[bool, bool, bool, int, str]:
    name = topic.name.lower()
    against = what in _UNLIKE and re.search(_UNLIKE[what], name) is not None
    speaks = re.search(_LIKE[what], name) is not None
    return (not against, speaks, topic.type != COMPRESSED, topic.count, name)
