"""Support maps: which pixels of the projected body move as the body does (EM, Bregler and Malik 1998, section 2.4).

Each pixel belongs to the body, moving as its segment does, to the layer behind, which stands still or moves as a whole,
or to neither. The maps are the posterior of the first: prior from the projected shape, likelihoods from the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int

_FLOOR = 0.008  # brightness; least robust scale: sensor noise and sampling
_CEILING = 0.15
_FEWEST = 20  # residuals that a part must have; one with fewer has the scale of all together
_WIDTH = 1.5  # px, standard deviation with which neighbours share their evidence
_NEITHER = 0.05  # prior of pixels that move neither way times their density; residuals spread over [-1, 1]


@dataclass(frozen=True)
class Neighbourhood:
    """The pixels (N,) of the points of a view, of `size` (height, width), so that neighbours can share evidence."""

    rows: Int
    columns: Int
    size: tuple[int, int]

    @staticmethod
    def about(places: Float) -> Neighbourhood:
        """That of places (N, 2), (x, y); those off the image may be anywhere near the others."""
        pixels = np.rint(places[:, ::-1]).T.astype(np.int32)
        rows, columns = pixels - (pixels.min(axis=1, keepdims=True) if pixels.size else 0)
        return Neighbourhood(rows, columns, (int(rows.max(initial=0)) + 1, int(columns.max(initial=0)) + 1))

    def mean(self, values: Float) -> Float:
        """(N,) weighted mean about each point of values (N,) at all points; NaN takes no part."""
        known = np.isfinite(values)
        total, count = self._image(np.where(known, values, 0.0)), self._image(known.astype(float))
        return (total / np.maximum(count, 1e-6))[self.rows, self.columns].astype(np.float64)

    def _image(self, values: Float) -> Float32:
        flat = np.bincount(self.rows * self.size[1] + self.columns, values, self.size[0] * self.size[1])
        return np.asarray(cv2.GaussianBlur(flat.reshape(self.size).astype(np.float32), (0, 0), _WIDTH), np.float32)


@njit(cache=True, nogil=True)
def robust_scale(residual: Float, part: Int, parts: int, weight: Float) -> Float:
    """(S,) scale of the residuals of each part: 1.48 times the weighted median of their size, within sane bounds.
    Residuals (N,) are of brightness, NaN for unknown; part and weight are (N,), S = `parts`."""
    size, count = np.abs(residual), np.bincount(part, minlength=parts)
    out = np.full(parts, _scale_of(size, weight))
    for s in range(parts):
        if count[s] >= _FEWEST:
            own = part == s
            out[s] = _scale_of(size[own], weight[own])
    return out


def robust_scale_reference(residual: Float, part: Int, parts: int, weight: Float) -> Float:
    """Readable twin of `robust_scale`."""

    def scale(which: Bool) -> float:
        known = which & np.isfinite(residual) & (weight > 0.0)
        order = np.argsort(np.abs(residual[known]))
        heaped = np.cumsum(weight[known][order])
        if not known.any():
            return _CEILING
        median = np.abs(residual[known])[order][heaped >= 0.5 * heaped[-1]][0]
        return float(np.clip(1.48 * median, _FLOOR, _CEILING))

    own = [part == s for s in range(parts)]
    return np.array([scale(which if np.count_nonzero(which) >= _FEWEST else np.ones_like(which)) for which in own])


@njit(cache=True, nogil=True)
def _scale_of(size: Float, weight: Float) -> float:
    known = np.isfinite(size) & (weight > 0)
    if not known.any():
        return _CEILING
    size, weight = size[known], weight[known]
    order = np.argsort(size)
    heaped = np.cumsum(weight[order])
    median = size[order][np.searchsorted(heaped, 0.5 * heaped[-1])]
    return float(min(max(1.48 * median, _FLOOR), _CEILING))


def posterior(
    residual: Float, behind: Float, prior: Float, sigma: Float, sigma_behind: Float, near: Neighbourhood
) -> Float:
    """(N,) probability that each pixel moves as the body does.

    Channels see much the same, so that their mean evidence counts as that of one; neighbours share theirs. Of
    differences under the body's motion (N, C), NaN for unknown (probability 0), those of the layer `behind` (N, C), a
    prior (N,) from the projected shape, and the scales sigma (N, C) and sigma_behind (C,).
    """
    known = np.isfinite(behind).all(axis=1)
    body = prior * _density(residual, sigma, near)
    back = (1.0 - prior) * np.where(known, _density(behind, np.broadcast_to(sigma_behind, behind.shape), near), 0.0)
    return np.where(np.isfinite(residual).all(axis=1), body / (body + back + _NEITHER), 0.0)


def _density(residual: Float, sigma: Float, near: Neighbourhood) -> Float:
    """(N,) normal density of the channels' mean square, shared by neighbours, at the mean scale."""
    square = np.minimum(near.mean(np.mean((residual / sigma) ** 2, axis=1)), 200.0)  # numbers below 1e-300 are slow
    return np.exp(-0.5 * square - np.mean(np.log(sigma), axis=1)) / np.sqrt(2 * np.pi)
