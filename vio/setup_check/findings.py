"""What a set-up check has found, in one record, and its words."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from tagvo.geometry import Array

Code = Literal[
    "cam_imu_rotation", "mirrored", "imu_axes", "time_offset", "stamp_unit", "size_kind",
    "no_specific_force", "gravity",
]  # fmt: skip


SHORT: dict[Code, str] = {  # for a line of 50 letters on a ground station
    "cam_imu_rotation": "T_cam_imu is turned",
    "mirrored": "gyro or T_cam_imu mirrored",
    "imu_axes": "IMU axes are wrong",
    "time_offset": "camera and IMU clocks apart",
    "stamp_unit": "stamps in a wrong unit",
    "size_kind": "tag sizes of the map are wrong",
    "no_specific_force": "IMU without specific force",
    "gravity": "force does not point up",
}


@dataclass(frozen=True, slots=True)
class Finding:
    """One mistake of a set-up: what it is, how large (deg, s or a ratio), whether beyond doubt."""

    code: Code
    text: str
    value: float
    certain: bool

    def plain(self) -> dict[str, Any]:
        """As run.json and the status file hold it."""
        return asdict(self)


def axes_words(S: Array) -> str:
    """What a signed permutation (3, 3) does to the IMU's axes, as a person would say it."""
    if np.array_equal(S, np.diag([1.0, -1.0, -1.0])):
        return "y and z have the other sign (FRD where FLU is needed)"
    names = "xyz"
    parts = []
    for i, row in enumerate(S):
        j = int(np.argmax(np.abs(row)))
        if j != i or row[j] < 0.0:
            sign = "-" if row[j] < 0.0 else ""
            parts.append(f"{names[i]} is {sign}{names[j]} of what comes")
    return ", ".join(parts)
