"""The tag map: which tag lies where, how big it is, and how well it was laid."""

import math
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tagvo import geometry as geo
from tagvo.errors import MapError, choose_one_of, shown
from tagvo.geometry import Array, IntArray
from tagvo.tags.families import Family, family_named
from tagvo.textfile import finite_numbers, flow_line, is_number, read_yaml, write_atomic

SIZE_KINDS = ("border", "total")
SIDES_M = (1e-3, 10.0)  # no printer makes less, no hall has more
LARGEST_SIGMA_M, LARGEST_SIGMA_DEG = 10.0, 45.0  # beyond, nobody knows where a tag lies
LARGEST_PLACE_M = 1e4  # of a tag from the map's origin: floats keep 1e-12 of it
_SIGMA_KEYS = ("xy", "z", "yaw_deg", "tilt_deg")
_SIGMA_DEFAULT = (0.002, 0.001, float(np.radians(0.3)), float(np.radians(0.1)))
_UNIT_CORNERS = 0.5 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]], dtype=float)


def tag_corners(size: Array) -> Array:
    """Corners TL, TR, BR, BL of a tag in T (x right, y up); (n,) border side [m] -> (n, 4, 3)."""
    return np.asarray(size, dtype=float)[..., None, None] * _UNIT_CORNERS


@dataclass(frozen=True, slots=True)
class Gravity:
    """What a map says of gravity: dir (3,) unit vector in W, sigma_deg its uncertainty."""

    dir: tuple[float, float, float]
    sigma_deg: float


@dataclass(frozen=True, eq=False)
class TagMap:
    """A validated map of n tags in W.

    tag_id (n,); size (n,) border side [m], whatever `size_kind` the file uses; p_WT (n, 3) [m];
    R_WT (n, 3, 3); sigma (n, 4): laying standard deviations xy [m], z [m], yaw [rad], tilt [rad]
    in T; sigma_default: those of tags that the file gives no own.
    """

    family: Family
    size_kind: str
    border_bits: int
    tag_id: IntArray
    size: Array
    p_WT: Array
    R_WT: Array
    sigma: Array
    sigma_default: tuple[float, float, float, float] = _SIGMA_DEFAULT
    gravity: Gravity | None = None
    source: str = "map"
    _row: dict[int, int] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_row", {int(t): i for i, t in enumerate(self.tag_id)})

    def __len__(self) -> int:
        return len(self.tag_id)

    def rows(self, tag_ids: IntArray) -> IntArray:
        """Row of each id in the map, -1 where it is not on it; (k,) -> (k,)."""
        find = self._row.get
        return np.array([find(t, -1) for t in np.asarray(tag_ids).tolist()], dtype=np.int64)

    @cached_property
    def total_size(self) -> Array:
        """Whole printed side of each tag [m]; (n,)."""
        return self.size * self.family.total_per_border(self.border_bits)

    @cached_property
    def level(self) -> Array:
        """Weight exponent h = log2(size / smallest size in the map); (n,)."""
        return np.asarray(np.log2(self.size / self.size.min()))

    @cached_property
    def classes(self) -> Array:
        """The distinct sizes (to 0.1 %), ascending [m]; (k,)."""
        return np.array(sorted(set(np.round(self.size, 6))))

    @cached_property
    def corners_T(self) -> Array:
        """Corners of each tag in its own frame [m]; (n, 4, 3)."""
        return tag_corners(self.size)

    @cached_property
    def corners_W(self) -> Array:
        """Corners of each tag in W [m]; (n, 4, 3)."""
        return geo.transform(self.R_WT[:, None], self.p_WT[:, None], self.corners_T)

    @cached_property
    def laying_sigma(self) -> Array:
        """Standard deviations of [dp in T (3) m, right rotation in T (3) rad]; (n, 6)."""
        xy, z, yaw, tilt = self.sigma.T
        return np.stack([xy, xy, z, tilt, tilt, yaw], axis=-1)

    def only(self, tag_ids: IntArray) -> "TagMap":
        """The map with these tags alone; MapError names an id that is not on it."""
        rows = self.rows(np.asarray(tag_ids))
        if (rows < 0).any():
            missing = [int(t) for t, r in zip(tag_ids, rows, strict=True) if r < 0]
            raise MapError(f"{self.source}: no tag {missing[0]} on this map of {len(self)} tags")
        return TagMap(
            self.family,
            self.size_kind,
            self.border_bits,
            self.tag_id[rows],
            self.size[rows],
            self.p_WT[rows],
            self.R_WT[rows],
            self.sigma[rows],
            self.sigma_default,
            self.gravity,
            self.source,
        )


def load_map(path: Path | str) -> TagMap:
    """Tag map of a `tagmap.yaml`; MapError where the file cannot be read or used."""
    return map_from_dict(read_yaml(Path(path), MapError), str(path))


