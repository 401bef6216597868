"""UbiquityRobotics' fiducials map: `id x y z rx ry rz(deg) variance numObs links...`, no sizes.

The angles are tf2's fixed-axis roll, pitch, yaw (R = Rz Ry Rx, `setRPY` in fiducial_slam/map.cpp)
and the tag frame is OpenCV's marker frame, ours: x right, y up, z out (a tag on the ceiling stands
in its maps with rx = 180). The variance is the weight of its own filter, not a laying sigma.
"""

import numpy as np

from tagvo import geometry as geo
from tagvo.maps.formats.common import (
    Content,
    Exported,
    Format,
    Imported,
    ReadOptions,
    build_map,
    family_or,
    table_rows,
    tag_dicts,
)
from tagvo.tags.tag_map import TagMap

TITLE = "fiducials map"
_COLUMNS = ("id", "x", "y", "z", "rx", "ry", "rz", "variance", "numObs")


def _recognises(content: Content) -> bool:
    return isinstance(content, list) and all(len(words) >= len(_COLUMNS) for words in content)


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    tags = []
    for row in table_rows(content, _COLUMNS, where):
        R_WT = geo.matrix_from_rpy(*np.radians(row[4:7]))
        q_WT = geo.quat_from_matrix(R_WT).tolist()
        tags.append({"id": int(row[0]), "p": row[1:4], "q": q_WT})
    family, notes = family_or("DICT_5X5_1000", options, "aruco_detect's default dictionary")
    notes += ("variances left out: they are the weights of fiducial_slam's filter",)
    return Imported(build_map(tags, family, where, options), notes)


def _write(tag_map: TagMap) -> Exported:
    lines = []
    angles = np.degrees(geo.rpy_from_matrix(tag_map.R_WT))
    for tag, rpy, sigma in zip(tag_dicts(tag_map), angles, tag_map.sigma, strict=True):
        values = [*tag["p"], *rpy, float(np.square(sigma[0]))]
        lines.append(" ".join([str(tag["id"]), *(f"{v + 0.0:.9f}" for v in values), "1"]))
    return Exported("\n".join(lines) + "\n")


FORMAT = Format(TITLE, frozenset({"pose"}), _recognises, _read, _write)
