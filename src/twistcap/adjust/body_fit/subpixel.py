"""Place of an edge to a small fraction of a pixel, from the areas on its two sides.

Along a line across an edge, the integral of the inside's coverage is the length inside. A blur that is alike on both
sides preserves it (moments: Tabatabai and Mitchell, DOI 10.1109/TPAMI.1984.4767502). It takes the colours of both
sides nearby.
"""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Float

_STEP = 0.25  # px between samples
_HALF, _FAR = 1.75, 4.0  # px: half the window in which the edge lies; where the sides' colours end


def refined(image: AnyArray, pixels: Float, normals: Float, distance: Float, rounds: int = 2) -> tuple[Float, Float]:
    """Distances (N,) px along the normals, and the contrast (N,) there in standard deviations of the colours.

    Args:
        image: (H, W[, 3]), nearly linear in light.
        pixels, normals: (N, 2) points and unit directions, from the inside outward.
        distance: (N,) px outward to the edge, known to about a pixel.
    """
    values = np.ascontiguousarray(image, dtype=np.float32)
    contrast = np.zeros(len(pixels))
    start = distance
    for _ in range(rounds if len(pixels) else 0):
        shift, contrast = _shift(values, pixels + distance[:, None] * normals, normals)
        distance = start + np.clip(distance + shift - start, -_HALF, _HALF)
    return distance, contrast


def _shift(image: AnyArray, pixels: Float, normals: Float) -> tuple[Float, Float]:
    at = np.arange(-_FAR, _FAR + _STEP / 2, _STEP)
    where = (pixels[:, None] + at[:, None] * normals[:, None]).astype(np.float32)
    line = cv2.remap(image, where[..., 0], where[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    line = line.reshape(len(pixels), len(at), -1).astype(np.float64)
    inside, outside = line[:, at < -_HALF], line[:, at > _HALF]
    inner, outer = inside.mean(axis=1), outside.mean(axis=1)
    apart = inner - outer
    size = np.maximum(np.sum(apart**2, axis=1), 1e-12)
    cover = np.einsum("nsc,nc->ns", line[:, np.abs(at) <= _HALF] - outer[:, None], apart) / size[:, None]
    spread = np.sqrt(0.5 * (inside.var(axis=1) + outside.var(axis=1)).sum(axis=1))
    weight = np.full(cover.shape[1], _STEP)
    weight[[0, -1]] *= 0.5  # trapezoids
    return np.clip(cover, -0.5, 1.5) @ weight - _HALF, np.sqrt(size) / np.maximum(spread, 1e-3 * 255)
