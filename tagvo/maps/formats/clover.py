"""Clover's `map.txt`: `id length x y z yaw pitch roll`, a line a tag; its tag axes are ours.

A row may end after y: what is left out is 0.
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

TITLE = "Clover map.txt"
_COLUMNS = ("id", "length", "x", "y", "z", "yaw", "pitch", "roll")
_LEAST = 4  # id length x y


def _recognises(content: Content) -> bool:
    return isinstance(content, list) and all(
        _LEAST <= len(words) <= len(_COLUMNS) for words in content
    )


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    tags = []
    for tag_id, length, x, y, z, yaw, pitch, roll in (
        row[: len(_COLUMNS)] for row in table_rows(content, _COLUMNS, where, _LEAST)
    ):
        q_WT = geo.quat_from_matrix(geo.matrix_from_rpy(roll, pitch, yaw))
        tags.append({"id": int(tag_id), "size": length, "p": [x, y, z], "q": q_WT.tolist()})
    family, notes = family_or("DICT_4X4_250", options, "Clover's default dictionary")
    return Imported(build_map(tags, family, where, options), notes)


def _write(tag_map: TagMap) -> Exported:
    lines = ["# " + "\t".join(_COLUMNS)]
    for tag, rpy in zip(tag_dicts(tag_map), geo.rpy_from_matrix(tag_map.R_WT), strict=True):
        values = [tag["size"], *tag["p"], *(np.round(rpy[::-1], 12) + 0.0)]
        lines.append("\t".join([str(tag["id"]), *(f"{float(v):.12g}" for v in values)]))
    return Exported("\n".join(lines) + "\n")


FORMAT = Format(TITLE, frozenset({"pose", "size"}), _recognises, _read, _write)
