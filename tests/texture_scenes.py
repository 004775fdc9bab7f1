"""Pictures of two textures that grey values cannot tell apart: equal histograms, other orientation or other scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.ndimage import gaussian_filter

from twistcap._typing import Bool, Float, Float32

Kind = Literal["0 | 90", "45 | 135", "scale"]
KINDS: tuple[Kind, ...] = ("0 | 90", "45 | 135", "scale")
SIZE = (150, 220)
LOOSE = 0.5


@dataclass(frozen=True)
class TextureScene:
    """An image (H, W) in [0, 1], its inner region (H, W), and a misplaced start (H, W)."""

    image: Float32
    region: Bool
    start: Bool


def texture_scene(kind: Kind, seed: int) -> TextureScene:
    """A smooth blob of one texture before another; the values of both are the same numbers, by rank."""
    rng = np.random.default_rng(seed)
    region = blob(rng)
    wave, ways = (6.0, 6.0), (0.0, 90.0)
    if kind == "45 | 135":
        ways = (45.0, 135.0)
    if kind == "scale":
        first, second = (isotropic(rng, w) for w in (4.5, 12.0))
    else:
        first, second = (oriented(rng, w, a) for w, a in zip(wave, ways, strict=True))
    image = np.empty(SIZE)
    levels = np.clip(rng.normal(0.5, 0.12, SIZE), 0.0, 1.0)  # one histogram for both regions, but for their sizes
    for where, texture in ((region, first), (~region, second)):
        image[where] = np.quantile(levels, (ranks(texture[where]) + 0.5) / where.sum())
    return TextureScene(image.astype(np.float32), region, misplaced(region))


def ranks(values: Float) -> Float:
    out = np.empty(len(values))
    out[np.argsort(values, kind="stable")] = np.arange(len(values))
    return out


def oriented(rng: np.random.Generator, wavelength: float, degrees: float) -> Float:
    """(H, W) stripes of noise whose wave vector points `degrees` from x towards y."""
    fx, fy = frequencies()
    a = np.deg2rad(degrees)
    gain = sum(
        np.exp(-0.5 * (((fx - s * np.cos(a) / wavelength) ** 2 + (fy - s * np.sin(a) / wavelength) ** 2) / 0.03**2))
        for s in (-1, 1)
    )
    return filtered(rng, gain)


def isotropic(rng: np.random.Generator, wavelength: float) -> Float:
    """(H, W) noise about one wavelength in all directions."""
    fx, fy = frequencies()
    return filtered(rng, np.exp(-0.5 * ((np.hypot(fx, fy) * wavelength - 1.0) / 0.2) ** 2))


def frequencies() -> tuple[Float, Float]:
    return np.fft.fftfreq(SIZE[1])[None], np.fft.fftfreq(SIZE[0])[:, None]


def filtered(rng: np.random.Generator, gain: Float) -> Float:
    return np.fft.ifft2(gain * np.fft.fft2(rng.standard_normal(SIZE))).real


def blob(rng: np.random.Generator) -> Bool:
    """A smooth closed shape about the middle."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    dx, dy = x - SIZE[1] / 2, y - SIZE[0] / 2
    angle, radius = np.arctan2(dy, dx), 45.0
    for k in (2, 3):
        radius = radius + rng.uniform(2.0, 6.0) * np.cos(k * angle + rng.uniform(0, 2 * np.pi))
    return np.hypot(dx, dy) < radius


def misplaced(region: Bool) -> Bool:
    """A disc of half the region's size, off its middle."""
    y, x = np.mgrid[: SIZE[0], : SIZE[1]]
    return np.hypot(x - region.shape[1] / 2 - 12.0, y - region.shape[0] / 2 + 8.0) < 27.0


def iou(a: Bool, b: Bool) -> float:
    return float((a & b).sum() / (a | b).sum())
