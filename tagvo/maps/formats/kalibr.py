"""Kalibr's aprilgrid target: a regular board of 36h11 with a border two bits wide.

Ids run from the lower left along the rows, upwards; the origin is the lower left corner of tag 0's
border, x right, y up, z out of the board (checked against EuRoC's board). tagSpacing is the gap
between two borders over the border's side. Kalibr prints no other family than 36h11.
"""

import numpy as np
import yaml

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
    need_mapping,
)
from tagvo.tags.tag_map import TagMap
from tagvo.textfile import finite_number

TITLE = "Kalibr aprilgrid target"
_FAMILY, _BITS = "tag36h11", 2
_TOLERANCE_M, _TOLERANCE_RAD = 1e-5, 1e-4  # a map this near to a grid is one


def _recognises(content: Content) -> bool:
    return isinstance(content, dict) and ("target_type" in content or "tagSpacing" in content)


def _read(content: Content, where: str, options: ReadOptions) -> Imported:
    data = need_mapping(content, where, TITLE)
    kind = data.get("target_type", "aprilgrid")
    if kind != "aprilgrid":
        raise MapError(f"{where} target_type: {shown(kind)} has no tags; aprilgrid is read")
    columns, rows = (_count(data, key, where) for key in ("tagCols", "tagRows"))
    size, spacing = (_positive(data, key, where) for key in ("tagSize", "tagSpacing"))
    p_WT = _grid(columns, rows, size, spacing)
    tags = [
        {"id": i, "size": size, "p": p.tolist(), "q": [1.0, 0.0, 0.0, 0.0]}
        for i, p in enumerate(p_WT)
    ]
    family = options.family or _FAMILY
    return Imported(build_map(tags, family, where, options, border_bits=_BITS))


def _grid(columns: int, rows: int, size: float, spacing: float) -> Array:
    """Centres of the tags of a board, in the order of their ids [m]; (rows * columns, 3)."""
    j, i = np.divmod(np.arange(rows * columns), columns)
    pitch = size * (1.0 + spacing)
    return np.stack([i * pitch + 0.5 * size, j * pitch + 0.5 * size, 0.0 * i], axis=-1)


def _count(data: dict[str, object], key: str, where: str) -> int:
    value = field(data, [key], where)
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 1000:
        raise MapError(f"{where} {key}: {shown(value)}; a whole number from 1 to 1000 is needed")
    return value


def _positive(data: dict[str, object], key: str, where: str) -> float:
    value = finite_number(field(data, [key], where), f"{where} {key}", MapError)
    if not 0.0 < value < 1e3:
        raise MapError(f"{where} {key}: {value:g}; a positive number below 1000 is needed")
    return value


def _write(tag_map: TagMap) -> Exported:
    columns, rows, size, spacing = _grid_of(tag_map)
    target = {
        "target_type": "aprilgrid",
        "tagCols": columns,
        "tagRows": rows,
        "tagSize": round(size, 9),
        "tagSpacing": round(spacing, 9),
    }
    return Exported(yaml.safe_dump(target, sort_keys=False))


def _grid_of(tag_map: TagMap) -> tuple[int, int, float, float]:
    """Columns, rows, border side [m] and relative gap of the board a map is; MapError: why not."""
    n, p_WT, size = len(tag_map), tag_map.p_WT, float(tag_map.size[0])

    def refuse(why: str) -> MapError:
        return MapError(f"{tag_map.source}: no Kalibr aprilgrid: {why}")

    if tag_map.family.name != _FAMILY:
        raise refuse(f"the family is {tag_map.family.name}; Kalibr's is {_FAMILY}")
    if tag_map.border_bits != _BITS:
        raise refuse(f"border_bits is {tag_map.border_bits}; Kalibr prints {_BITS}")
    if sorted(tag_map.tag_id.tolist()) != list(range(n)):
        raise refuse(f"the ids are not 0 to {n - 1}")
    if np.ptp(tag_map.size) > _TOLERANCE_M:
        raise refuse("the tags differ in size")
    if float(geo.angle(tag_map.R_WT).max()) > _TOLERANCE_RAD:
        raise refuse("a tag is turned; all must lie as W does")
    p_WT = p_WT[np.argsort(tag_map.tag_id)]
    columns = max(1, int(np.sum(np.abs(p_WT[:, 1] - p_WT[0, 1]) < 0.5 * size)))
    rows = n // columns
    if n != rows * columns or n < 2:
        raise refuse(f"{n} tags do not make full rows of {columns}")
    pitch = float(p_WT[1, 0] - p_WT[0, 0] if columns > 1 else p_WT[1, 1] - p_WT[0, 1])
    spacing = pitch / size - 1.0
    off = float(np.abs(p_WT - _grid(columns, rows, size, spacing)).max())
    if off > _TOLERANCE_M or spacing <= 0.0:
        raise refuse(f"a tag lies {1e3 * off:.2f} mm off a board with origin at tag 0's corner")
    return columns, rows, size, spacing


HOLDS = frozenset({"pose", "size", "family", "border_bits"})
FORMAT = Format(TITLE, HOLDS, _recognises, _read, _write)
