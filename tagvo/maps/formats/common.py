"""What all map formats share: what a reader is told, what a writer gives back, lenient fields."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from tagvo.errors import MapError, shown
from tagvo.tags.tag_map import TagMap, map_from_dict, map_to_dict
from tagvo.textfile import is_number

Content: TypeAlias = dict[str, Any] | list[list[str]]  # a mapping (YAML, JSON) or rows of words

HOLDABLE = ("pose", "size", "family", "border_bits", "sigma", "gravity")


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the user adds to a file that does not say everything.

    size: border side [m] of tags whose size the file does not give; family: where the file names
    none, or several; bundle: which of several maps in one file; layout: poses for a file of sizes.
    """

    size: float | None = None
    family: str | None = None
    bundle: str | None = None
    layout: TagMap | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Imported:
    """A map read from a file, and notes: what was assumed, what was left out."""

    tag_map: TagMap
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Exported:
    """Text of a map file, and losses peculiar to the format (the general ones are `losses_of`)."""

    text: str
    losses: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Format:
    """One file format: what it is, what of a map it holds (`HOLDABLE`), how to know and use it."""

    title: str
    holds: frozenset[str]
    recognises: Callable[[Content], bool]
    read: Callable[[Content, str, ReadOptions], Imported]
    write: Callable[[TagMap], Exported]


def losses_of(tag_map: TagMap, holds: frozenset[str], title: str) -> list[str]:
    """What of this very map a format cannot hold, a line each; nothing said of what is absent."""
    lost = []
    if "pose" not in holds:
        lost.append(f"{title} holds no poses: where the tags lie is lost")
    if "size" not in holds:
        sizes = ", ".join(f"{size:g}" for size in tag_map.classes)
        lost.append(f"{title} holds no sizes: border {sizes} m is lost (reading needs --size)")
    if "family" not in holds:
        lost.append(f"{title} holds no family: {tag_map.family.name} is lost (--family)")
    if "border_bits" not in holds and tag_map.border_bits != 1:
        lost.append(f"{title} holds no border_bits: {tag_map.border_bits} is lost")
    if "sigma" not in holds:
        lost.append(f"{title} holds no sigma: how well the tags were laid is lost")
    if "gravity" not in holds and tag_map.gravity is not None:
        lost.append(f"{title} holds no gravity: its direction is lost")
    return lost


def tag_dicts(tag_map: TagMap) -> list[dict[str, Any]]:
    """The tags as in a `tagmap.yaml`, sizes always of the border: id, size, p, q [, sigma]."""
    tags = map_to_dict(replace(tag_map, size_kind="border"))["tags"]
    return list(tags)


def build_map(
    tags: list[dict[str, Any]], family: str, where: str, options: ReadOptions, **header: Any
) -> TagMap:
    """The checked map of tags with id, p, q and maybe size; sizes missing come from the options."""
    for tag in tags:
        if tag.get("size") is None:
            if options.size is None:
                raise MapError(
                    f"{where} tag {tag.get('id')}: the file gives no size; give the side of the"
                    " border in metres with --size"
                )
            tag["size"] = options.size
    return map_from_dict({"family": family, "tags": tags, **header}, where)


def family_or(default: str, options: ReadOptions, why: str) -> tuple[str, tuple[str, ...]]:
    """The family asked for, or a default with the note that it was assumed."""
    if options.family is not None:
        return options.family, ()
    return default, (f"family: {default} assumed ({why}); --family says otherwise",)


def need_mapping(content: Content, where: str, title: str) -> dict[str, Any]:
    """The content as a mapping; MapError where the file is a table of numbers."""
    if isinstance(content, dict):
        return content
    raise MapError(f"{where}: lines of numbers; {title} is a mapping `key: value`")


def field(value: object, path: Sequence[str | int], where: str) -> Any:
    """The value under a path of keys and indices; MapError names the first one missing."""
    here = where
    for key in path:
        inside = isinstance(value, dict) if isinstance(key, str) else isinstance(value, list)
        try:
            value = value[key] if inside else None  # type: ignore[index]
        except (KeyError, IndexError):
            value = None
        if value is None:
            raise MapError(f"{here}: `{key}` is missing")
        here = f"{here} {key}"
    return value


def listed(value: object, where: str) -> list[dict[str, Any]]:
    """A list of mappings; MapError otherwise."""
    if not isinstance(value, list):
        raise MapError(f"{where}: {shown(value)}; a list is needed")
    for i, entry in enumerate(value):
        if not isinstance(entry, dict):
            raise MapError(f"{where}[{i}]: {shown(entry)}; a mapping is needed")
    return value


def xyz(value: object, where: str) -> list[Any]:
    """The three values under x, y and z (what they are is checked with the map)."""
    return [field(value, [key], where) for key in "xyz"]


def table_rows(
    content: Content, columns: Sequence[str], where: str, least: int | None = None
) -> list[list[float]]:
    """Numbers of a text table, at least one a column, or at least so many, the rest then 0.

    MapError names the first bad line.
    """
    least = len(columns) if least is None else least
    if not isinstance(content, list):
        raise MapError(f"{where}: a mapping; lines of `{' '.join(columns)}` are needed")
    out = []
    for i, words in enumerate(content):
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        sound = len(row) >= least and all(map(is_number, row))
        if not sound or not row[0].is_integer():
            text = " ".join(words)
            raise MapError(f"{where} row {i + 1}: {shown(text)}; `{' '.join(columns)}` is needed")
        out.append(row + [0.0] * (len(columns) - len(row)))
    return out
