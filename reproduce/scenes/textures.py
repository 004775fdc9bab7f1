"""Pictures of a shape that grey values cannot show: two textures of one histogram, of other orientation or scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from twistcap.arrays import Bool, Float, Float32

Difference = Literal["0 | 90", "45 | 135", "scale"]
DIFFERENCES: tuple[Difference, ...] = get_args(Difference)
"""Direction of the grey values' waves inside and outside, degrees from x towards y; or two scales."""

_DIRECTIONS = {"0 | 90": (0.0, 90.0), "45 | 135": (45.0, 135.0)}
_WAVELENGTH, _WAVELENGTHS = 6.0, (4.5, 12.0)  # px
_SPREAD = 0.03  # 1/px, standard deviation of the stripes' frequencies
_BAND = 0.2  # the same of the isotropic noise, as a fraction of its frequency
_RADIUS = 52.0  # px


@dataclass(frozen=True)
class TextureScene:
    """One picture and its truth.

    Attributes:
        image: (H, W) grey in [0, 1]; the values inside and outside have one and the same distribution.
        region: (H, W) the shape.
        start: (H, W) a disc a quarter of its size and beside its middle, where a segmentation may begin.
    """

    image: Float32
    region: Bool
    start: Bool


def texture_scene(difference: Difference, seed: int, size: tuple[int, int] = (150, 220)) -> TextureScene:
    """A smooth shape of one texture before another, (H, W) = `size`."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1]] - 0.5 * np.array(size)[:, None, None]
    region = _blob(rng, x, y)
    if difference == "scale":
        inner, outer = (_filtered(rng, _ring(size, wavelength)) for wavelength in _WAVELENGTHS)
    else:
        inner, outer = (_filtered(rng, _stripes(size, degrees)) for degrees in _DIRECTIONS[difference])
    levels = np.clip(rng.normal(0.5, 0.12, size), 0.0, 1.0)
    image = np.empty(size, dtype=np.float32)
    image[region], image[~region] = _as_distributed(inner[region], levels), _as_distributed(outer[~region], levels)
    return TextureScene(image, region, np.hypot(x - 12.0, y + 8.0) < 0.5 * _RADIUS)


def _as_distributed(values: Float, levels: Float) -> Float:
    """The values (N,) changed, in their order, to quantiles of `levels`."""
    rank = np.empty(len(values))
    rank[np.argsort(values, kind="stable")] = np.arange(len(values))
    place = (rank + 0.5) / len(values) * (levels.size - 1)  # as np.quantile, which takes half a second
    return np.interp(place, np.arange(levels.size), np.sort(levels, axis=None))


def _blob(rng: np.random.Generator, x: Float, y: Float) -> Bool:
    """A smooth closed shape about the origin."""
    angle, radius = np.arctan2(y, x), np.full(x.shape, _RADIUS)
    for waves in (2, 3):
        radius += rng.uniform(2.0, 6.0) * np.cos(waves * angle + rng.uniform(0.0, 2.0 * np.pi))
    return np.hypot(x, y) < radius


def _filtered(rng: np.random.Generator, gain: Float) -> Float:
    """(H, W) noise of the spectrum `gain` (H, W)."""
    return np.fft.ifft2(gain * np.fft.fft2(rng.standard_normal(gain.shape))).real


def _stripes(size: tuple[int, int], degrees: float) -> Float:
    """(H, W) spectrum of waves in one direction."""
    fx, fy = _frequencies(size)
    cx, cy = np.cos(np.radians(degrees)) / _WAVELENGTH, np.sin(np.radians(degrees)) / _WAVELENGTH
    there, back = (np.exp(-0.5 * np.hypot(fx - s * cx, fy - s * cy) ** 2 / _SPREAD**2) for s in (-1.0, 1.0))
    return there + back


def _ring(size: tuple[int, int], wavelength: float) -> Float:
    """(H, W) spectrum of one wavelength in all directions."""
    return np.exp(-0.5 * ((np.hypot(*_frequencies(size)) * wavelength - 1.0) / _BAND) ** 2)


def _frequencies(size: tuple[int, int]) -> tuple[Float, Float]:
    """Of x (1, W) and y (H, 1), 1/px."""
    fy, fx = (np.asarray(np.fft.fftfreq(n), dtype=np.float64) for n in size)
    return fx[None], fy[:, None]
