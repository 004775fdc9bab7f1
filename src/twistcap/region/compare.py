"""Comparing two labellings: their overlap, and which explains an image better."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Bool, Float, Float32, Int

BLOCK = 4  # px: the background's statistics are gathered in blocks of this size
_FALLBACK = 0.02  # fraction of a window at which the whole background has the weight of the window's own


@njit(cache=True, nogil=True)
def background_moments(features: Float32, off: Bool, asked: Bool, reach: int) -> Float:
    """(H', W', 2C) mean and mean square of the background about each block of pixels of an image (H, W, C) in which any
    pixel is `asked` (H, W); 0 in the others.

    It is gathered from `reach` blocks about a block, where it is surely background: `off` (H, W), without pixels that a
    limb covers or may cover. If there is none, the whole background is used.
    """
    height, width, C = features.shape
    rows, columns = (height + BLOCK - 1) // BLOCK, (width + BLOCK - 1) // BLOCK
    sums, wanted = np.zeros((rows, columns, 1 + 2 * C)), np.zeros((rows, columns), np.bool_)
    whole = np.zeros(1 + 2 * C)
    for r in range(height):
        for c in range(width):
            if asked[r, c]:
                wanted[r // BLOCK, c // BLOCK] = True
            if not off[r, c]:
                continue
            here = sums[r // BLOCK, c // BLOCK]
            here[0] += 1.0
            for k in range(C):
                here[1 + k] += features[r, c, k]
                here[1 + C + k] += features[r, c, k] ** 2
    for r in range(rows):
        for c in range(columns):
            whole += sums[r, c]
    fallback = _FALLBACK * ((2 * reach + 1) * BLOCK) ** 2 / max(whole[0], 1.0)
    out, window = np.zeros((rows, columns, 2 * C)), np.empty(1 + 2 * C)
    for r in range(rows):
        for c in range(columns):
            if not wanted[r, c]:
                continue
            for k in range(1 + 2 * C):
                window[k] = fallback * whole[k]
            for i in range(max(r - reach, 0), min(r + reach + 1, rows)):
                for j in range(max(c - reach, 0), min(c + reach + 1, columns)):
                    for k in range(1 + 2 * C):
                        window[k] += sums[i, j, k]
            for k in range(2 * C):
                out[r, c, k] = window[1 + k] / max(window[0], 1e-9)
    return out


@njit(cache=True, nogil=True)
def label_evidence(
    features: Float32, background: Float, colours: Float, part: Int, other: Int, floor: float, clip: float
) -> float:
    """Log-likelihood (nats) of labels `other` (H, W) over labels `part` of an image (H, W, C); -1 is background.

    `background` is as `background_moments` gives it. `colours` (S, 1 + 2C) are confidence, mean and mean square of each
    part; pixels of parts of confidence 0 are ignored. `floor` is the least variance, `clip` (nats) the greatest
    contribution of one pixel.
    """
    total = 0.0
    for r in range(part.shape[0]):
        for c in range(part.shape[1]):
            before, after = part[r, c], other[r, c]
            if before == after:
                continue
            if (before >= 0 and colours[before, 0] == 0.0) or (after >= 0 and colours[after, 0] == 0.0):
                continue
            values, here = features[r, c], background[r // BLOCK, c // BLOCK]
            old = _log_density(values, colours[before, 1:] if before >= 0 else here, floor)
            new = _log_density(values, colours[after, 1:] if after >= 0 else here, floor)
            total += min(max(new - old, -clip), clip)
    return total


@njit(cache=True, nogil=True, inline="always")
def _log_density(values: Float32, moments: Float, floor: float) -> float:
    """Log density up to a constant of a pixel (C,) under independent Gaussians of mean and mean square (2C,)."""
    C, out = len(values), 0.0
    for k in range(C):
        variance = max(moments[C + k] - moments[k] ** 2, 0.0) + floor
        out -= 0.5 * ((values[k] - moments[k]) ** 2 / variance + np.log(variance))
    return out


def background_moments_reference(features: Float32, off: Bool, asked: Bool, reach: int) -> Float:
    """Readable twin of `background_moments`: window by window."""
    values = np.concatenate([np.ones((*off.shape, 1)), features, features.astype(float) ** 2], axis=2)
    values = np.where(off[..., None], values, 0.0)
    whole, fallback = values.sum(axis=(0, 1)), _FALLBACK * ((2 * reach + 1) * BLOCK) ** 2
    rows, columns = (-(-size // BLOCK) for size in off.shape)
    out = np.zeros((rows, columns, 2 * features.shape[2]))
    for r, c in np.ndindex(rows, columns):
        if not asked[r * BLOCK : (r + 1) * BLOCK, c * BLOCK : (c + 1) * BLOCK].any():
            continue
        top, left = max(r - reach, 0) * BLOCK, max(c - reach, 0) * BLOCK
        window = values[top : (r + reach + 1) * BLOCK, left : (c + reach + 1) * BLOCK].sum(axis=(0, 1))
        window = window + fallback * whole / max(whole[0], 1.0)
        out[r, c] = window[1:] / max(window[0], 1e-9)
    return out


def label_evidence_reference(
    features: Float32, background: Float, colours: Float, part: Int, other: Int, floor: float, clip: float
) -> float:
    """Readable twin of `label_evidence`."""
    C = features.shape[2]
    off = np.repeat(np.repeat(background, BLOCK, axis=0), BLOCK, axis=1)[: part.shape[0], : part.shape[1]]

    def log_density(labels: Int) -> Float:
        moments = np.where(labels[..., None] >= 0, colours[labels, 1:], off)
        variance = np.maximum(moments[..., C:] - moments[..., :C] ** 2, 0.0) + floor
        return -0.5 * np.sum((features - moments[..., :C]) ** 2 / variance + np.log(variance), axis=2)

    known = [(labels < 0) | (colours[labels, 0] > 0.0) for labels in (part, other)]
    asked = (part != other) & known[0] & known[1]
    return float(np.clip(log_density(other) - log_density(part), -clip, clip)[asked].sum())


def iou(mask: AnyArray, reference: AnyArray) -> float:
    """Intersection over union of two masks (H, W); 1 for two empty masks."""
    a, b = np.asarray(mask, bool), np.asarray(reference, bool)
    union = int(np.count_nonzero(a | b))
    return float(np.count_nonzero(a & b)) / union if union else 1.0
