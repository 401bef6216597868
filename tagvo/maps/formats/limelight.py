"""Limelight's `.fmap`: millimetres, row-major 4x4 in metres, origin in the middle of the field.

Its documentation names no tag axes; WPILib's are taken (x out of the face, y right, z up), because
its 2024 field holds, tag by tag, WPILib's rotations (tag 1: 120 deg about z in both) and WPILib's
positions minus half the field. The map keeps the file's origin.
"""

import json
import re
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.errors import MapError, shown
from tagvo.geometry import Array
from tagvo.maps.formats.common import (
    Content,
    Exported,
    Format,
    Imported,
    ReadOptions,
    build_map,
    field,
    listed,
    need_mapping,
    tag_dicts,
)
from tagvo.maps.formats.wpilib import R_FT
from tagvo.tags.families import FAMILIES
from tagvo.tags.tag_map import TagMap, numbers
from tagvo.textfile import finite_number

TITLE = "Limelight .fmap"
_BY_CODE = {code.group(): name for name in FAMILIES if (code := re.search(r"\d+h\d+$", name))}
_KIND = {"Standard": "standard", "Circle": "circle", "Custom": "custom"}


def _recognises(content: Content) -> bool:
    return isinstance(content, dict) and "fiducials" in content


def _family_name(theirs: object, where: str) -> str:
    code = re.search(r"\d+h\d+", str(theirs))
    if code is None or code.group() not in _BY_CODE:
        raise MapError(
            f"{where}: {shown(theirs)}; a family such as apriltag3_36h11_classic is needed"
        )
    return _BY_CODE[code.group()]


def _their_name(family: str) -> str:
    kind = re.match(r"tag([A-Za-z]*)(\d+h\d+)$", family)
    if kind is None:
        raise MapError(f"{TITLE}: {family} is no AprilTag family; Limelight reads those alone")
    return f"apriltag3_{kind.group(2)}_{_KIND.get(kind.group(1), 'classic')}"


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    data = need_mapping(content, where, TITLE)
    fiducials = listed(field(data, ["fiducials"], where), f"{where} fiducials")
    named = [
        _family_name(tag.get("family"), f"{where} fiducials[{i}] family")
        for i, tag in enumerate(fiducials)
    ]
    families = sorted(set(named))
    if options.family is None and len(families) > 1:
        raise MapError(f"{where}: tags of {', '.join(families)}; --family picks one")
    family = options.family or (families[0] if families else "tag36h11")
    notes = [f"origin: the file's, the middle of the field ({TITLE})"]
    tags = []
    for i, (tag, name) in enumerate(zip(fiducials, named, strict=True)):
        if name.lower() != family.lower():
            notes.append(f"tag {tag.get('id')} left out: it is of {name}")
        elif tag.get("unique", 1) in (0, False):
            notes.append(f"tag {tag.get('id')} left out: it stands in several places (unique: 0)")
        else:
            tags.append(_tag(tag, f"{where} fiducials[{i}]"))
    return Imported(build_map(tags, family, where, options), tuple(notes))


def _tag(tag: dict[str, Any], where: str) -> dict[str, Any]:
    matrix = np.array(numbers(field(tag, ["transform"], where), 16, f"{where} transform"))
    T_WF = matrix.reshape(4, 4)
    R_WF: Array = T_WF[:3, :3]
    off = float(np.abs(R_WF @ R_WF.T - np.eye(3)).max())
    if off > 2e-3 or np.linalg.det(R_WF) < 0 or not np.allclose(T_WF[3], [0, 0, 0, 1]):
        raise MapError(f"{where} transform: no rigid transform, row-major (off by {off:.2g})")
    millimetres = finite_number(field(tag, ["size"], where), f"{where} size", MapError)
    return {
        "id": tag.get("id"),
        "size": millimetres / 1000.0,
        "p": T_WF[:3, 3].tolist(),
        "q": geo.quat_from_matrix(geo.project_to_so3(R_WF) @ R_FT).tolist(),
    }


def _write(tag_map: TagMap) -> Exported:
    family = _their_name(tag_map.family.name)
    fiducials = []
    for tag in tag_dicts(tag_map):
        T_WF = np.eye(4)
        T_WF[:3, :3] = geo.matrix_from_quat(np.array(tag["q"])) @ R_FT.T
        T_WF[:3, 3] = tag["p"]
        transform = (np.round(T_WF, 12) + 0.0).ravel().tolist()
        millimetres = round(1000.0 * tag["size"], 6)
        fiducials.append(
            {
                "family": family,
                "id": tag["id"],
                "size": millimetres,
                "transform": transform,
                "unique": 1,
            }
        )
    loss = "Limelight takes the origin for the middle of the field; the map's own is written"
    return Exported(json.dumps({"type": "frc", "fiducials": fiducials}) + "\n", (loss,))


FORMAT = Format(TITLE, frozenset({"pose", "size", "family"}), _recognises, _read, _write)
