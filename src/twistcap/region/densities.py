"""Region densities on the pixel grid: log-likelihood ratio of each pixel, inside to outside.

Channels are taken as independent (Brox, Rosenhahn and Cremers, eq. 11.8); variances are those of the squared
deviations, where the paper omits the square. Histograms under a kernel are the model with which they compare (11.4).
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32
from twistcap.errors import InputError

_BINS_PER_SIGMA = 4.0
_MOST_BINS = 4096


@njit(cache=True, nogil=True)
def heaviside(phi: Float32, width: float) -> Float32:
    """Smooth step: the error function of `phi` px, whose derivative is a Gaussian of standard deviation `width` px."""
    out = np.empty(phi.size, dtype=np.float32)
    flat = phi.ravel()
    for n in range(len(flat)):
        x = flat[n] / (math.sqrt(2.0) * width)
        out[n] = 1.0 if x > 4.0 else (0.0 if x < -4.0 else 0.5 * (1.0 + math.erf(x)))
    return out.reshape(phi.shape)


def heaviside_reference(phi: Float32, width: float) -> Float:
    """Readable twin of `heaviside`."""
    return 0.5 * (1.0 + np.vectorize(math.erf, otypes=[float])(phi / (math.sqrt(2.0) * width)))


def global_log_ratio(channels: Float32, inside: Float32, floor: float, outside: Float32 | None = None) -> Float32:
    """(H, W) Σ_j log p₁/p₂ under one Gaussian per region and channel; `outside` is by default 1 − `inside` (H, W)."""
    out = np.zeros(inside.shape, dtype=np.float32)
    outside = np.float32(1.0) - inside if outside is None else outside
    for values in np.moveaxis(channels, 2, 0):
        (mu_in, var_in), (mu_out, var_out) = (_gaussian(values, weight, floor) for weight in (inside, outside))
        difference = (values - mu_out) ** 2 / var_out - (values - mu_in) ** 2 / var_in
        out += (0.5 * (difference + np.log(var_out / var_in))).astype(np.float32)
    return out


def _gaussian(values: Float32, weight: Float32, floor: float) -> tuple[float, float]:
    """Mean and variance of weighted values (H, W)."""
    mass = float(weight.sum()) + 1e-6
    mu = float((weight * values).sum()) / mass
    return mu, float((weight * (values - mu) ** 2).sum()) / mass + floor


def blockwise_log_ratio(
    channels: Float32, inside: Float32, rho: float, floor: float, prior_mass: float, wanted: Bool | None = None,
    block: int = 2, outside: Float32 | None = None,
) -> Float32:  # fmt: skip
    """(H, W) Σ_j log p₁/p₂ under Gaussians estimated in a box of standard deviation `rho` px about each pixel.

    At the border the image is mirrored. A region's global statistics are added with the weight of `prior_mass`
    (fraction of the box). Statistics are summed over blocks of `block`² pixels, since densities vary slowly. Off
    `wanted` (H, W) the ratio is 0. `outside` (H, W) is by default the complement.
    """
    outside = np.float32(1.0) - inside if outside is None else outside
    if wanted is None:
        wanted = np.ones(inside.shape, dtype=np.bool_)
    sums = _block_sums(channels, inside, outside, block)
    size = max(3, 2 * round(rho / block * math.sqrt(3.0)) + 1)
    blocks = sums.shape[0] * sums.shape[1]
    mean = np.full(blocks, 1.0 / blocks, dtype=np.float32)  # a product is a faster mean than np.mean
    whole = (mean @ sums.reshape(blocks, -1)).reshape(sums.shape[2:])
    flat = sums.reshape(*sums.shape[:2], -1)
    box = cv2.boxFilter(flat, -1, (size, size), borderType=cv2.BORDER_REFLECT_101)
    window = np.asarray(box, dtype=np.float32).reshape(sums.shape)
    prior = (prior_mass * block**2 * whole / np.maximum(whole[:, :1], 1e-6)).astype(np.float32)
    return _ratios_of_blocks(channels, window, prior, wanted, block, floor)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _block_sums(channels: Float32, inside: Float32, outside: Float32, block: int) -> Float32:
    """(h, w, 2, 1 + 2 C) mass, values and squares of both regions, inside first, over each block."""
    height, width, C = channels.shape
    out = np.empty(((height + block - 1) // block, (width + block - 1) // block, 2, 1 + 2 * C), dtype=np.float32)
    without, within = np.zeros(1 + 2 * C, dtype=np.float32), np.zeros(1 + 2 * C, dtype=np.float32)
    for br in range(out.shape[0]):
        for bc in range(out.shape[1]):
            without[:], within[:] = np.float32(0.0), np.float32(0.0)
            for r in range(br * block, min(br * block + block, height)):
                for c in range(bc * block, min(bc * block + block, width)):
                    own, rest = inside[r, c], outside[r, c]
                    without[0] += rest
                    within[0] += own
                    for j in range(C):
                        value = channels[r, c, j]
                        square = value * value
                        without[1 + j] += rest * value
                        without[1 + C + j] += rest * square
                        within[1 + j] += own * value
                        within[1 + C + j] += own * square
            for i in range(1 + 2 * C):
                out[br, bc, 0, i], out[br, bc, 1, i] = within[i], without[i]
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "arcp"})
def _ratios_of_blocks(
    channels: Float32, window: Float32, prior: Float32, wanted: Bool, block: int, floor: float
) -> Float32:
    """(H, W) each pixel under the two Gaussians of its block's window (h, w, 2, 1 + 2 C) and the prior sums."""
    height, width, C = channels.shape
    out = np.zeros((height, width), dtype=np.float32)
    mu, within = np.empty((2, C)), np.empty((2, C))
    for br in range(window.shape[0]):
        for bc in range(window.shape[1]):
            asked = False
            for r in range(br * block, min(br * block + block, height)):
                for c in range(bc * block, min(bc * block + block, width)):
                    asked |= wanted[r, c]
            if not asked:
                continue
            spread = 1.0
            for side in range(2):
                mass = 1.0 / max(window[br, bc, side, 0] + prior[side, 0], 1e-6)  # a region may be empty
                for j in range(C):
                    mu[side, j] = (window[br, bc, side, 1 + j] + prior[side, 1 + j]) * mass
                    second = (window[br, bc, side, 1 + C + j] + prior[side, 1 + C + j]) * mass
                    within[side, j] = 1.0 / (max(second - mu[side, j] ** 2, 0.0) + floor)
            for j in range(C):
                spread *= within[0, j] / within[1, j]
            constant = math.log(spread)
            for r in range(br * block, min(br * block + block, height)):
                for c in range(bc * block, min(bc * block + block, width)):
                    ratio = constant
                    for j in range(C):
                        ratio += (channels[r, c, j] - mu[1, j]) ** 2 * within[1, j]
                        ratio -= (channels[r, c, j] - mu[0, j]) ** 2 * within[0, j]
                    out[r, c] = 0.5 * ratio
    return out


def parzen_log_ratio(channels: Float32, inside: Float32, outside: Float32, sigma: float, floor: float) -> Float32:
    """(H, W) Σ_j log (p₁ + floor)/(p₂ + floor), nats, of channels (H, W, C) under both regions' Parzen densities.

    `inside` and `outside` (H, W) are the weights of pixels in the regions, `sigma` the standard deviation of the kernel
    in units of the channels. The floor is added to the densities, so that no value is impossible.
    Raises InputError if sigma or floor is not positive and finite.
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
