"""Parzen density estimates of whole regions, channel by channel: a histogram under a Gaussian kernel.

The density model of Kim, Fisher, Yezzi, Cetin and Willsky with which Brox, Rosenhahn and Cremers compare their local
one ("Contours, Optic Flow, and Prior Knowledge", Fig. 11.4).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32
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

    Raises:
        InputError: if sigma or floor is not positive and finite.
    """
    if not (0.0 < sigma < math.inf and 0.0 < floor < math.inf):
        raise InputError(f"parzen: sigma is {sigma} and floor {floor}; both must be positive and finite.")
    out = np.zeros(inside.shape, dtype=np.float32)
    for j in range(channels.shape[2]):
        values = np.ascontiguousarray(channels[..., j])
        start, width, density = parzen_densities(values, inside, outside, sigma)
        table = np.log((density[0] + floor) / (density[1] + floor)).astype(np.float32)
        add_interpolated(values, start, width, table, out)
    return out


def parzen_densities(values: Float32, inside: Float32, outside: Float32, sigma: float) -> tuple[float, float, Float]:
    """First place, spacing and densities (2, B) of the values (H, W) of both regions; 0 where a region is empty."""
    low, high = float(values.min()) - 4.0 * sigma, float(values.max()) + 4.0 * sigma
    bins = min(math.ceil((high - low) / sigma * _BINS_PER_SIGMA) + 1, _MOST_BINS)
    width = (high - low) / (bins - 1)
    histogram = histograms(values, inside, outside, low, width, bins)
    reach = min(math.ceil(4.0 * sigma / width), (bins - 1) // 2)
    at = np.arange(-reach, reach + 1) * width
    kernel = np.exp(-0.5 * (at / sigma) ** 2)
    kernel /= kernel.sum()
    mass = np.maximum(histogram.sum(axis=1, keepdims=True), 1e-6)
    smooth = np.stack([np.convolve(row, kernel, mode="same") for row in histogram])
    return low, width, smooth / (mass * width)


@njit(cache=True, nogil=True)
def histograms(values: Float32, inside: Float32, outside: Float32, low: float, width: float, bins: int) -> Float:
    """(2, bins) weights of both regions, each pixel's split between the two bins nearest to its value."""
    out = np.zeros((2, bins))
    flat, one, other = values.ravel(), inside.ravel(), outside.ravel()
    for n in range(len(flat)):
        at = (flat[n] - low) / width
        i = min(int(at), bins - 2)
        t = at - i
        out[0, i] += (1.0 - t) * one[n]
        out[0, i + 1] += t * one[n]
        out[1, i] += (1.0 - t) * other[n]
        out[1, i + 1] += t * other[n]
    return out


def histograms_reference(
    values: Float32, inside: Float32, outside: Float32, low: float, width: float, bins: int
) -> Float:
    """Readable twin of `histograms`."""
    at = (values.ravel().astype(float) - low) / width
    first = np.minimum(at.astype(int), bins - 2)
    out, far = np.zeros((2, bins)), at - first
    for row, weight in zip(out, (inside.ravel(), outside.ravel()), strict=True):
        np.add.at(row, first, (1.0 - far) * weight)
        np.add.at(row, first + 1, far * weight)
    return out


@njit(cache=True, nogil=True)
def add_interpolated(values: Float32, low: float, width: float, table: Float32, out: Float32) -> None:
    """Add to each pixel of `out` (H, W) the interpolated table at its value."""
    flat, sums = values.ravel(), out.ravel()
    for n in range(len(flat)):
        at = (flat[n] - low) / width
        i = min(int(at), len(table) - 2)
        t = at - i
        sums[n] += (1.0 - t) * table[i] + t * table[i + 1]


def add_interpolated_reference(values: Float32, low: float, width: float, table: Float32, out: Float32) -> None:
    """Readable twin of `add_interpolated`."""
    out += np.interp(values, low + width * np.arange(len(table)), table).astype(np.float32)
