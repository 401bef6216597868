"""apriltag_ros for ROS 2: a list of ids and sizes without poses; readable beside a layout alone."""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import yaml

from tagvo.errors import MapError, shown
from tagvo.maps.formats.common import Content, Exported, Format, Imported, ReadOptions
from tagvo.tags.families import Family, family_named
from tagvo.tags.tag_map import TagMap, map_from_dict, map_to_dict

TITLE = "apriltag_ros (ROS 2) parameters"


def _parameters(content: Content) -> dict[str, Any] | None:
    """The `ros__parameters` of the first node that has any."""
    if isinstance(content, dict):
        for node in (content, *content.values()):
            if isinstance(node, dict) and isinstance(node.get("ros__parameters"), dict):
                return dict(node["ros__parameters"])
    return None


def _recognises(content: Content) -> bool:
    return _parameters(content) is not None


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    if options.layout is None:
        raise MapError(
            f"{where}: {TITLE} hold ids and sizes but no poses; give --layout MAP, a map file"
            " that says where the tags lie"
        )
    parameters = _parameters(content)
    if parameters is None:
        raise MapError(f"{where}: no `ros__parameters`; {TITLE} are needed")
    sizes, default = _sizes(parameters, where)
    layout = replace(options.layout, size_kind="border", source=where)
    on_layout = {int(i) for i in layout.tag_id}
    missing = sorted(set(sizes) - on_layout)
    if missing:
        raise MapError(f"{where}: tag {missing[0]} is not on the layout of {len(layout)} tags")
    data = map_to_dict(layout)
    data["family"] = options.family or _family_of(parameters, layout, where)
    notes = []
    for tag in data["tags"]:
        if (size := sizes.get(tag["id"], default)) is None:
            notes.append(f"tag {tag['id']}: no size in the parameters, the layout's taken")
        else:
            tag["size"] = size
    return Imported(map_from_dict(data, where), tuple(notes))


def _sizes(parameters: dict[str, Any], where: str) -> tuple[dict[int, Any], Any]:
    tag = parameters.get("tag") or {}
    if not isinstance(tag, dict):
        raise MapError(f"{where} tag: {shown(tag)}; a mapping with ids and sizes is needed")
    ids, sizes = tag.get("ids") or [], tag.get("sizes")
    default = parameters.get("size")
    if sizes is None:
        sizes = [default] * len(ids) if isinstance(ids, list) else []
    lists = isinstance(ids, list) and isinstance(sizes, list) and len(ids) == len(sizes)
    if not lists or not all(isinstance(i, int) and not isinstance(i, bool) for i in ids):
        raise MapError(f"{where} tag: ids {ids!r} and sizes {sizes!r}; two lists of one length")
    return dict(zip(ids, sizes, strict=True)), default


def _family_of(parameters: dict[str, Any], layout: TagMap, where: str) -> str:
    name = parameters.get("family", layout.family.name)
    prefixed = str(name) if str(name).lower().startswith("tag") else f"tag{name}"
    return family_named(prefixed, f"{where} family").name


def _short(family: Family) -> str:
    return family.name.removeprefix("tag")


def _write(tag_map: TagMap) -> Exported:
    if not tag_map.family.apriltag:
        raise MapError(f"{tag_map.source}: apriltag_ros does not read {tag_map.family.name}")
    sizes = np.round(tag_map.size, 9).tolist()
    ids = tag_map.tag_id.tolist()
    parameters = {
        "family": _short(tag_map.family),
        "size": Counter(sizes).most_common(1)[0][0],
        "max_hamming": 0,
        "tag": {"ids": ids, "frames": [f"tag{i}" for i in ids], "sizes": sizes},
    }
    text = yaml.safe_dump(
        {"apriltag": {"ros__parameters": parameters}},
        sort_keys=False,
        default_flow_style=None,
        width=100,
    )
    return Exported(text)


FORMAT = Format(TITLE, frozenset({"size", "family"}), _recognises, _read, _write)
