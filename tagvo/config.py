"""How tagvo is steered: one frozen model; a paper variant is four of its strings."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import (
    BaseModel,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    ValidationError,
    field_validator,
)

from tagvo.errors import ConfigError, shown

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


class IqrConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """How the interquartile range is taken; the paper gives the gain alone."""

    gain: PositiveFloat = 1.5
    quartiles: Literal["hazen", "linear", "weibull"] = "hazen"
    floor_m: NonNegativeFloat = 0.001


class JointConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Steps of Gauss-Newton, the robust loss (chi-square of a tag's 8 residuals), and whether the
    residuals may show that the map was laid better than it states (`laying_evidence`)."""

    max_steps: int = Field(default=12, ge=1, le=100)
    robust_chi2: PositiveFloat = 26.12  # 99.9 % of chi-square with 8 degrees of freedom
    reject_weight: PositiveFloat = Field(default=0.25, le=1.0)
    laying_evidence: bool = True


class FloorConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Standard deviations of what no fusion removes: the errors of the calibration."""

    focal_rel: NonNegativeFloat = 0.001
    principal_px: NonNegativeFloat = 0.5


class TrackConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Limits of the tracker and of its gate.

    mode: off: every frame is searched whole; on: tags are tracked where a prior allows it.
    min_side_px: shortest side of a tag worth tracking; max_tags: of one frame, the most useful
    first; min_tags and min_share: fewer tracked than this, or a smaller share of those tried, and
    the frame is searched whole; max_sigma_px: prior uncertainty of a corner beyond which nothing is
    tried; max_errors: cells of one tag that may read wrong; min_contrast: grey values between its
    white and its black; sweep_s: a full search of strips of the image takes so long to cover it,
    0: never; strips: how many; adaptive: a search is decimated as far as the tags expected in the
    image allow (AprilTag library, where tagvo.detector.decimate is null).
    """

    mode: Literal["off", "on"] = "off"
    min_side_px: float = Field(default=12.0, ge=8.0)
    max_tags: int = Field(default=64, ge=1, le=1000)
    min_tags: int = Field(default=1, ge=1)
    min_share: float = Field(default=0.5, ge=0.0, le=1.0)
    max_sigma_px: PositiveFloat = 15.0
    max_errors: int = Field(default=1, ge=0, le=4)
    min_contrast: float = Field(default=10.0, ge=4.0)
    sweep_s: float = Field(default=1.0, ge=0.0)
    strips: int = Field(default=4, ge=1, le=64)
    adaptive: bool = True

    @field_validator("mode", mode="before")
    @classmethod
    def _as_meant(cls, value: object) -> object:
        """YAML reads a bare on as true and off as false."""
        return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


class FilterConfig(BaseModel, frozen=True, extra="forbid"):
    """Limits of the detection filters.

    max_hamming: corrected bits; min_side_px: shortest side [px]; edge_px: least distance of a
    corner from the image's rim [px], negative: off (tags cut by the rim decode with corners off
    by up to 11 px; of 4,796 rendered tags of 36h11 that lie 6 px inside none was off by 0.5);
    min_margin: decision margin, 0 is off (a gate of 30 throws away real tags in dim rooms);
    duplicate_px: finds of one id that agree so well are one tag.
    """

    max_hamming: int = Field(1, ge=0)
    min_side_px: float = Field(6.0, ge=0.0)
    edge_px: float = Field(6.0, allow_inf_nan=False)
    min_margin: float = Field(0.0, ge=0.0)
    duplicate_px: float = Field(2.0, ge=0.0)


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
