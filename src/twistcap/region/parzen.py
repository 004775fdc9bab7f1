"""Parzen density estimates of whole regions, channel by channel: a histogram under a Gaussian kernel.

The density model of Kim, Fisher, Yezzi, Cetin and Willsky with which Brox, Rosenhahn and Cremers compare their local
one ("Contours, Optic Flow, and Prior Knowledge", Fig. 11.4).
"""

from __future__ import annotations

import math

import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.errors import InputError

_BINS_PER_SIGMA = 4.0
_MOST_BINS = 4096


def parzen_log_ratio(channels: Float32, inside: Float32, outside: Float32, sigma: float, floor: float) -> Float32:
    """(H, W) Σ_j log (p₁ + floor)/(p₂ + floor), nats, of channels (H, W, C) under both regions' Parzen densities.

    Args:
        channels: (H, W, C).
        inside, outside: (H, W) weight of each pixel in the two regions.
        sigma: standard deviation of the kernel, in units of the channels.
        floor: added to the densities, per unit of the channels, so that no value is impossible.

    Raises InputError if sigma or floor is not positive and finite.
    """
    if not (0.0 < sigma < math.inf and 0.0 < floor < math.inf):
        raise InputError(f"parzen: sigma is {sigma} and floor {floor}; both must be positive and finite.")
    out = np.zeros(inside.shape, dtype=np.float32)
    for j in range(channels.shape[2]):
        start, width, density = parzen_densities(channels[..., j], inside, outside, sigma)
        table = np.log((density[0] + floor) / (density[1] + floor)).astype(np.float32)
        first, far = _bins(channels[..., j], start, width, len(table))
        out += (1.0 - far) * table[first] + far * table[first + 1]
    return out


def parzen_densities(values: Float32, inside: Float32, outside: Float32, sigma: float) -> tuple[float, float, Float]:
    """First place, spacing and densities (2, B) of the values (H, W) of both regions; 0 where a region is empty."""
    low, high = float(values.min()) - 4.0 * sigma, float(values.max()) + 4.0 * sigma
    bins = min(math.ceil((high - low) / sigma * _BINS_PER_SIGMA) + 1, _MOST_BINS)
    width = (high - low) / (bins - 1)
    histogram = [_histogram(*_bins(values, low, width, bins), region, bins) for region in (inside, outside)]
    reach = min(math.ceil(4.0 * sigma / width), (bins - 1) // 2)
    at = np.arange(-reach, reach + 1) * width
    kernel = np.exp(-0.5 * (at / sigma) ** 2)
    kernel /= kernel.sum()
    mass = np.maximum(np.sum(histogram, axis=1, keepdims=True), 1e-6)
    smooth = np.stack([np.convolve(row, kernel, mode="same") for row in histogram])
    return low, width, smooth / (mass * width)


def _bins(values: Float32, low: float, width: float, bins: int) -> tuple[Int, Float]:
    """The bin below each value (H, W), and how far it is on the way to the next, 0 … 1."""
    at = (values.astype(float) - low) / width
    first = np.minimum(at.astype(np.int32), bins - 2)
    return first, at - first


def _histogram(first: Int, far: Float, weight: Float32, bins: int) -> Float:
    """(bins,) weights (H, W) of pixels, each split between the two bins nearest to its value."""
    both, shares = np.stack([first, first + 1], axis=-1), np.stack([(1.0 - far) * weight, far * weight], axis=-1)
    return np.bincount(both.ravel(), shares.ravel(), bins)
