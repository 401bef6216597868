"""How a rendered world and its camera are steered; by default nothing at all is wrong with them.

Grey levels are 0..255 and proportional to light; a share is of 1; lengths are metres in W.
"""

from typing import Literal

from pydantic import BaseModel, Field

Point = tuple[float, float, float]


class TextureConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """What the floor, the plane z = 0, is made of, and how strongly its pattern shows."""

    kind: Literal["plain", "wood", "tiles", "concrete"] = Field(
        default="plain", description="material: plain, wood, tiles, concrete"
    )
    strength_share: float = Field(
        default=0.35,
        ge=0.0,
        le=1.0,
        description="pattern's lightest and darkest, as a share of the floor's grey",
    )


class OccluderConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Objects lying about on the tags, up to half bigger or smaller than size_m."""

    count: int = Field(default=0, ge=0, le=80, description="how many things")
    size_m: float = Field(
        default=0.15, gt=0.0, le=10.0, description="size of one, up to half bigger or smaller [m]"
    )
    height_m: float = Field(
        default=0.0, ge=0.0, le=10.0, description="0: flat, as leaves or paper; else boxes [m]"
    )


class LightConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Uneven light; its mean over the map's tags is 1."""

    lamps_m: tuple[Point, ...] | None = Field(
        default=None,
        min_length=1,
        max_length=16,
        description="lamps, [[x, y, z], ...] in W; null: one 2.6 m above the map's middle [m]",
    )
    hot_spot_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of the light that comes from the lamps"
    )
    gradient_share: float = Field(
        default=0.0, ge=0.0, le=0.95, description="change from the middle of the map to its end"
    )
    gradient_deg: float = Field(
        default=0.0, description="direction of that change, from x of W to y [deg]"
    )
    flicker_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of the light that flickers with the mains"
    )
    flicker_hz: float = Field(
        default=100.0, gt=0.0, le=1e5, description="how fast it flickers [Hz]"
    )


class GlareConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The lamps' reflection in glossy print."""

    peak_grey: float = Field(
        default=0.0, ge=0.0, le=1e4, description="grey of the brightest reflection; 0: none"
    )
    width_deg: float = Field(
        default=4.0, gt=0.0, le=45.0, description="slope of the gloss where it fades [deg]"
    )


class ShadowConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The vehicle's shadow on the floor, in the lamps' light."""

    darkness_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of the light that the hull keeps off"
    )
    vehicle_m: float = Field(
        default=0.3, gt=0.0, le=10.0, description="across, propellers included [m]"
    )
    rotors: int = Field(
        default=4, ge=0, le=12, description="number of spinning, half transparent discs"
    )
    centre_C_m: Point = Field(default=(0.0, 0.1, -0.05), description="its middle in C [m]")
    lamp_m: float = Field(
        default=0.2, ge=0.01, le=10.0, description="diameter of a lamp, which softens the edge [m]"
    )


class SceneConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """The world as it really is."""

    laying_scale: float = Field(
        default=0.0,
        ge=0.0,
        le=100.0,
        description="laying errors, as multiples of the sigmas that the map states",
    )
    hidden_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of the tags that are missing"
    )
    torn_share: float = Field(
        default=0.0, ge=0.0, le=1.0, description="share of the tags of which a part is ripped off"
    )
    black_grey: float = Field(
        default=25.0, ge=0.0, le=255.0, description="grey of black print, 0 to 255"
    )
    white_grey: float = Field(
        default=225.0, ge=0.0, le=255.0, description="grey of white print, 0 to 255"
    )
    floor_grey: float = Field(
        default=128.0, ge=0.0, le=255.0, description="mean grey of the floor, 0 to 255"
    )
    occluders: OccluderConfig = Field(
        default=OccluderConfig(), description="things lying about on the tags"
    )
    texture: TextureConfig = Field(default=TextureConfig(), description="what the floor is made of")
    light: LightConfig = Field(
        default=LightConfig(), description="lamps and how uneven their light is"
    )
    glare: GlareConfig = Field(
        default=GlareConfig(), description="the lamps' reflection in glossy print"
    )
    shadow: ShadowConfig = Field(
        default=ShadowConfig(),
        description="the vehicle's shadow; what is not said is the vehicle's own",
    )


class LensConfig(BaseModel, frozen=True, extra="forbid", allow_inf_nan=False):
    """Lens, shutter and sensor."""

    exposure_s: float = Field(default=0.0, ge=0.0, le=1.0, description="exposure of one row [s]")
    readout_s: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="rolling shutter, from the first row to the last; 0: global [s]",
    )
    supersample: int = Field(
        default=8,
        ge=1,
        le=16,
        description="its square is the samples of a pixel; twice that where things move",
    )
    sub_exposures: int = Field(
        default=0,
        ge=0,
        le=64,
        description="instants of an exposure; 0: as many as the motion needs",
    )
    defocus_px: float = Field(
        default=0.0, ge=0.0, le=20.0, description="radius of the disc that a point becomes [px]"
    )
    vignetting: float = Field(
        default=0.0, ge=0.0, le=0.95, description="share of light lost in the farthest corner"
    )
    auto_exposure_grey: float | None = Field(
        default=None,
        gt=0.0,
        lt=255.0,
        description="mean grey of a picture, brought about by gain; null: as the scene is",
    )
    gain: float = Field(
        default=1.0,
        gt=0.0,
        le=1e3,
        description="gain with which the greys are reached; 4: a quarter of the electrons",
    )
    full_well_e: float | None = Field(
        default=None,
        ge=10.0,
        le=1e7,
        description="electrons at grey 255 and gain 1; null: no shot noise",
    )
    read_noise_grey: float = Field(
        default=0.0, ge=0.0, le=100.0, description="sigma of the read noise at gain 1 [grey values]"
    )
    gamma: float = Field(default=1.0, ge=0.25, le=4.0, description="grey is light^(1/gamma)")
    jpeg_quality: int | None = Field(
        default=None, ge=1, le=100, description="1 to 100; null: not compressed"
    )
