"""How light falls on a rendered floor: lamps, their reflections, the vehicle's shadow, flicker.

Everything here is smooth across the picture and computed on places of the floor, the plane z = 0.
"""

import numpy as np

from tagvo.geometry import Array
from tagvo.render.config import GlareConfig, LightConfig, ShadowConfig

_LAMP_M = 2.6  # height of the lamp where the config names none
_HULL = 0.35  # radius of the hull, as a share of the vehicle's
_ROTOR, _ROTOR_DARK = 0.42, 0.35  # radius of a rotor's disc likewise, and how much light it stops
_DARKEST = 0.02  # no place is darker than this


def lamps_over(config: LightConfig, places_W: Array) -> Array:
    """Where the lamps hang (n, 3) [m]; places_W (k, 3): the tags'."""
    if config.lamps_m is not None:
        return np.array(config.lamps_m, dtype=float)
    middle = 0.5 * (places_W.min(axis=0) + places_W.max(axis=0))
    return np.asarray(middle + np.array([0.0, 0.0, _LAMP_M]))[None]


def even_light(config: LightConfig, places_W: Array, lamps: Array, X_W: Array) -> Array:
    """Light at X_W (..., 3) that does not move: hot spots and the gradient; (...).

    Not normalised: see `Scene.light_scale`.
    """
    d = X_W[..., None, :] - lamps
    cosine2 = d[..., 2] ** 2 / np.maximum(np.einsum("...i,...i->...", d, d), 1e-9)
    spots = 1.0 - config.hot_spot_share * (1.0 - np.mean(cosine2**2, axis=-1))
    if config.gradient_share == 0.0:
        return np.asarray(spots)
    angle = np.radians(config.gradient_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    ends = places_W[:, :2] @ along
    middle, half = 0.5 * (ends.max() + ends.min()), max(0.5 * (ends.max() - ends.min()), 1e-3)
    slope = 1.0 + config.gradient_share * (X_W[..., :2] @ along - middle) / half
    return np.asarray(spots * np.maximum(slope, _DARKEST))


def shaded_share(config: ShadowConfig, lamps: Array, R_WC: Array, p_WC: Array, X_W: Array) -> Array:
    """Share of each lamp's light that the vehicle keeps off X_W (h, w, 3); (h, w, lamps).

    R_WC (h, 3, 3), p_WC (h, 3): the camera at each row's time.
    """
    centre = p_WC + R_WC @ np.array(config.centre_C_m)
    shade = np.zeros((*X_W.shape[:-1], len(lamps)))
    for j, lamp in enumerate(lamps):
        gap = lamp[2] - centre[:, 2]
        under = (gap > 1e-3) & (centre[:, 2] > 0.0)
        gap = np.where(under, gap, 1.0)
        grow = lamp[2] / gap  # of the shadow against the vehicle
        soft = 0.5 * config.lamp_m * centre[:, 2] / gap
        clear = np.ones(X_W.shape[:-1])
        for at_C, radius, dark in _discs(config):
            disc = centre + R_WC @ at_C
            foot = lamp + (disc - lamp) * grow[:, None]
            away = np.hypot(*(X_W[..., :2] - foot[:, None, :2]).transpose(2, 0, 1))
            clear *= 1.0 - dark * _overlap(away, radius * grow, soft)
        shade[..., j] = np.where(under[:, None], 1.0 - clear, 0.0)
    return shade


def _discs(config: ShadowConfig) -> list[tuple[Array, float, float]]:
    """Of the hull and each rotor: its place from the vehicle's middle in C, radius, opacity."""
    radius = 0.5 * config.vehicle_m
    discs = [(np.zeros(3), _HULL * radius, 1.0)]
    for k in range(config.rotors):
        angle = 2.0 * np.pi * (k + 0.5) / config.rotors
        at = (1.0 - _ROTOR) * radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        discs.append((at, _ROTOR * radius, _ROTOR_DARK))
    return discs


def _overlap(away: Array, R: Array, r: Array) -> Array:
    """Share of discs of radius r that lies in discs of radius R at distances (h, w); R, r (h,)."""
    r = np.maximum(r, 1e-6)
    R, r = np.broadcast_arrays(R[:, None], away)[0], np.broadcast_arrays(r[:, None], away)[0]
    share = np.where(away <= np.abs(R - r), np.minimum(R / r, 1.0) ** 2, 0.0)
    cut = (away > np.abs(R - r)) & (away < R + r)
    d, R, r = away[cut], R[cut], r[cut]
    q = (d * d + R * R - r * r) / (2.0 * d)  # from the middle of R to the chord
    p = d - q
    lens = R * R * np.arccos(np.clip(q / R, -1.0, 1.0)) - q * np.sqrt(
        np.maximum(R * R - q * q, 0.0)
    )
    lens += r * r * np.arccos(np.clip(p / r, -1.0, 1.0)) - p * np.sqrt(
        np.maximum(r * r - p * p, 0.0)
    )
    share[cut] = lens / (np.pi * r * r)
    return share


def glare_grey(config: GlareConfig, lamps: Array, p_WC: Array, X_W: Array) -> Array:
    """Light of each lamp mirrored by glossy print at X_W (h, w, 3) into C; (h, w, lamps) greys."""
    width2 = np.tan(np.radians(config.width_deg)) ** 2
    to_camera = p_WC[:, None] - X_W
    to_camera = to_camera / np.linalg.norm(to_camera, axis=-1, keepdims=True)
    out = np.zeros((*X_W.shape[:-1], len(lamps)))
    for j, lamp in enumerate(lamps):
        to_lamp = lamp - X_W
        half = to_camera + to_lamp / np.linalg.norm(to_lamp, axis=-1, keepdims=True)
        slope2 = (half[..., 0] ** 2 + half[..., 1] ** 2) / np.maximum(half[..., 2] ** 2, 1e-12)
        out[..., j] = config.peak_grey * np.exp(-slope2 / width2)
    return out


def flicker(config: LightConfig, t_s: Array, exposure_s: float) -> Array:
    """Mean light of mains lamps over an exposure around each time; (n,) -> (n,)."""
    w = 2.0 * np.pi * config.flicker_hz
    steady = np.sinc(config.flicker_hz * exposure_s)
    return np.asarray(1.0 + config.flicker_share * steady * np.sin(w * t_s))
