"""What each camera sees where the body is not: the mean and the spread of every pixel, in small images.

With it the evidence of a pose is absolute: it needs no other pose to be compared with, as a background that is gathered
about a hypothesis does, and no body at all has evidence 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Bool, Float, Float32
from twistcap.camera import Camera
from twistcap.features import Channels, feature_channels

FLOOR = 4e-4
"""Least variance of a pixel, brightness²."""
PX_PER_M = 45.0
"""Of the small images, where the body is."""
_MOST = 400  # px across, of a small image
_MEMORY = 30.0  # lessons that are remembered
_BERTH = 0.08  # m about the body within which nothing is learned
_SHOWN = 0.25  # of its pixels that fit, below which a picture shows another background
_PALETTE = 8  # colours by which pixels are described that were never seen without the body


Palette = tuple[Float, Float, Float]
Background = tuple[Float32, Float32, Float32, Bool]
"""(h, w, C) mean and inverse variance of each pixel, (h, w) half the log determinant, and where they are known."""


@njit(cache=True, nogil=True)
def background_of(mean: Float32, variance: Float32, known: Bool) -> Background:
    """A background by mean and variance (h, w, C) of each pixel, where they are known (h, w)."""
    inverse, spread = np.empty_like(variance), np.empty(known.shape, np.float32)
    for r in range(known.shape[0]):
        for c in range(known.shape[1]):
            product = 1.0
            for k in range(variance.shape[2]):
                inverse[r, c, k] = 1.0 / variance[r, c, k]
                product *= variance[r, c, k]
            spread[r, c] = 0.5 * np.log(product)
    return mean, inverse, spread, known


def background_of_reference(mean: Float32, variance: Float32, known: Bool) -> Background:
    """Readable twin of `background_of`."""
    return mean, 1.0 / variance, 0.5 * np.log(variance).sum(axis=2), known


@dataclass(frozen=True)
class Backdrop:
    """The background of one camera.

    Attributes:
        sums: (h, w, 1 + 2C) number, sum and sum of squares of each pixel's values; (0, 0, 1) before the first lesson.
        palette: weights (K,), means and variances (K, C) of the colours that occur in it, gathered anew as often as the
            lessons have doubled.
        lessons: taken so far.
    """

    sums: Float32
    palette: Palette = field(default_factory=lambda: (np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))))
    lessons: int = 0

    @staticmethod
    def blank() -> Backdrop:
        """Nothing learnt yet."""
        return Backdrop(np.zeros((0, 0, 1), np.float32))

    @property
    def size(self) -> tuple[int, int]:
        """(w, h) of the small images, px."""
        return self.sums.shape[1], self.sums.shape[0]

    def channels_of(self, colours: Float) -> Float:
        """Of parts' colours (S, 1 + 2K) those of its own C channels (S, 1 + 2C): small pictures have no texture."""
        C, K = self.sums.shape[2] // 2, colours.shape[1] // 2
        return colours if C == K else colours[:, [0, *range(1, 1 + C), *range(1 + K, 1 + K + C)]]

    @cached_property
    def known(self) -> Bool:
        """(h, w) pixels that have been seen without the body."""
        return np.asarray(self.sums[..., 0] > 0.5, np.bool_)

    @cached_property
    def moments(self) -> tuple[Float32, Float32]:
        """(h, w, C) mean and variance of each pixel; what varies from pixel to pixel is variance as well."""
        mean, variance = over_time(self.sums)
        near = [np.asarray(cv2.blur(a, (3, 3)), np.float32).reshape(a.shape) for a in (mean, mean * mean)]
        return mean, variance + np.maximum(near[1] - near[0] * near[0], 0.0) + np.float32(FLOOR)

    @cached_property
    def background(self) -> Background:
        """What is known of each pixel."""
        return background_of(*self.moments, self.known)

    def is_in(self, features: Float32) -> bool:
        """Whether a small picture (h, w, C) shows it, be it noisy; most of that of another camera is not in it."""
        return self.shown(features) >= _SHOWN

    def shown(self, features: Float32) -> float:
        """Fraction of the pixels that are known which fit a small picture (h, w, C)."""
        mean, inverse, _, known = self.background
        fitting = np.sum((features - mean) ** 2 * inverse, axis=2) < 4.0 * features.shape[2]
        return float(np.count_nonzero(fitting & known) / max(np.count_nonzero(known), 1))

    def _palette(self) -> Palette:
        step = max(1, np.count_nonzero(self.known) // 2000)
        values = np.ascontiguousarray(self.moments[0][self.known][::step])
        C, K = self.sums.shape[2] // 2, min(_PALETTE, len(values))
        if K == 0:
            return np.ones(1), np.full((1, C), 0.5), np.ones((1, C))
        cv2.setRNGSeed(0)
        stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 10, 1e-3)
        _, labels, _ = cv2.kmeans(values, K, cast("AnyArray", None), stop, 1, cv2.KMEANS_PP_CENTERS)
        members = np.eye(K)[labels.ravel().astype(np.int32)]
        n = np.maximum(members.sum(axis=0), 1.0)[:, None]
        means = members.T @ values / n
        variances = np.maximum(members.T @ (values * values) / n - means * means, 0.0)
        return n[:, 0] / n.sum(), means, variances + 4.0 * FLOOR

    def learnt(self, features: Float32, beside: Bool) -> Backdrop:
        """With the values (h, w, C) of pixels beside the body (h, w)."""
        before = self.sums
        if before.shape[:2] != features.shape[:2]:
            before = np.zeros((*features.shape[:2], 1 + 2 * features.shape[2]), np.float32)
        lessons = self.lessons + 1
        taught = Backdrop(with_lesson(before, features, beside, _MEMORY / (_MEMORY + 1.0)), self.palette, lessons)
        return replace(taught, palette=taught._palette()) if lessons & (lessons - 1) == 0 else taught