def map_from_dict(data: dict[str, Any], where: str) -> TagMap:
    """Tag map of the mapping of a `tagmap.yaml`, checked; MapError names the first fault."""
    known = ("family", "size_kind", "sigma", "gravity", "border_bits", "tags")
    for key in data:
        if key not in known:
            raise MapError(choose_one_of(f"{where}", key, known))
    if "family" not in data:
        raise MapError(f"{where}: `family` is missing, such as tagStandard41h12")
    family = family_named(data["family"], f"{where} family")
    kind = data.get("size_kind", "border")
    if kind not in SIZE_KINDS:
        raise MapError(choose_one_of(f"{where} size_kind", kind, SIZE_KINDS))
    bits = data.get("border_bits", 1)
    if isinstance(bits, bool) or not isinstance(bits, int) or not 1 <= bits <= 4:
        raise MapError(f"{where} border_bits: {shown(bits)}; a whole number from 1 to 4 is needed")
    default = _sigma(data.get("sigma"), _SIGMA_DEFAULT, f"{where} sigma")
    tags = data.get("tags")
    if not isinstance(tags, list) or not tags:
        raise MapError(f"{where}: the map has no tags; `tags` must list at least one")
    rows = [_tag(tag, i, family, default, where) for i, tag in enumerate(tags)]
    _refuse_duplicates([row[0] for row in rows], where)
    scale = 1.0 if kind == "border" else 1.0 / family.total_per_border(bits)
    ids, sizes, p_WT, q_WT, sigmas = zip(*rows, strict=True)
    return TagMap(
        family,
        kind,
        bits,
        np.array(ids, dtype=np.int64),
        np.array(sizes) * scale,
        np.array(p_WT),
        geo.matrix_from_quat(np.array(q_WT)),
        np.array(sigmas),
        default,
        _gravity(data.get("gravity"), f"{where} gravity"),
        where,
    )


def numbers(value: object, count: int, where: str) -> list[float]:
    """`count` finite numbers of a YAML list; MapError otherwise."""
    return finite_numbers(value, count, where, MapError)


def unit_quaternion(value: object, where: str) -> list[float]:
    """A wxyz quaternion of norm 1 within 1e-3; MapError otherwise."""
    q = numbers(value, 4, where)
    norm = math.sqrt(sum(x * x for x in q))
    if abs(norm - 1.0) > 1e-3:
        raise MapError(
            f"{where}: {shown(value)} is no rotation (norm {norm:.4g}); unit to 1e-3, wxyz"
        )
    return q


def position(value: object, where: str) -> list[float]:
    """x, y, z [m] within LARGEST_PLACE_M; MapError otherwise."""
    p = numbers(value, 3, where)
    if max(map(abs, p)) > LARGEST_PLACE_M:
        raise MapError(f"{where}: {shown(value)}; at most {LARGEST_PLACE_M:g} m from the origin")
    return p


def side(value: object, where: str) -> float:
    """A tag's side [m] within SIDES_M; MapError otherwise."""
    low, high = SIDES_M
    if not is_number(value) or value <= 0.0:
        raise MapError(f"{where}: {shown(value)}; a positive number of metres is needed")
    if not low <= value <= high:
        raise MapError(f"{where}: {shown(value)} m; {low:g} to {high:g} m is a tag's side")
    return float(value)


def _gravity_sigma(value: object, where: str) -> float:
    if not is_number(value) or not 0.0 < value <= 180.0:
        raise MapError(f"{where}: {shown(value)}; a positive number of degrees to 180 is needed")
    return float(value)


def _tag(
    tag: object, i: int, family: Family, default: tuple[float, float, float, float], where: str
) -> tuple[int, float, list[float], list[float], tuple[float, ...]]:
    here = f"{where} tags[{i}]"
    if not isinstance(tag, dict):
        raise MapError(f"{here}: {shown(tag)}; a mapping with id, size, p and q is needed")
    for key in tag:
        if key not in ("id", "size", "p", "q", "sigma"):
            raise MapError(choose_one_of(here, key, ("id", "size", "p", "q", "sigma")))
    for key in ("id", "size", "p", "q"):
        if key not in tag:
            raise MapError(f"{here}: `{key}` is missing; id, size, p and q are needed")
    tag_id = tag["id"]
    if isinstance(tag_id, bool) or not isinstance(tag_id, int):
        raise MapError(f"{here} id: {shown(tag_id)}; a whole number is needed")
    here = f"{where} tag {shown(tag_id)}"
    if not 0 <= tag_id < family.ids:
        raise MapError(f"{here}: not an id of {family.name}; 0 to {family.ids - 1} are")
    return (
        tag_id,
        side(tag["size"], f"{here} size"),
        position(tag["p"], f"{here} p"),
        unit_quaternion(tag["q"], f"{here} q"),
        _sigma(tag.get("sigma"), default, f"{here} sigma"),
    )


