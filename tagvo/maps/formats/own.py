"""The house's own `tagmap.yaml`: it holds everything."""

from tagvo.errors import MapError
from tagvo.maps.formats.common import (
    HOLDABLE,
    Content,
    Exported,
    Format,
    Imported,
    ReadOptions,
    need_mapping,
)
from tagvo.tags.families import family_named
from tagvo.tags.tag_map import TagMap, map_from_dict, map_to_yaml


def _recognises(content: Content) -> bool:
    if not isinstance(content, dict) or "ros__parameters" in content:
        return False
    return "family" in content or "size_kind" in content or set(content) == {"tags"}


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    data = need_mapping(content, where, "a tagmap.yaml")
    if "family" not in data and options.family is not None:
        data = {"family": options.family, **data}  # a list of tags names none
    tag_map = map_from_dict(data, where)
    asked = options.family
    if asked is not None and family_named(asked, "--family").name != tag_map.family.name:
        raise MapError(f"{where}: the file says {tag_map.family.name}, --family says {asked}")
    return Imported(tag_map)


def _write(tag_map: TagMap) -> Exported:
    return Exported(map_to_yaml(tag_map))


FORMAT = Format("tagmap.yaml", frozenset(HOLDABLE), _recognises, _read, _write)
