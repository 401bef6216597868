"""From light to grey levels: vignetting, defocus, photons and read-out, gamma, JPEG.

Light is float, in grey levels 0..255 of a linear sensor; what goes beyond is cut off.
"""

from functools import lru_cache
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from tagvo.camera.model import Camera
from tagvo.render.cells_hit import Array32
from tagvo.render.config import LensConfig

Image: TypeAlias = NDArray[np.uint8]

_FULL = 255.0
_FEW = 60.0  # electrons: above, Poisson's law is drawn as Gauss's (the grey's steps hide the rest)
_AMPLIFIED = 16.0  # the most that exposure control makes of the light, and the least: 1 / it
_FINE = 16  # parts of a pixel along each axis that the disc of defocus is measured by


def develop(light: Array32, camera: Camera, lens: LensConfig, rng: np.random.Generator) -> Image:
    """The picture that light (h, w) on the sensor becomes."""
    if lens.vignetting > 0.0:
        light = light * falloff(camera, lens.vignetting)
    gain = lens.gain
    if lens.auto_exposure_grey is not None:
        factor = lens.auto_exposure_grey / max(float(light.mean()), 1e-3)
        factor = min(max(factor, 1.0 / _AMPLIFIED), _AMPLIFIED)
        light, gain = light * np.float32(factor), gain * factor
    light = exposed(light, lens, gain, rng)
    if lens.gamma != 1.0:
        light = np.clip(light, 0.0, _FULL)
        light = np.float32(_FULL) * (light / np.float32(_FULL)) ** np.float32(1.0 / lens.gamma)
    image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    return image if lens.jpeg_quality is None else through_jpeg(image, lens.jpeg_quality)


def exposed(light: Array32, lens: LensConfig, gain: float, rng: np.random.Generator) -> Array32:
    """Light with shot and read noise, in grey levels; the gain multiplies both."""
    read = np.float32(lens.read_noise_grey * gain)
    if lens.full_well_e is None:
        if read == 0.0:
            return light
        return np.asarray(light + read * rng.standard_normal(light.shape, np.float32), np.float32)
    per_electron = np.float32(_FULL * gain / lens.full_well_e)
    electrons = np.maximum(light, 0.0) / per_electron
    spread = np.sqrt(electrons * per_electron**2 + read * read)
    noisy = np.asarray(light + spread * rng.standard_normal(light.shape, np.float32), np.float32)
    few = electrons < _FEW
    if few.any():
        counted = rng.poisson(electrons[few]).astype(np.float32) * per_electron
        noisy[few] = counted + read * rng.standard_normal(len(counted), np.float32)
    return noisy


def falloff(camera: Camera, share: float) -> Array32:
    """Light left at each pixel by vignetting, 1 - share in the farthest corner; (h, w).

    The law of the cosine's fourth power, 1 / (1 + (r / r_0)^2)^2 about the principal point.
    """
    return _falloff(*camera.intrinsics[2:].tolist(), *camera.resolution, share)


@lru_cache(maxsize=8)
def _falloff(x0: float, y0: float, width: int, height: int, share: float) -> Array32:
    x, y = np.arange(width) - x0, np.arange(height)[:, None] - y0
    r2 = x * x + y * y
    r2 = r2 / r2.max() * ((1.0 - share) ** -0.5 - 1.0)
    return np.asarray((1.0 + r2) ** -2, dtype=np.float32)


def defocused(light: Array32, radius_px: float, pad: int) -> Array32:
    """Light with each point spread to a disc; `pad` pixels at every side are used up.

    light (h + 2 pad, w + 2 pad) -> (h, w).
    """
    if radius_px == 0.0:
        return light
    blurred = cv2.filter2D(light, cv2.CV_32F, disc(radius_px))
    return np.ascontiguousarray(blurred[pad:-pad, pad:-pad], dtype=np.float32)


def pad_of(radius_px: float) -> int:
    """Pixels around the picture from which a disc of that radius brings light into it."""
    return int(np.ceil(radius_px)) + 1 if radius_px > 0.0 else 0


@lru_cache(maxsize=8)
def disc(radius_px: float) -> Array32:
    """Weights (k, k) of a uniform disc, by the area of each pixel in it; their sum is 1."""
    reach = int(np.ceil(radius_px))
    fine = (np.arange((2 * reach + 1) * _FINE) + 0.5) / _FINE - reach - 0.5
    inside = fine**2 + fine[:, None] ** 2 <= radius_px**2
    area = inside.reshape(2 * reach + 1, _FINE, 2 * reach + 1, _FINE).mean(axis=(1, 3))
    return np.asarray(area / area.sum(), dtype=np.float32)


def through_jpeg(image: Image, quality: int) -> Image:
    """The picture after JPEG at this quality."""
    _, packed = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE), dtype=np.uint8)
