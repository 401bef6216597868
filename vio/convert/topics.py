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
    "accel": ("sensor_msgs/msg/Imu",),  # where the gyro is on a topic of its own
    "image": (IMAGE, COMPRESSED),
    "truth": (ODOMETRY, POSE, POSE_COV, TRANSFORM),
    "camera": ("sensor_msgs/msg/CameraInfo",),
    "detections": (TAGS,),
}
_LIKE = {  # names that speak for a topic
    "imu": r"imu",
    "accel": r"acc",
    "image": r"(image_raw|image_mono|image_rect|image|cam)",
    "truth": r"(ground|truth|(\b|_)gt(\b|_)|vicon|mocap|optitrack|leica|qualisys|vrpn|natnet)",
    "camera": r"camera_info",
    "detections": r"(tag|detections)",
}
_UNLIKE = {  # and against one: the second camera, a depth image
    "image": r"(depth|disparity|right|cam1|infra2|overlay|debug|mask)",
    "camera": r"(depth|right|cam1|infra2)",
    "imu": r"(mag|temp|gyro|acc)",  # a topic of both halves before one of either
    "truth": r"(setpoint|target|command|cmd|vision_pose|local_position|estimate|odom_local)",
}
_GYRO, _ACCEL = r"gyro", r"acc(el|\b|_)"
_RECTIFIED = re.compile(r"(^|[/_])rect(ified|_mono|_colou?r)?($|[/_])")
_WORTH_NAMING = 8  # topics that a line can hold


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
    chosen: dict[str, Topic] = {}
    words: list[str] = []
    for what, types in TYPES.items():
        there = [t for t in topics if t.type in types and t.count > 0]
        fit = there
        name = named.get(what)
        if name == "none":
            continue
        if name is not None:
            chosen[what] = _named(what, name, topics, where)
            continue
        if what == "truth":
            fit, said = _speaking(fit, where)
            words += said
        if what == "accel":
            fit = _other_half(chosen.get("imu"), fit)
        if not fit:
            continue
        of = _parent(chosen["image"].name) if what == "camera" and "image" in chosen else ""
        best = max(fit, key=lambda t: (_parent(t.name) == of, *_likeness(what, t)))
        chosen[what] = best
        rest = [t.name for t in there if t is not best] if what != "accel" else []
        among = f", not {', '.join(rest)}" if rest else ""
        words.append(f"{where}: {what} is {best.name} ({best.type}, {best.count}){among};"
                     f" --topic {what}=NAME takes another, {what}=none nothing")  # fmt: skip
    return chosen, words


def is_rectified(name: str) -> bool:
    """Whether the name of an image topic says that its images are rectified: image_rect, ..."""
    return _RECTIFIED.search(name.lower()) is not None


def _speaking(fit: list[Topic], where: str) -> tuple[list[Topic], list[str]]:
    """The topics whose name speaks for truth, and a line that lists the others."""
    sure = [t for t in fit if re.search(_LIKE["truth"], t.name.lower())
            and not re.search(_UNLIKE["truth"], t.name.lower())]  # fmt: skip
    if sure or not fit:
        return sure, []
    names = ", ".join(t.name for t in fit[:_WORTH_NAMING])
    return [], [f"{where}: no topic whose name speaks for a truth, so none is taken; --topic"
                f" truth=NAME takes one of {names}"]  # fmt: skip


def _other_half(imu: Topic | None, fit: list[Topic]) -> list[Topic]:
    """The accelerometer's topics beside one that is the gyro's alone."""
    if imu is None or not re.search(_GYRO, imu.name.lower()):
        return []
    halves = [t for t in fit if re.search(_ACCEL, t.name.lower()) and t.name != imu.name]
    twin = [t for t in halves if re.sub(_ACCEL, "", t.name) == re.sub(_GYRO, "", imu.name)]
    return twin or halves


def _parent(name: str) -> str:
    """The camera's namespace of an image or a camera_info topic."""
    return re.sub(r"/(compressed|theora)$", "", name).rpartition("/")[0]


def _named(what: str, name: str, topics: Sequence[Topic], where: str) -> Topic:
    for topic in topics:
        if topic.name == name:
            if topic.type in TYPES[what]:
                return topic
            allowed = ", ".join(TYPES[what])
            raise LogError(f"{where}: {what} topic {name} is a {topic.type}; {allowed} is needed")
    there = ", ".join(sorted(t.name for t in topics)) or "none at all"
    raise LogError(f"{where}: no topic {name}; it has {there}")


def _likeness(what: str, topic: Topic) -> tuple[bool, bool, bool, bool, bool, int, str]:
    name = topic.name.lower()
    against = what in _UNLIKE and re.search(_UNLIKE[what], name) is not None
    speaks = re.search(_LIKE[what], name) is not None
    raw = not is_rectified(name)  # the calibration that everybody has is of raw images
    gyro = what == "imu" and re.search(_GYRO, name) is not None  # of two halves the one in charge
    return (not against, gyro, speaks, raw, topic.type != COMPRESSED, topic.count, name)
