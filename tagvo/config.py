"""How tagvo is steered: one frozen model; a paper variant is four of its strings."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, PositiveFloat, ValidationError

from tagvo.detect.filters import FilterConfig
from tagvo.errors import ConfigError, shown
from tagvo.information import FloorConfig
from tagvo.joint import JointConfig
from tagvo.outliers import IqrConfig
from tagvo.track.settings import TrackConfig

Model = TypeVar("Model", bound=BaseModel)


class DetectorConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Which detector, and how it searches."""

    library: Literal["auto", "apriltag", "aruco"] = "auto"
    decimate: PositiveFloat | None = None
    max_hamming: int = Field(default=1, ge=0, le=2)
    threads: int = Field(default=1, ge=1, le=16)


class NoiseConfig(BaseModel, frozen=True, extra="forbid"):
    """Corner noise [px, one sigma per axis]: of corners that come with a frame, and of sharp ones
    found in its image; with `blur` the latter grows with the measured edge width."""

    corner_px: float = Field(default=0.3, gt=0.0, le=1e3)
    image_px: float = Field(default=0.1, gt=0.0, le=1e3)
    blur: bool = True


class TagvoConfig(BaseModel, frozen=True, extra="forbid"):
    """The stages of the pipeline by name, and their settings."""

    pose: Literal["fused", "joint"] = "joint"
    select: Literal["JBT", "TBS", "ALL"] = "TBS"
    outliers: Literal["iqr", "none"] = "iqr"
    weights: Literal["W1", "W2", "uniform"] = "W2"
    mean: Literal["QL2", "CL2"] = "QL2"
    fir: Literal["none", "paper", "endpoint"] = "none"
    fir_gap_s: float = Field(default=0.25, gt=0.0, le=1e6)
    ambiguity: Literal["first", "consistent", "prior"] = "consistent"
    refine: int = Field(default=1, ge=0, le=10)
    iqr: IqrConfig = IqrConfig()
    joint: JointConfig = JointConfig()
    noise: NoiseConfig = NoiseConfig()
    floor: FloorConfig = FloorConfig()
    detector: DetectorConfig = DetectorConfig()
    track: TrackConfig = TrackConfig()
    filters: FilterConfig = FilterConfig.model_validate({})


def validated(model: type[Model], data: object, where: str, prefix: str = "") -> Model:
    """The model of a mapping; ConfigError names file, key, what came and what is allowed."""
    try:
        return model.model_validate(data)
    except ValidationError as err:
        first = err.errors()[0]
        path = [*([prefix] if prefix else []), *first["loc"]]
        raise ConfigError(_say(model, first, where, path)) from None


def _say(model: type[BaseModel], fault: Any, where: str, path: Iterable[Any]) -> str:
    keys = [str(key) for key in path]
    here = f"{where} {'.'.join(keys)}"
    if fault["type"] == "extra_forbidden":
        known = ", ".join(_fields_at(model, fault["loc"][:-1]))
        inside = ".".join(keys[:-1])
        above = f"{where} {inside}" if inside else where
        return f"{above}: unknown {shown(keys[-1])}; choose one of {known}"
    if fault["type"] == "literal_error":
        allowed = fault["ctx"]["expected"].replace("'", "").replace(" or ", ", ")
        return f"{here}: unknown {shown(fault['input'])}; choose one of {allowed}"
    if fault["type"] in ("model_type", "model_attributes_type"):
        return f"{here}: {shown(fault['input'])}; a mapping `key: value` is needed"
    message = fault["msg"][:1].lower() + fault["msg"][1:]
    return f"{here}: {shown(fault['input'])}; {message}"


def _fields_at(model: type[BaseModel], loc: tuple[Any, ...]) -> list[str]:
    for key in loc:
        annotation = model.model_fields[str(key)].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            break
        model = annotation
    return list(model.model_fields)


def load_tagvo_config(path: Path) -> TagvoConfig:
    """The `tagvo` section of a config file; for those who use tagvo without vio."""
    from tagvo.textfile import read_yaml

    section = read_yaml(path, ConfigError).get("tagvo")
    return validated(TagvoConfig, {} if section is None else section, str(path), "tagvo")
