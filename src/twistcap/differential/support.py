"""Support maps: which pixels of the projected body move as the body does (EM, Bregler and Malik 1998, section 2.4).

Each pixel belongs to the body, moving as its segment does, to the layer behind, which stands still or moves as a whole,
or to neither. The maps are the posterior of the first: prior from the projected shape, likelihoods from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twistcap._typing import Float, Float32, Int

_FLOOR = 0.008  # brightness; least robust scale: sensor noise and sampling
_CEILING = 0.15
_NEITHER = 0.10  # prior of pixels that move neither way; their residuals are spread evenly over [-1, 1]


@dataclass(frozen=True)
class Neighbourhood:
    """Where the points of a view lie on its pixels, so that evidence can be shared by neighbours.

    Attributes:
        rows, columns: (N,) pixels.
        size: (height, width).
        width: px, standard deviation of the sharing.
    """

    rows: Int
    columns: Int
    size: tuple[int, int]
    width: float = 1.5

    def mean(self, values: Float) -> Float:
        """(N,) weighted mean about each point of values (N,) at all points; NaN takes no part."""
        known = np.isfinite(values)
        total, count = self._image(np.where(known, values, 0.0)), self._image(known.astype(float))
        return (total / np.maximum(count, 1e-6))[self.rows, self.columns].astype(np.float64)

    def _image(self, values: Float) -> Float32:
        flat = np.bincount(self.rows * self.size[1] + self.columns, values, self.size[0] * self.size[1])
        return cv2.GaussianBlur(flat.reshape(self.size).astype(np.float32), (0, 0), self.width)


def robust_scale(residual: Float, part: Int, parts: int, weight: Float) -> Float:
    """(S,) scale of the residuals of each part: 1.48 times the weighted median of their size, within sane bounds."""
    overall = _scale_of(np.abs(residual), weight)
    out = np.full(parts, overall)
    for s in np.unique(part):
        own = part == s
        if np.count_nonzero(own) >= 20:
            out[s] = _scale_of(np.abs(residual[own]), weight[own])
    return out


def _scale_of(size: Float, weight: Float) -> float:
    known = np.isfinite(size) & (weight > 0)
    if not known.any():
        return _CEILING
    order = np.argsort(size[known])
    heaped = np.cumsum(weight[known][order])
    median = size[known][order][np.searchsorted(heaped, 0.5 * heaped[-1])]
    return float(np.clip(1.48 * median, _FLOOR, _CEILING))


def posterior(
    residual: Float, behind: Float, prior: Float, sigma: Float, sigma_behind: float, near: Neighbourhood
) -> Float:
    """(N,) probability that each pixel moves as the body does.

    Args:
        residual: (N,) brightness differences under the body's motion, NaN for unknown (probability 0).
        behind: (N,) the same under the motion of the layer behind; NaN where that is unknown.
        prior: (N,) from the projected shape.
        sigma: (N,) robust scale of each pixel's segment.
        sigma_behind: that of the layer behind.
        near: neighbours share their evidence: squares are averaged.
    """
    body = prior * _normal(near.mean(residual**2), sigma)
    back = (1.0 - prior) * np.where(np.isfinite(behind), _normal(near.mean(behind**2), sigma_behind), 0.0)
    neither = _NEITHER * 0.5
    return np.where(np.isfinite(residual), body / (body + back + neither), 0.0)


def _normal(square: Float, sigma: Float | float) -> Float:
    return np.exp(-0.5 * square / np.square(sigma)) / (np.sqrt(2 * np.pi) * np.asarray(sigma))
