"""How a rendered world and its camera are steered; by default nothing at all is wrong with them.

Grey levels are 0..255 and proportional to light; a share is of 1; lengths are metres in W.
"""

from typing import Literal

from pydantic import BaseModel, Field

Point = tuple[float, float, float]


class TextureConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """What the floor, the plane z = 0, is made of, and how strongly its pattern shows.

    strength_share: the pattern's lightest and darkest places, as a share of the floor's grey.
    """

    kind: Literal["plain", "wood", "tiles", "concrete"] = "plain"
    strength_share: float = Field(default=0.35, ge=0.0, le=1.0)


class OccluderConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Objects lying about on the tags, up to half bigger or smaller than size_m.

    height_m: 0 for flat things with an irregular outline (leaves, cloths, paper); else boxes.
    """

    count: int = Field(default=0, ge=0, le=80)
    size_m: float = Field(default=0.15, gt=0.0, le=10.0)
    height_m: float = Field(default=0.0, ge=0.0, le=10.0)


class LightConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Uneven light; its mean over the map's tags is 1.

    lamps_m: where lamps hang (None: one 2.6 m above the middle of the map); they make the hot
    spots, the glare and the shadow. hot_spot_share: of the light that comes from the lamps and
    falls off with the fourth power of the cosine. gradient_share: change from the middle of the
    map to its end in the direction gradient_deg (from x of W to y). flicker_share, flicker_hz:
    of lamps on the mains, which stripes a rolling shutter's picture.
    """

    lamps_m: tuple[Point, ...] | None = Field(default=None, min_length=1, max_length=16)
    hot_spot_share: float = Field(default=0.0, ge=0.0, le=1.0)
    gradient_share: float = Field(default=0.0, ge=0.0, le=0.95)
    gradient_deg: float = 0.0
    flicker_share: float = Field(default=0.0, ge=0.0, le=1.0)
    flicker_hz: float = Field(default=100.0, gt=0.0, le=1e5)


class GlareConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The lamps' reflection in glossy print; width_deg: slope of the gloss where it fades."""

    peak_grey: float = Field(default=0.0, ge=0.0, le=1e4)
    width_deg: float = Field(default=4.0, gt=0.0, le=45.0)


class ShadowConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The vehicle's shadow on the floor, in the lamps' light.

    darkness_share: of the light that the vehicle's hull keeps off. vehicle_m: across with its
    propellers, which are `rotors` spinning, half transparent discs. centre_C_m: its middle in
    C (x right, y down the image, z ahead). lamp_m: diameter of a lamp, which softens the edge.
    """

    darkness_share: float = Field(default=0.0, ge=0.0, le=1.0)
    vehicle_m: float = Field(default=0.3, gt=0.0, le=10.0)
    rotors: int = Field(default=4, ge=0, le=12)
    centre_C_m: Point = (0.0, 0.1, -0.05)
    lamp_m: float = Field(default=0.2, ge=0.01, le=10.0)


class SceneConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The world as it really is.

    laying_scale: laying errors as multiples of the map's own sigmas. hidden_share: of the tags
    that are missing; torn_share: of the tags of which a part is ripped off.
    """

    laying_scale: float = Field(default=0.0, ge=0.0, le=100.0)
    hidden_share: float = Field(default=0.0, ge=0.0, le=1.0)
    torn_share: float = Field(default=0.0, ge=0.0, le=1.0)
    black_grey: float = Field(default=25.0, ge=0.0, le=255.0)
    white_grey: float = Field(default=225.0, ge=0.0, le=255.0)
    floor_grey: float = Field(default=128.0, ge=0.0, le=255.0)
    occluders: OccluderConfig = OccluderConfig()
    texture: TextureConfig = TextureConfig()
    light: LightConfig = LightConfig()
    glare: GlareConfig = GlareConfig()
    shadow: ShadowConfig = ShadowConfig()


class LensConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Lens, shutter and sensor.

    exposure_s: of one row. readout_s: from the first row to the last (rolling shutter).
    supersample: its square is the number of samples of a pixel, twice that where things move.
    sub_exposures: instants that make an exposure, each with all samples (0: no instants, each
    sample has a moment of its own, as many as the motion needs). defocus_px: radius of the disc
    that a point becomes. vignetting: share of light lost in the farthest corner.
    auto_exposure_grey: mean grey that the exposure control brings about by gain (None: the scene's
    greys are the picture's). gain: with which the greys are reached: 4 means a quarter of the
    electrons. full_well_e: electrons at grey 255 and gain 1 (None: no shot noise).
    read_noise_grey: one sigma, at gain 1. gamma: grey is light^(1/gamma). jpeg_quality: None
    leaves the picture as it is.
    """

    exposure_s: float = Field(default=0.0, ge=0.0, le=1.0)
    readout_s: float = Field(default=0.0, ge=0.0, le=1.0)
    supersample: int = Field(default=8, ge=1, le=16)
    sub_exposures: int = Field(default=0, ge=0, le=64)
    defocus_px: float = Field(default=0.0, ge=0.0, le=20.0)
    vignetting: float = Field(default=0.0, ge=0.0, le=0.95)
    auto_exposure_grey: float | None = Field(default=None, gt=0.0, lt=255.0)
    gain: float = Field(default=1.0, gt=0.0, le=1e3)
    full_well_e: float | None = Field(default=None, ge=10.0, le=1e7)
    read_noise_grey: float = Field(default=0.0, ge=0.0, le=100.0)
    gamma: float = Field(default=1.0, ge=0.25, le=4.0)
    jpeg_quality: int | None = Field(default=None, ge=1, le=100)