def _refuse_duplicates(ids: list[int], where: str) -> None:
    seen: dict[int, int] = {}
    for i, tag_id in enumerate(ids):
        if tag_id in seen:
            raise MapError(
                f"{where}: tag {tag_id} stands twice (tags[{seen[tag_id]}] and tags[{i}]);"
                " an id may lie in one place only"
            )
        seen[tag_id] = i


def _sigma(
    value: object, default: tuple[float, float, float, float], where: str
) -> tuple[float, float, float, float]:
    """xy [m], z [m], yaw [rad], tilt [rad] from a mapping in metres and degrees."""
    if value is None:
        return default
    if not isinstance(value, dict):
        raise MapError(
            f"{where}: {shown(value)}; a mapping with {', '.join(_SIGMA_KEYS)} is needed"
        )
    out = list(default)
    for key, number in value.items():
        if key not in _SIGMA_KEYS:
            raise MapError(choose_one_of(where, key, _SIGMA_KEYS))
        if not is_number(number) or number < 0.0:
            raise MapError(f"{where} {key}: {shown(number)}; a number of at least 0 is needed")
        most = LARGEST_SIGMA_DEG if key.endswith("_deg") else LARGEST_SIGMA_M
        if number > most:
            unit = "degrees" if key.endswith("_deg") else "metres"
            raise MapError(f"{where} {key}: {shown(number)}; at most {most:g} {unit} are of use")
        scale = np.pi / 180.0 if key.endswith("_deg") else 1.0
        out[_SIGMA_KEYS.index(key)] = float(number) * scale
    return (out[0], out[1], out[2], out[3])


def _gravity(value: object, where: str) -> Gravity | None:
    if value is None:
        return None
    if not isinstance(value, dict) or set(value) - {"dir", "sigma_deg"} or "dir" not in value:
        raise MapError(f"{where}: {shown(value)}; {{dir: [x, y, z], sigma_deg: 1}} is needed")
    d = np.array(numbers(value["dir"], 3, f"{where} dir"))
    norm = float(np.linalg.norm(d))
    if norm < 1e-6:
        raise MapError(f"{where} dir: the vector is zero; the direction in which things fall")
    x, y, z = (d / norm).tolist()
    return Gravity((x, y, z), _gravity_sigma(value.get("sigma_deg", 1.0), f"{where} sigma_deg"))


def _tidy(x: float, digits: int = 9) -> float:
    return round(float(x), digits) + 0.0


def _sigma_dict(sigma: Array | tuple[float, ...]) -> dict[str, float]:
    xy, z, yaw, tilt = (float(s) for s in sigma)
    degrees = {"yaw_deg": _tidy(np.degrees(yaw)), "tilt_deg": _tidy(np.degrees(tilt))}
    return {"xy": _tidy(xy), "z": _tidy(z), **degrees}


def map_to_dict(tag_map: TagMap) -> dict[str, Any]:
    """The mapping of a `tagmap.yaml`; the inverse of `map_from_dict`."""
    default = tag_map.sigma_default
    data: dict[str, Any] = {"family": tag_map.family.name, "size_kind": tag_map.size_kind}
    if tag_map.border_bits != 1:
        data["border_bits"] = tag_map.border_bits
    data["sigma"] = _sigma_dict(default)
    if tag_map.gravity is not None:
        data["gravity"] = {
            "dir": [_tidy(x) for x in tag_map.gravity.dir],
            "sigma_deg": tag_map.gravity.sigma_deg,
        }
    sizes = tag_map.size if tag_map.size_kind == "border" else tag_map.total_size
    quats = geo.quat_from_matrix(tag_map.R_WT)
    data["tags"] = []
    for i in range(len(tag_map)):
        tag: dict[str, Any] = {
            "id": int(tag_map.tag_id[i]),
            "size": _tidy(sizes[i]),
            "p": [_tidy(x) for x in tag_map.p_WT[i]],
            "q": [_tidy(x, 12) for x in quats[i]],
        }
        if not np.allclose(tag_map.sigma[i], default, rtol=1e-9, atol=0.0):
            tag["sigma"] = _sigma_dict(tag_map.sigma[i])
        data["tags"].append(tag)
    return data


def map_to_yaml(tag_map: TagMap) -> str:
    """Text of a `tagmap.yaml`, a line a tag."""
    data = map_to_dict(tag_map)
    tags = data.pop("tags")
    head = yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=100)
    return head + "tags:\n" + "".join(f"  - {flow_line(tag)}" for tag in tags)


def save_map(tag_map: TagMap, path: Path) -> None:
    """Write a `tagmap.yaml`, whole or not at all."""
    write_atomic(path, map_to_yaml(tag_map))
