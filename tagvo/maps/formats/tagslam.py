"""TagSLAM's `tagslam.yaml` and `poses.yaml`: static bodies carry tags; noises are sigmas.

Its tag frame is ours (x right, y up, z out). Rotations are rotation vectors [rad]. A noise is the
standard deviation in the tag's own tangent space (GTSAM's), so x and y of the rotation are our
tilt and z our yaw; of two that differ the larger one is taken.
"""

from typing import Any

import numpy as np
import yaml

from tagvo import geometry as geo
from tagvo.errors import MapError, choose_one_of, shown
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
    tag_dicts,
    xyz,
)
from tagvo.tags.tag_map import TagMap, numbers

TITLE = "TagSLAM poses"


def _recognises(content: Content) -> bool:
    return isinstance(content, dict) and "bodies" in content


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    data = need_mapping(content, where, TITLE)
    bodies = _bodies(data, where)
    notes: list[str] = []
    if options.bundle is not None:
        if options.bundle not in bodies:
            raise MapError(choose_one_of(f"{where} body", options.bundle, bodies))
        chosen = {options.bundle: {**bodies[options.bundle], "pose": None}}
    else:
        chosen = {name: body for name, body in bodies.items() if body.get("is_static", False)}
        notes += [f"body {name} left out: it moves" for name in bodies if name not in chosen]
        if not chosen:
            names = ", ".join(bodies)
            raise MapError(f"{where}: no static body; --bundle takes one of {names} as the map")
    tags = []
    for name, body in chosen.items():
        tags += _tags_of(body, f"{where} body {name}", notes)
    if not tags:
        raise MapError(f"{where}: no tag of {', '.join(chosen)} has a pose; see poses.yaml")
    family, assumed = family_or("tag36h11", options, "what TagSLAM detects")
    return Imported(build_map(tags, family, where, options), (*assumed, *notes))


def _bodies(data: dict[str, Any], where: str) -> dict[str, dict[str, Any]]:
    """Bodies by name; the file lists them as mappings of one name each."""
    found = {}
    for i, entry in enumerate(listed(field(data, ["bodies"], where), f"{where} bodies")):
        for name, body in entry.items():
            if not isinstance(body, dict):
                raise MapError(f"{where} bodies[{i}] {name}: {shown(body)}; a mapping is needed")
            found[str(name)] = body
    return found


def _tags_of(body: dict[str, Any], where: str, notes: list[str]) -> list[dict[str, Any]]:
    """Tags of a body in W: the body's own pose (identity where it has none) times the tag's."""
    R_WB, p_WB = np.eye(3), np.zeros(3)
    if body.get("pose") is not None:
        R_WB, p_WB = _pose(body["pose"], f"{where} pose")
    tags = []
    for i, tag in enumerate(listed(body.get("tags") or [], f"{where} tags")):
        here = f"{where} tag {tag.get('id', i)}"
        if tag.get("pose") is None:
            notes.append(f"tag {tag.get('id')} left out: it has no pose")
            continue
        R_BT, p_BT = _pose(tag["pose"], here)
        R_WT, p_WT = geo.compose(R_WB, p_WB, R_BT, p_BT)
        entry = {
            "id": tag.get("id"),
            "size": tag.get("size", body.get("default_tag_size")),
            "p": p_WT.tolist(),
            "q": geo.quat_from_matrix(R_WT).tolist(),
        }
        if sigma := _sigma(tag["pose"], here):
            entry["sigma"] = sigma
        tags.append(entry)
    return tags


def _pose(pose: object, where: str) -> tuple[Array, Array]:
    position = numbers(xyz(field(pose, ["position"], where), where), 3, f"{where} position")
    rotation = numbers(xyz(field(pose, ["rotation"], where), where), 3, f"{where} rotation")
    return geo.exp(np.array(rotation)), np.array(position)


def _sigma(pose: dict[str, Any], where: str) -> dict[str, float]:
    sigma: dict[str, float] = {}
    if pose.get("position_noise") is not None:
        x, y, z = numbers(xyz(pose["position_noise"], where), 3, f"{where} position_noise")
        sigma |= {"xy": max(x, y), "z": z}
    if pose.get("rotation_noise") is not None:
        noise = numbers(xyz(pose["rotation_noise"], where), 3, f"{where} rotation_noise")
        x, y, z = np.degrees(noise).tolist()
        sigma |= {"yaw_deg": z, "tilt_deg": max(x, y)}
    return sigma


def _write(tag_map: TagMap) -> Exported:
    rotvec = geo.log(tag_map.R_WT)
    tags = []
    for i, tag in enumerate(tag_dicts(tag_map)):
        sigma = tag_map.laying_sigma[i]
        pose = {
            "position": _vector(np.array(tag["p"])),
            "rotation": _vector(rotvec[i]),
            "position_noise": _vector(sigma[:3]),
            "rotation_noise": _vector(sigma[3:]),
        }
        tags.append({"id": tag["id"], "size": tag["size"], "pose": pose})
    body = {
        "is_static": True,
        "default_tag_size": tags[0]["size"],
        "type": "simple",
        "tags": tags,
    }
    text = yaml.safe_dump({"bodies": [{"map": body}]}, sort_keys=False, width=100)
    return Exported(text)


def _vector(v: Array) -> dict[str, float]:
    return dict(zip("xyz", (np.round(v, 12) + 0.0).tolist(), strict=True))


FORMAT = Format(TITLE, frozenset({"pose", "size", "sigma"}), _recognises, _read, _write)
