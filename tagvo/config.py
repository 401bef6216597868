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

    library: Literal["auto", "apriltag", "aruco"] = Field(
        default="auto",
        description="apriltag, aruco (OpenCV), or auto: apriltag where it knows the family",
    )
    decimate: PositiveFloat | None = Field(
        default=None,
        description="apriltag searches at 1/this size; null: 1.5 below 1280 px of width, else 2",
    )
    max_hamming: int = Field(
        default=1, ge=0, le=2, description="wrong bits that the decoder corrects, 0 to 2"
    )
    threads: int = Field(
        default=1, ge=1, le=16, description="threads of the AprilTag library, 1 to 16"
    )


class NoiseConfig(BaseModel, frozen=True, extra="forbid"):
    """Corner noise [px, one sigma per axis]: of corners that come with a frame, and of sharp ones
    found in its image; with `blur` the latter grows with the measured edge width."""

    corner_px: float = Field(
        default=0.3,
        gt=0.0,
        le=1e3,
        description="standard deviation of a corner per axis that came without its image [px]",
    )
    image_px: float = Field(
        default=0.1,
        gt=0.0,
        le=1e3,
        description="standard deviation of a sharp corner found in an image [px]",
    )
    blur: bool = Field(
        default=True,
        description="measure the blur of each edge in the image and raise the sigma with it",
    )


class IqrConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """How the interquartile range is taken; the paper gives the gain alone."""

    gain: PositiveFloat = Field(
        default=1.5, description="kept: within this many interquartile ranges of the quartiles"
    )
    quartiles: Literal["hazen", "linear", "weibull"] = Field(
        default="hazen", description="which quartiles: hazen, linear (numpy's) or weibull"
    )
    floor_m: NonNegativeFloat = Field(
        default=0.001,
        description="least interquartile range [m]; without it exact data would lose tags",
    )


class JointConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Steps of Gauss-Newton, the robust loss (chi-square of a tag's 8 residuals), and whether the
    residuals may show that the map was laid better than it states (`laying_evidence`)."""

    max_steps: int = Field(default=12, ge=1, le=100, description="Gauss-Newton steps, 1 to 100")
    robust_chi2: PositiveFloat = Field(
        default=26.12,
        description="chi-square of a tag's 8 residuals from which it counts less (99.9 %)",
    )
    reject_weight: PositiveFloat = Field(
        default=0.25,
        le=1.0,
        description="a tag of less weight than this is not named as used, 0 to 1",
    )
    laying_evidence: bool = Field(
        default=True,
        description="residuals may show that tags were laid better than the map's sigma",
    )


class IntrinsicsErrorConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Standard deviations of focal length and principal point, common to all tags of a frame."""

    focal_rel: NonNegativeFloat = Field(
        default=0.001, description="standard deviation of the focal length, as a share of it"
    )
    principal_px: NonNegativeFloat = Field(
        default=0.5, description="standard deviation of the principal point per axis [px]"
    )


class TrackConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Limits of the tracker and of the policy that decides when to track and when to search."""

    mode: Literal["off", "on"] = Field(
        default="off",
        description="on: track where the filter gives a prior, search the whole image elsewhere",
    )
    min_side_px: float = Field(
        default=12.0, ge=8.0, description="shortest side of a tag worth tracking [px]"
    )
    max_tags: int = Field(
        default=64, ge=1, le=1000, description="most tags of one frame, the most useful first"
    )
    min_tags: int = Field(
        default=1, ge=1, description="fewer than this tracked, and the frame is searched whole"
    )
    min_share: float = Field(
        default=0.5,
        ge=0.0,
        le=1.0,
        description="least share of the tags tried that is tracked; below it: searched whole",
    )
    max_sigma_px: PositiveFloat = Field(
        default=15.0, description="uncertainty of the prediction beyond which nothing is tried [px]"
    )
    max_errors: int = Field(
        default=1, ge=0, le=4, description="most cells of a tag that may read wrong"
    )
    min_contrast: float = Field(
        default=10.0, ge=4.0, description="least difference of white and black [grey values]"
    )
    sweep_s: float = Field(
        default=1.0,
        ge=0.0,
        description="a full search, strip by strip, covers the image in this time [s]; 0: never",
    )
    strips: int = Field(
        default=4, ge=1, le=64, description="how many strips the image is parted into"
    )
    adaptive: bool = Field(
        default=True, description="decimate a search as far as the expected tags allow"
    )

    @field_validator("mode", mode="before")
    @classmethod
    def _as_meant(cls, value: object) -> object:
        """YAML reads a bare on as true and off as false."""
        return {True: "on", False: "off"}[value] if isinstance(value, bool) else value


class FilterConfig(BaseModel, frozen=True, extra="forbid"):
    """Limits of the detection filters.

    Tags cut by the rim decode with corners off by up to 11 px; of 4,796 rendered tags of 36h11 that
    lie 6 px inside none was off by 0.5. A decision margin of 30 throws away real tags in dim rooms.
    """

    max_hamming: int = Field(default=1, ge=0, description="most corrected bits of a detection")
    min_side_px: float = Field(
        default=6.0, ge=0.0, description="shortest side of a tag in the image [px]"
    )
    edge_px: float = Field(
        default=6.0,
        allow_inf_nan=False,
        description="least distance of a corner from the image's rim [px]; negative: any",
    )
    min_margin: float = Field(
        default=0.0, ge=0.0, description="least decision margin of the decoder; 0: any"
    )
    duplicate_px: float = Field(
        default=2.0,
        ge=0.0,
        description="finds of one id closer than this are one tag; further apart, none is used",
    )


class TagvoConfig(BaseModel, frozen=True, extra="forbid"):
    """The stages of the pipeline by name, and their settings."""

    pose: Literal["fused", "joint"] = Field(
        default="joint",
        description="joint: one least-squares pose of all corners; fused: the paper's mean",
    )
    select: Literal["JBT", "TBS", "ALL"] = Field(
        default="TBS",
        description="TBS: tags of the two biggest sizes in view; JBT: the one biggest tag; ALL",
    )
    outliers: Literal["iqr", "none"] = Field(
        default="iqr",
        description="OR: interquartile range of the tags' positions, axis by axis; none: keep all",
    )
    weights: Literal["W1", "W2", "uniform"] = Field(
        default="W2",
        description="by size h = log2(size / smallest): W2 = 2^h, W1 = 4^h, uniform = 1",
    )
    mean: Literal["QL2", "CL2"] = Field(
        default="QL2",
        description="of rotations: QL2, weighted quaternion sum; CL2, eigenvector of sum w q q^T",
    )
    fir: Literal["none", "paper", "endpoint"] = Field(
        default="none",
        description="smooths vo.tum over five poses: none; paper: mean, lags; endpoint: no lag",
    )
    fir_gap_s: float = Field(
        default=0.25,
        gt=0.0,
        le=1e6,
        description="the FIR starts anew after a gap longer than this [s]",
    )
    ambiguity: Literal["first", "consistent", "prior"] = Field(
        default="consistent",
        description="which of a tag's two poses: consistent with others; first: lower error; prior",
    )
    refine: int = Field(
        default=1,
        ge=0,
        le=10,
        description="Gauss-Newton steps on each tag's pose after IPPE, 0 to 10 (pose: fused)",
    )
    iqr: IqrConfig = Field(default=IqrConfig(), description="how `outliers: iqr` measures")
    joint: JointConfig = Field(default=JointConfig(), description="how `pose: joint` solves")
    noise: NoiseConfig = Field(
        default=NoiseConfig(), description="standard deviations of the corners"
    )
    floor: IntrinsicsErrorConfig = Field(
        default=IntrinsicsErrorConfig(),
        description="what no number of tags averages away: the camera's calibration",
    )
    detector: DetectorConfig = Field(default=DetectorConfig(), description="finds tags in images")
    track: TrackConfig = Field(
        default=TrackConfig(),
        description="look for tags where the filter expects them; counted in run.json",
    )
    filters: FilterConfig = Field(
        default=FilterConfig.model_validate({}),
        description="which detections are used; what falls is counted by cause in run.json",
    )


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
