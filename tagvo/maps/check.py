"""Lists every fault of a tag map at once: `load_map` stops at the first, a person repairs them all.

Works on the raw mapping of the file, so that a map too broken to load is still examined tag by tag.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from tagvo import geometry as geo
from tagvo.errors import MapError, choose_one_of, shown, some_of
from tagvo.maps.overlap import Squares, pairs_in_one_plane, penetration
from tagvo.tags.families import FAMILIES, Family, family_named
from tagvo.tags.tag_map import SIZE_KINDS, TagMap, map_from_dict, position, side, unit_quaternion
from tagvo.textfile import is_number

_HEADER = ("family", "size_kind", "sigma", "gravity", "border_bits", "tags")
_TAG_KEYS = ("id", "size", "p", "q", "sigma")
_GOOD_TAG = {"id": 0, "size": 1.0, "p": [0.0, 0.0, 0.0], "q": [1.0, 0.0, 0.0, 0.0]}
_LARGEST_ID = 1 << 31  # of any family; larger ones are errors and no numpy integer
_MOST_LISTED = 12  # places or sizes named in one finding
_NUMBERS = str.maketrans("", "", "0123456789.,+-e[]()")  # what findings of a kind differ in
_LINES = 20  # of findings for a person
_LARGE_M = 2.0  # the largest sheets that printers of plans take are 1.5 m wide
_TOUCH_M = 1e-6  # borders that overlap by less touch
_SLACK = 0.01  # share of a side by which margins may overlap on paper: surveys are not exact
_FACTOR_SLACK = 0.01  # how near a ratio of sizes must come to total/border to look like a mix-up


@dataclass(frozen=True, slots=True)
class Finding:
    """One fault of a map: how bad, the ids of the tags concerned, and what is wrong."""

    severity: Literal["error", "warning"]
    tag_ids: tuple[int, ...]
    text: str


def summed_up(findings: Sequence[Finding]) -> list[str]:
    """At most 20 lines: all of few findings; of many the first of each kind and their number."""
    if len(findings) <= _LINES:
        return [f"{f.severity}: {f.text}" for f in findings]
    kinds: dict[tuple[str, str], list[Finding]] = defaultdict(list)
    for finding in findings:
        shape = finding.text.translate(_NUMBERS)
        kinds[finding.severity, shape].append(finding)
    lines = []
    for (severity, _), alike in kinds.items():
        more = f" (and {len(alike) - 1} more like it)" if len(alike) > 1 else ""
        lines.append(f"{severity}: {alike[0].text}{more}")
    if len(lines) <= _LINES:
        return lines
    rest = len(lines) - _LINES + 1
    return [*lines[: _LINES - 1], f"and {rest} more kinds of findings"]


@dataclass(frozen=True, slots=True)
class SizeClass:
    """One size class of a map: border side [m], total printed side [m], number of tags."""

    border: float
    total: float
    count: int


def size_classes(tag_map: TagMap) -> list[SizeClass]:
    """The size classes of a map, smallest first."""
    nearest = np.argmin(np.abs(tag_map.size[:, None] - tag_map.classes), axis=1)
    counts = np.bincount(nearest, minlength=len(tag_map.classes))
    ratio = tag_map.family.total_per_border(tag_map.border_bits)
    pairs = zip(tag_map.classes.tolist(), counts.tolist(), strict=True)
    return [SizeClass(border, border * ratio, count) for border, count in pairs]


def check_map_data(data: dict[str, Any], where: str) -> list[Finding]:
    """All faults of the mapping of a `tagmap.yaml`, errors first; `where` names the file."""
    family = _family(data)
    tags = data.get("tags")
    entries = tags if isinstance(tags, list) else []
    found = list(_header_faults(data, where))
    for i, tag in enumerate(entries):
        found += _tag_faults(tag, i, family, where)
    found += _duplicates(entries, where)
    if not any(f.severity == "error" for f in found):
        found += _what_load_says(data, where)
    sane = _sane_tags(entries)
    found += _large_tags(sane, where)
    if sane and family is not None:
        with np.errstate(over="ignore", invalid="ignore"):  # coordinates may be absurd
            found += _overlaps(_squares(data, sane, family), where)
        found += _mixed_up_sizes(data, sane, family, where)
    return sorted(found, key=lambda f: f.severity)  # "error" < "warning"; the sort is stable


def _family(data: dict[str, Any]) -> Family | None:
    try:
        return family_named(data.get("family"), "family")
    except MapError:
        return None


def _error(text: str, *tag_ids: int) -> Finding:
    return Finding("error", tag_ids, text)


def _header_faults(data: dict[str, Any], where: str) -> Iterator[Finding]:
    for key in data:
        if key not in _HEADER:
            yield _error(choose_one_of(where, key, _HEADER))
    if "family" not in data:
        yield _error(f"{where}: `family` is missing, such as tagStandard41h12")
    elif _family(data) is None:
        yield _error(choose_one_of(f"{where} family", data["family"], FAMILIES))
    for key in ("size_kind", "sigma", "gravity", "border_bits"):
        if key in data:  # a small sound map with this key alone: the loader's own judgement of it
            sound = {"family": "tag36h11", key: data[key], "tags": [_GOOD_TAG]}
            yield from _what_load_says(sound, where)
    if not isinstance(data.get("tags"), list) or not data["tags"]:
        yield _error(f"{where}: the map has no tags; `tags` must list at least one")


def _what_load_says(data: dict[str, Any], where: str) -> Iterator[Finding]:
    try:
        map_from_dict(data, where)
    except MapError as err:
        yield _error(str(err))


def _tag_faults(tag: object, i: int, family: Family | None, where: str) -> Iterator[Finding]:
    if not isinstance(tag, dict):
        yield _error(f"{where} tags[{i}]: {shown(tag)}; a mapping with id, size, p and q is needed")
        return
    tag_id = tag.get("id")
    whole = isinstance(tag_id, int) and not isinstance(tag_id, bool)
    here = f"{where} tag {shown(tag_id)}" if whole else f"{where} tags[{i}]"
    ids: tuple[int, ...] = (int(tag_id),) if whole else ()  # type: ignore[arg-type]
    for key in tag:
        if key not in _TAG_KEYS:
            yield _error(choose_one_of(here, key, _TAG_KEYS), *ids)
    for key in _TAG_KEYS[:4]:
        if key not in tag:
            yield _error(f"{here}: `{key}` is missing; id, size, p and q are needed", *ids)
    if "id" in tag and not whole:
        yield _error(f"{here} id: {shown(tag_id)}; a whole number is needed")
    elif whole and family is not None and not 0 <= ids[0] < family.ids:
        yield _error(f"{here}: not an id of {family.name}; 0 to {family.ids - 1} are", *ids)
    checks: tuple[tuple[str, Callable[[object, str], object]], ...] = (
        ("size", side), ("p", position), ("q", unit_quaternion),
    )  # fmt: skip
    for key, check in checks:
        if key in tag:
            try:
                check(tag[key], f"{here} {key}")
            except MapError as err:
                yield _error(str(err), *ids)
    if "sigma" in tag:
        sound = {"family": "tag36h11", "sigma": tag["sigma"], "tags": [_GOOD_TAG]}
        yield from (_error(f.text, *ids) for f in _what_load_says(sound, here))


def _duplicates(entries: list[Any], where: str) -> Iterator[Finding]:
    places: dict[int, list[int]] = defaultdict(list)
    for i, tag in enumerate(entries):
        if isinstance(tag, dict) and isinstance(tag.get("id"), int):
            places[int(tag["id"])].append(i)
    for tag_id, rows in places.items():
        if len(rows) > 1:
            listed = " and ".join(f"tags[{i}]" for i in rows[:_MOST_LISTED])
            text = f"{where}: tag {shown(tag_id)} stands {len(rows)} times ({listed})"
            yield _error(f"{text}; an id may lie in one place only", tag_id)


def _sane_tags(entries: list[Any]) -> list[dict[str, Any]]:
    """The entries whose id, size, p and q can be used, whatever else is wrong with them."""

    def sane(tag: Any) -> bool:
        if not isinstance(tag, dict) or not isinstance(tag.get("id"), int):
            return False
        if not 0 <= tag["id"] < _LARGEST_ID:
            return False
        try:
            side(tag.get("size"), "")
            return bool(position(tag.get("p"), "") and unit_quaternion(tag.get("q"), ""))
        except MapError:
            return False

    return [tag for tag in entries if sane(tag)]


def _large_tags(tags: list[dict[str, Any]], where: str) -> Iterator[Finding]:
    large = {tag["id"]: tag["size"] for tag in tags if tag["size"] > _LARGE_M}
    if large:
        listed = some_of(f"{tag_id} ({size:g} m)" for tag_id, size in large.items())
        text = f"{where}: tags {listed} are larger than {_LARGE_M:g} m: are sizes in metres?"
        yield Finding("warning", tuple(large), text)


def _ratio(data: dict[str, Any], family: Family) -> float:
    bits = data.get("border_bits", 1)
    return family.total_per_border(bits if isinstance(bits, int) and 1 <= bits <= 4 else 1)


def _squares(data: dict[str, Any], tags: list[dict[str, Any]], family: Family) -> Squares:
    size = np.array([float(tag["size"]) for tag in tags])
    border = size / _ratio(data, family) if data.get("size_kind") == SIZE_KINDS[1] else size
    xy, z = (_laying_sigma(data, key, default) for key, default in (("xy", 0.002), ("z", 0.001)))
    return Squares(
        np.array([int(tag["id"]) for tag in tags]),
        np.array([tag["p"] for tag in tags], dtype=float),
        geo.matrix_from_quat(np.array([tag["q"] for tag in tags], dtype=float)),
        border,
        border * _ratio(data, family),
        xy,
        z,
    )


def _laying_sigma(data: dict[str, Any], key: str, default: float) -> float:
    sigma = data.get("sigma")
    value = sigma.get(key, default) if isinstance(sigma, dict) else default
    return abs(float(value)) if is_number(value) else default


def _overlaps(squares: Squares, where: str) -> Iterator[Finding]:
    i, j = pairs_in_one_plane(squares)
    smaller = np.minimum(squares.border[i], squares.border[j])
    slack = np.maximum(_SLACK * smaller, squares.sigma_xy)
    border = penetration(squares, i, j, squares.border)
    total = penetration(squares, i, j, squares.total)
    for k in np.flatnonzero((border > _TOUCH_M) | (total > slack)):
        a, b = sorted((int(squares.ids[i[k]]), int(squares.ids[j[k]])))
        head = f"{where}: tags {a} and {b} overlap"
        if border[k] > _TOUCH_M:
            text = f"{head} by {1e3 * border[k]:.1f} mm: one of them cannot lie there"
            yield Finding("error", (a, b), text)
        else:
            text = f"{head} by {1e3 * total[k]:.1f} mm in their printed margins, not their borders"
            yield Finding("warning", (a, b), text)


def _mixed_up_sizes(
    data: dict[str, Any], tags: list[dict[str, Any]], family: Family, where: str
) -> Iterator[Finding]:
    members: dict[float, list[int]] = defaultdict(list)
    for tag in tags:
        members[round(float(tag["size"]), 6)].append(int(tag["id"]))
    ratio = _ratio(data, family)
    sizes = np.array(sorted(members))
    first = np.searchsorted(sizes, sizes * ratio * (1.0 - _FACTOR_SLACK), side="right")
    last = np.searchsorted(sizes, sizes * ratio * (1.0 + _FACTOR_SLACK), side="left")
    for row in range(len(sizes)):
        for large in sizes[max(first[row], row + 1) : last[row]].tolist()[:_MOST_LISTED]:
            small = float(sizes[row])
            few = min(small, large, key=lambda s: len(members[s]))
            text = (
                f"{where}: sizes {small:g} m ({len(members[small])} tags) and {large:g} m"
                f" ({len(members[large])}) differ by {large / small:.4g}, which is total/border of"
                f" {family.name}: were some measured over the whole print? (size_kind is"
                f" {data.get('size_kind', 'border')})"
            )
            yield Finding("warning", tuple(members[few]), text)
