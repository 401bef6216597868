"""WPILib's field layouts (JSON and CSV to 2026, JSON from 2027): x out of the tag, no size.

In WPILib's tag frame x points out of the face, y to the right of who looks at it and z up; so our
x (right) is their y, our y (up) their z, our z (out) their x. The layouts name no family: FRC
prints 36h11. PhotonVision's documentation (coordinate systems) says the same of the axes.
A CSV has `ID,X,Y,Z,Z-Rotation[,Y-Rotation]` in inches and degrees, as convert_apriltag_layouts.py
reads it: yaw about z, then pitch about y, whatever the sixth column is called.
"""

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from tagvo.maps.formats.common import (
    Content,
    Exported,
    Format,
    Imported,
    ReadOptions,
    build_map,
    family_or,
    field,
    listed,
    need_mapping,
    table_rows,
    tag_dicts,
    xyz,
)
from tagvo.tags.tag_map import TagMap, unit_quaternion

R_FT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])  # T in FRC's tag frame F
_INCH = 0.0254  # [m]
_COLUMNS = ("ID", "X", "Y", "Z", "Z-Rotation", "Y-Rotation")
_QUAT = ("W", "X", "Y", "Z")


def _turned(q_WF: list[float], R: Array) -> list[float]:
    turned = geo.quat_from_matrix(geo.matrix_from_quat(np.array(q_WF)) @ R)
    return [float(x) for x in np.round(turned, 12) + 0.0]


def _recogniser(tags: str, extent: str) -> Callable[[Content], bool]:
    def recognises(content: Content) -> bool:
        if isinstance(content, list):
            return tags == "tags" and _is_csv(content)
        return tags in content and (extent in content or tags != "tags")

    return recognises


def _is_csv(rows: list[list[str]]) -> bool:
    return bool(rows) and [word.strip().lower() for word in rows[0][:4]] == ["id", "x", "y", "z"]


def _read_csv(rows: list[list[str]], where: str, options: ReadOptions) -> Imported:
    tags = []
    for tag_id, x, y, z, yaw, pitch in (
        row[: len(_COLUMNS)] for row in table_rows(rows[1:], _COLUMNS, where, len(_COLUMNS) - 1)
    ):
        R_WF = geo.matrix_from_rpy(0.0, *np.radians([pitch, yaw]))
        p_WT = [_INCH * v for v in (x, y, z)]
        q_WT = _turned(geo.quat_from_matrix(R_WF).tolist(), R_FT)
        tags.append({"id": int(tag_id), "p": p_WT, "q": q_WT})
    family, notes = family_or("tag36h11", options, "what FRC prints")
    return Imported(build_map(tags, family, where, options), notes)


def _reader(title: str, tags_key: str) -> Callable[[Content, str, ReadOptions], Imported]:
    def read(content: Content, where: str, options: ReadOptions) -> Imported:
        if isinstance(content, list) and _is_csv(content):
            return _read_csv(content, where, options)
        data = need_mapping(content, where, title)
        tags = []
        for i, tag in enumerate(listed(field(data, [tags_key], where), f"{where} {tags_key}")):
            here = f"{where} {tags_key}[{i}]"
            quaternion = field(tag, ["pose", "rotation", "quaternion"], here)
            q_WF = unit_quaternion(
                [field(quaternion, [k], f"{here} rotation") for k in _QUAT], here
            )
            p_WT = xyz(field(tag, ["pose", "translation"], here), f"{here} translation")
            tags.append({"id": field(tag, ["ID"], here), "p": p_WT, "q": _turned(q_WF, R_FT)})
        family, notes = family_or("tag36h11", options, "what FRC prints")
        return Imported(build_map(tags, family, where, options), notes)

    return read


def _writer(tags_key: str, extent_key: str) -> Callable[[TagMap], Exported]:
    def write(tag_map: TagMap) -> Exported:
        tags = [_frc_tag(tag) for tag in tag_dicts(tag_map)]
        length, width = (max(0.0, float(x)) for x in np.round(tag_map.p_WT.max(axis=0)[:2], 6))
        data = {tags_key: tags, extent_key: {"length": length, "width": width}}
        loss = f"the field's size is not on the map: {length:g} x {width:g} m, the tags' extent"
        return Exported(json.dumps(data, indent=2) + "\n", (loss,))

    return write


def _frc_tag(tag: dict[str, Any]) -> dict[str, Any]:
    quaternion = dict(zip(_QUAT, _turned(tag["q"], R_FT.T), strict=True))
    translation = dict(zip("xyz", tag["p"], strict=True))
    return {
        "ID": tag["id"],
        "pose": {"translation": translation, "rotation": {"quaternion": quaternion}},
    }


def _format(title: str, tags: str, extent: str) -> Format:
    return Format(
        title,
        frozenset({"pose"}),
        _recogniser(tags, extent),
        _reader(title, tags),
        _writer(tags, extent),
    )


FORMAT_2026 = _format("WPILib field layout (to 2026)", "tags", "field")
FORMAT_2027 = _format("WPILib field layout (from 2027)", "field-tags", "field-dimensions")