def about(body: Bool, px_per_m: float) -> Bool:
    """(h, w) pixels of a body (h, w) and so near to it that they may show it."""
    size = 2 * max(1, round(_BERTH * px_per_m)) + 1
    return np.asarray(cv2.dilate(body.astype(np.uint8), np.ones((size, size), np.uint8)) > 0, np.bool_)


@njit(cache=True, nogil=True)
def with_lesson(sums: Float32, features: Float32, off: Bool, keep: float) -> Float32:
    """Sums (h, w, 1 + 2C) of which a fraction is kept and to which values (h, w, C) come, where `off` (h, w)."""
    out, C, kept = sums.copy(), features.shape[2], np.float32(keep)
    for r in range(off.shape[0]):
        for c in range(off.shape[1]):
            if off[r, c]:
                out[r, c, 0] = kept * sums[r, c, 0] + np.float32(1.0)
                for k in range(C):
                    value = features[r, c, k]
                    out[r, c, 1 + k] = kept * sums[r, c, 1 + k] + value
                    out[r, c, 1 + C + k] = kept * sums[r, c, 1 + C + k] + value * value
    return out


def with_lesson_reference(sums: Float32, features: Float32, off: Bool, keep: float) -> Float32:
    """Readable twin of `with_lesson`."""
    values = np.concatenate([np.ones_like(features[..., :1]), features, features * features], axis=2)
    return np.where(off[..., None], np.float32(keep) * sums + values, sums)


@njit(cache=True, nogil=True)
def over_time(sums: Float32) -> tuple[Float32, Float32]:
    """Mean and variance (h, w, C) of each pixel, from its sums (h, w, 1 + 2C)."""
    height, width, C = sums.shape[0], sums.shape[1], sums.shape[2] // 2
    mean, variance = np.empty((height, width, C), np.float32), np.empty((height, width, C), np.float32)
    for r in range(height):
        for c in range(width):
            share = np.float32(1.0) / max(sums[r, c, 0], np.float32(1e-6))
            for k in range(C):
                m = sums[r, c, 1 + k] * share
                mean[r, c, k] = m
                variance[r, c, k] = max(sums[r, c, 1 + C + k] * share - m * m, np.float32(0.0))
    return mean, variance


def over_time_reference(sums: Float32) -> tuple[Float32, Float32]:
    """Readable twin of `over_time`."""
    mean, square = np.split(sums[..., 1:] / np.maximum(sums[..., :1], 1e-6), 2, axis=2)
    return np.asarray(mean, np.float32), np.asarray(np.maximum(square - mean * mean, 0.0), np.float32)


def small_camera(camera: Camera, backdrop: Backdrop, place: Float) -> Camera:
    """The camera of the backdrop's small images; before the first lesson, of those in which a body at a place is seen
    at the usual resolution.
    """
    if backdrop.size != (0, 0):
        return camera.resized(backdrop.size)
    depth = max(float(camera.T_cam_world[2, :3] @ place + camera.T_cam_world[2, 3]), 0.1)
    return camera.scaled(min(1.0, PX_PER_M * depth / camera.K[0, 0], _MOST / max(camera.size)))


def colours_alone(channels: Channels) -> Channels:
    """The channels without texture, which depends on how large an image is."""
    return "lab" if channels.startswith("lab") else "grey"


def small_features(image: AnyArray, size: tuple[int, int], channels: Channels) -> Float32:
    """(h, w, C) colours of a whole image, made small first."""
    return feature_channels(cv2.resize(image, size, interpolation=cv2.INTER_AREA), colours_alone(channels))
