"""How the tracker is steered: when it may replace the detector, and within what bounds."""

from typing import Literal

from pydantic import BaseModel, Field, PositiveFloat, field_validator


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
