"""Which of two labellings explains an image better: only the pixels that change hands between them are asked."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit

from twistcap._typing import Bool, Float, Float32, Int

_FALLBACK = 0.02  # share of a window at which the whole background weighs as much as the window's own


def background_moments(features: Float32, off: Bool, radius: int) -> Float32:
    """(H, W, 2C) mean and mean square of the background about each pixel.

    Args:
        features: (H, W, C).
        off: (H, W) what is background under both labellings: what only one calls so must not speak for it.
        radius: px about a pixel from which its background is gathered; where there is none, the whole one stands in.
    """
    mass = off.astype(np.float32)[..., None]
    sums = np.concatenate([mass, mass * features, mass * features**2], axis=2)
    size = (2 * radius + 1, 2 * radius + 1)
    window = np.asarray(cv2.boxFilter(sums, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)
    whole = sums.mean(axis=(0, 1))
    window += _FALLBACK * whole / max(float(whole[0]), 1e-6)
    return window[..., 1:] / window[..., :1]


@njit(cache=True, nogil=True)
def label_evidence(
    features: Float32, background: Float32, colours: Float, part: Int, other: Int, floor: float, clip: float
) -> float:
    """Log-likelihood (nats) of labels `other` (H, W) over labels `part`; -1 is background.

    Args:
        features: (H, W, C).
        background: (H, W, 2C) as `background_moments` gives it.
        colours: (S, 1 + 2C) confidence, mean and mean square of each part; parts of confidence 0 are not asked.
        floor: least variance.
        clip: most that one pixel can say, nats.
    """
    C, total = features.shape[2], 0.0
    for r in range(part.shape[0]):
        for c in range(part.shape[1]):
            before, after = part[r, c], other[r, c]
            if before == after:
                continue
            if (before >= 0 and colours[before, 0] == 0.0) or (after >= 0 and colours[after, 0] == 0.0):
                continue
            here = background[r, c]
            old = _log_density(features[r, c], colours[before, 1:], floor) if before >= 0 else _log_density(
                features[r, c], here, floor
            )  # fmt: skip
            new = _log_density(features[r, c], colours[after, 1:], floor) if after >= 0 else _log_density(
                features[r, c], here, floor
            )  # fmt: skip
            total += min(max(new - old, -clip), clip)
    return total


@njit(cache=True, nogil=True, inline="always")
def _log_density(values: Float32, moments: Float, floor: float) -> float:
    """Log density of a pixel's C channels under independent Gaussians of mean and mean square (2C,), less a constant."""
    C, out = len(values), 0.0
    for k in range(C):
        variance = max(moments[C + k] - moments[k] ** 2, 0.0) + floor
        out -= 0.5 * ((values[k] - moments[k]) ** 2 / variance + np.log(variance))
    return out
