"""The world that a camera is put into: tags as they truly lie, things on them, floor and light.

What is wrong with it is drawn once from an `rng`, each kind from a stream of its own: more torn
tags leave the laying errors as they were, and a larger share hides the same tags and more.
"""

from dataclasses import dataclass, replace

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.render.cells_hit import BLACK, FIRST_OBJECT, WHITE
from tagvo.render.config import LensConfig as LensConfig
from tagvo.render.config import SceneConfig as SceneConfig
from tagvo.render.lighting import even_light, lamps_over
from tagvo.render.surfaces import Patches, joined, object_patches, tag_patches
from tagvo.render.texture import Texture, make_texture
from tagvo.tags.tag_map import TagMap


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A world at rest. tag_map: the tags that are there, as they truly lie; hidden (k,), torn (k,):
    ids of those that are missing, and of those there but ripped; patches: tags, then objects;
    grey (256,) of the patches' codes; lamps (k, 3) [m]; places (k, 3) [m]: where the map's tags
    are; light_scale: makes the light's mean over the places 1."""

    config: SceneConfig
    tag_map: TagMap
    hidden: IntArray
    torn: IntArray
    patches: Patches
    grey: Array
    texture: Texture | None
    lamps: Array
    places: Array
    light_scale: float


def make_scene(tag_map: TagMap, config: SceneConfig, rng: np.random.Generator) -> Scene:
    """The world of a map: laid, hidden, torn, littered and lit as the config says."""
    laying, hiding, tearing, jags, littering, floor = rng.spawn(6)
    laid = displaced(tag_map, laying, scale=config.laying_scale)
    hidden = _chosen(len(tag_map), config.hidden_share, hiding)
    torn = _chosen(len(tag_map), config.torn_share, tearing)
    tags = tag_patches(laid, torn, jags)
    objects, greys = object_patches(config.occluders, laid, littering)
    grey = np.zeros(256)
    grey[[BLACK, WHITE]] = config.black_grey, config.white_grey
    grey[FIRST_OBJECT : FIRST_OBJECT + len(greys)] = greys
    places = tag_map.p_WT
    lamps = lamps_over(config.light, places)
    return Scene(
        config=config,
        tag_map=laid.only(laid.tag_id[~hidden]),
        hidden=laid.tag_id[hidden],
        torn=laid.tag_id[torn & ~hidden],
        patches=joined([tags.only(~hidden), *objects]),
        grey=grey,
        texture=make_texture(config.texture, floor),
        lamps=lamps,
        places=places,
        light_scale=1.0 / float(even_light(config.light, places, lamps, places).mean()),
    )


def _chosen(n: int, share: float, rng: np.random.Generator) -> BoolArray:
    """Which of n are chosen at this share; a larger one takes these and more."""
    return np.asarray(rng.permutation(n) < round(share * n))


def displaced(
    tag_map: TagMap,
    rng: np.random.Generator,
    sigma: tuple[float, float, float, float] | None = None,
    scale: float = 1.0,
) -> TagMap:
    """The map as it might really lie: laying errors drawn from its own sigmas times `scale`.

    sigma: xy [m], z [m], yaw [rad], tilt [rad] in T, in place of the map's own.
    """
    if sigma is not None:
        tag_map = replace(tag_map, sigma=np.tile(sigma, (len(tag_map), 1)))
    error = scale * tag_map.laying_sigma * rng.standard_normal((len(tag_map), 6))
    R_WT, p_WT = geo.compose(tag_map.R_WT, tag_map.p_WT, geo.exp(error[:, 3:]), error[:, :3])
    return replace(tag_map, R_WT=R_WT, p_WT=p_WT)
