"""apriltag_ros for ROS 1, `tags.yaml`: a bundle is a map; its tag axes are ours (z out)."""

from typing import Any

from tagvo.errors import MapError, choose_one_of
from tagvo.maps.formats.common import (
    Content,
    Exported,
    Format,
    Imported,
    ReadOptions,
    build_map,
    family_or,
    listed,
    need_mapping,
    tag_dicts,
)
from tagvo.tags.tag_map import TagMap
from tagvo.textfile import flow_line

TITLE = "apriltag_ros (ROS 1) tags.yaml"


def _recognises(content: Content) -> bool:
    return isinstance(content, dict) and bool({"tag_bundles", "standalone_tags"} & set(content))


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    data = need_mapping(content, where, TITLE)
    bundles = listed(data.get("tag_bundles") or [], f"{where} tag_bundles")
    alone = listed(data.get("standalone_tags") or [], f"{where} standalone_tags")
    if not bundles:
        raise MapError(
            f"{where}: no tag bundle; only a bundle says where its tags lie"
            f" ({len(alone)} standalone tags have no pose)"
        )
    bundle = _chosen(bundles, options.bundle, where)
    here = f"{where} bundle {bundle.get('name', 0)}"
    layout = listed(bundle.get("layout") or [], f"{here} layout")
    tags = [
        {
            "id": tag.get("id"),
            "size": tag.get("size"),
            "p": [tag.get(key, 0.0) for key in "xyz"],
            "q": [tag.get("qw", 1.0), *(tag.get(key, 0.0) for key in ("qx", "qy", "qz"))],
        }
        for tag in layout
    ]
    family, notes = family_or("tag36h11", options, "it stands in settings.yaml")
    if alone:
        notes += (f"{len(alone)} standalone tags left out: they have no pose",)
    return Imported(build_map(tags, family, here, options), notes)


def _chosen(bundles: list[dict[str, Any]], name: str | None, where: str) -> dict[str, Any]:
    names = [str(bundle.get("name", i)) for i, bundle in enumerate(bundles)]
    if name is None and len(bundles) == 1:
        return bundles[0]
    if name is None:
        raise MapError(f"{where}: {len(bundles)} bundles; --bundle one of {', '.join(names)}")
    if name not in names:
        raise MapError(choose_one_of(f"{where} bundle", name, names))
    return bundles[names.index(name)]


def _write(tag_map: TagMap) -> Exported:
    lines = ["standalone_tags: []", "tag_bundles:", "  - name: map", "    layout:"]
    for tag in tag_dicts(tag_map):
        keys = ("x", "y", "z", "qw", "qx", "qy", "qz")
        values = dict(zip(keys, [*tag["p"], *tag["q"]], strict=True))
        entry = {"id": tag["id"], "size": tag["size"], **values}
        flow = flow_line(entry)
        lines.append(f"      - {flow.strip()}")
    return Exported("\n".join(lines) + "\n")


FORMAT = Format(TITLE, frozenset({"pose", "size"}), _recognises, _read, _write)
