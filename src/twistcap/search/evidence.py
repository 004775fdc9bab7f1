"""The absolute evidence of a pose: what its pixels say for it, under the parts' colours and a learned background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import AnyArray, Float, Float32, Int
from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera
from twistcap.render import render
from twistcap.search.backdrop import FLOOR, Background, Palette

_UNLIKE = -2.5
"""Log density, up to the constant of Gaussians, that any colour has: one in fifty is like nothing that is known. So
what is like neither body nor background speaks for neither."""


@dataclass(frozen=True)
class EvidenceView:
    """One camera's small image as evidence.

    Attributes:
        index: of the camera in the rig.
        camera: of the small image.
        maps: (S, h, w) nats by which each pixel speaks for each part and against the background.
        nearest: m; a body that is nearer to the camera counts as from there. It covers more pixels, of which none knows
            more than those of a small picture, and in noise it would outweigh all other cameras.
    """

    index: int
    camera: Camera
    maps: Float32
    nearest: float = 0.0

    @cached_property
    def any_part(self) -> Float32:
        """(1, h, w) how each pixel and those about it speak for any part at all."""
        return np.asarray(cv2.blur(self.maps.max(axis=0), (5, 5)), np.float32)[None]

    def by_part(self, posed: Posed) -> Float:
        """(2, S) nats for each part of a body, and the number of its pixels."""
        return self.share(posed.pose) * np.array(covered_evidence(self.maps, render(posed, self.camera).part))

    def share(self, pose: Pose) -> float:
        """What its pixels count for a body at a pose, 0 to 1."""
        return min(1.0, (depth_of(self.camera, pose) / self.nearest) ** 2) if self.nearest > 0.0 else 1.0


def depth_of(camera: Camera, pose: Pose) -> float:
    """How far a body's root is before a camera, m; 0 behind it."""
    return max(float(camera.T_cam_world[2] @ pose.root[:, 3]), 0.0)


@dataclass(frozen=True)
class Evidence:
    """All cameras together: the evidence of whole poses."""

    body: Body
    views: Sequence[EvidenceView]

    def by_part(self, pose: Pose | Posed) -> tuple[Float, Float]:
        """(cameras, S) nats for each part in each camera, and the number of its pixels."""
        posed = pose if isinstance(pose, Posed) else Posed(self.body, pose)
        found = np.array([view.by_part(posed) for view in self.views]).reshape(-1, 2, len(self.body.segment_names))
        return found[:, 0], found[:, 1]

    def of(self, pose: Pose) -> float:
        """Nats for a body at a pose; none at all has 0. A camera that contradicts has no less."""
        posed = Posed(self.body, pose)
        return sum(max(float(view.by_part(posed)[0].sum()), 0.0) for view in self.views)

    def no_nearer(self, pose: Pose) -> Evidence:
        """The same where a body counts no more than from half as far away as it is at a pose."""
        return replace(self, views=[replace(v, nearest=0.5 * depth_of(v.camera, pose)) for v in self.views])


@njit(cache=True, nogil=True)
def _gaussians(colours: Float) -> tuple[Float, Float, Float]:
    """Mean and inverse variance (S, C) of each part's colours (S, 1 + 2C), and half their log determinant (S,)."""
    S, C = len(colours), colours.shape[1] // 2
    means, inverse, spread = np.empty((S, C)), np.empty((S, C)), np.zeros(S)
    for s in range(S):
        for k in range(C):
            mean = colours[s, 1 + k]
            variance = max(colours[s, 1 + C + k] - mean * mean, 0.0) + FLOOR
            means[s, k], inverse[s, k] = mean, 1.0 / variance
            spread[s] += 0.5 * np.log(variance)
    return means, inverse, spread


@njit(cache=True, nogil=True, inline="always")
def _nats_in_front(values: Float32, s: int, gaussians: tuple[Float, Float, Float]) -> float:
    """Log density, up to a constant, of a pixel (C,) under a part's colours."""
    means, inverse, spread = gaussians
    distance = 0.0
    for k in range(means.shape[1]):
        distance += (values[k] - means[s, k]) ** 2 * inverse[s, k]
    return max(-0.5 * distance - spread[s], _UNLIKE)


@njit(cache=True, nogil=True, inline="always")
def _distance_behind(values: Float32, mean: Float32, inverse: Float32) -> float:
    """Squared distance of a pixel (C,) to what is behind, in its variances."""
    distance = 0.0
    for k in range(len(mean)):
        distance += (values[k] - mean[k]) ** 2 * inverse[k]
    return distance


@njit(cache=True, nogil=True, inline="always")
def _nats_of_palette(values: Float32, palette: Palette) -> float:
    """Log density, up to a constant, of a pixel (C,) under weights (K,), means and variances (K, C) of colours."""
    shares, means, variances = palette
    total = 1e-12
    for j in range(len(shares)):
        e = 0.0
        for k in range(means.shape[1]):
            e -= 0.5 * (values[k] - means[j, k]) ** 2 / variances[j, k] + 0.5 * np.log(variances[j, k])
        total += shares[j] * np.exp(e)
    return max(np.log(total), _UNLIKE)


@njit(cache=True, nogil=True)
def _nats_behind(features: Float32, background: Background, palette: Palette) -> Float32:
    """(h, w) log density, up to a constant, of each pixel (h, w, C) under the background."""
    mean, inverse, spread, known = background
    out = np.empty(known.shape, np.float32)
    for r in range(known.shape[0]):
        for c in range(known.shape[1]):
            if known[r, c]:
                distance = _distance_behind(features[r, c], mean[r, c], inverse[r, c])
                out[r, c] = max(-0.5 * distance - spread[r, c], _UNLIKE)
            else:
                out[r, c] = _nats_of_palette(features[r, c], palette)
    return out


@njit(cache=True, nogil=True)
def evidence_maps(features: Float32, background: Background, palette: Palette, colours: Float, clip: float) -> Float32:
    """(S, h, w) log-likelihood ratio, part over background, of each pixel, times the confidence in the part's colours.

    Whole rows at once, in single precision: a processor takes several pixels in one step.

    Args:
        features: (h, w, C).
        background: what is known of each pixel.
        palette: weights (K,), means and variances (K, C) of the background's colours, for all other pixels.
        colours: (S, 1 + 2C) confidence, mean and mean square of each part.
        clip: greatest contribution of one pixel, nats.
    """
    height, width, C = features.shape
    behind, (means, inverse, spread) = _nats_behind(features, background, palette), _gaussians(colours)
    planes = np.empty((C, height, width), np.float32)
    for k in range(C):
        planes[k] = features[:, :, k]
    out, front = np.empty((len(colours), height, width), np.float32), np.empty(width, np.float32)
    unlike, most, least = np.float32(_UNLIKE), np.float32(clip), np.float32(-clip)
    for s in range(len(colours)):
        confidence = np.float32(colours[s, 0])
        for r in range(height):
            front[:] = -spread[s]
            for k in range(C):
                mean, weight = np.float32(means[s, k]), np.float32(-0.5 * inverse[s, k])
                for c in range(width):
                    front[c] += weight * (planes[k, r, c] - mean) ** 2
            for c in range(width):
                ratio = (front[c] if front[c] > unlike else unlike) - behind[r, c]
                ratio = ratio if ratio < most else most
                out[s, r, c] = confidence * (ratio if ratio > least else least)
    return out


@njit(cache=True, nogil=True)
def sampled_evidence(
    features: Float32, part: Int, grid: tuple[int, int, float, int], background: Background,
    palette: Palette, colours: Float, clip: float, beside: bool = True,
) -> tuple[Float, Float]:  # fmt: skip
    """(3, S) evidence of each part where it covers the image, number of pixels, and evidence where nothing covers it;
    and (2,) pixels off the body that fit the background, and how many there are. Off the body only pixels count whose
    background is known; none at all without `beside`.

    Args:
        features: (H, W, ≥ C) of a crop, of which every `stride`-th pixel is looked at.
        part: (H, W) segment at each pixel, or -1.
        grid: (x, y) of the crop in the whole image, small pixels in a pixel, and the stride.
        background: of the small image.
        palette: as `evidence_maps` takes it.
        colours: (S, ≥ 1 + 2C) as `evidence_maps` takes them.
        clip: greatest contribution of one pixel, nats.
    """
    mean, inverse, spread, known = background
    x0, y0, factor, stride = grid
    height, width = known.shape
    parts = _gaussians(colours)
    out, fits = np.zeros((3, len(colours))), np.zeros(2)
    for r in range(stride // 2, part.shape[0], stride):
        for c in range(stride // 2, part.shape[1], stride):
            i, j = int((r + y0 + 0.5) * factor), int((c + x0 + 0.5) * factor)
            values, s = features[r, c], part[r, c]
            if i >= height or j >= width or not (s >= 0 or (beside and known[i, j])):
                continue
            distance = 0.0
            if known[i, j]:
                distance = _distance_behind(values, mean[i, j], inverse[i, j])
                behind = max(-0.5 * distance - spread[i, j], _UNLIKE)
            else:
                behind = _nats_of_palette(values, palette)
            if s >= 0:
                ratio = _nats_in_front(values, s, parts) - behind
                out[0, s] += colours[s, 0] * min(max(ratio, -clip), clip)
                out[1, s] += colours[s, 0]
                continue
            fits[1] += 1.0
            if distance < 4.0 * mean.shape[2]:
                fits[0] += 1.0
                continue
            most, which = 0.0, -1
            for t in range(len(colours)):
                ratio = _nats_in_front(values, t, parts) - behind
                ratio = colours[t, 0] * min(ratio, clip)
                if ratio > most:
                    most, which = ratio, t
            if which >= 0:
                out[2, which] += most
    return out, fits


@njit(cache=True, nogil=True)
def covered_evidence(maps: Float32, part: Int) -> tuple[Float, Float]:
    """(S,) sum of the evidence (S, h, w) over the pixels that show each part, and their number."""
    total, count = np.zeros(len(maps)), np.zeros(len(maps))
    for r in range(part.shape[0]):
        for c in range(part.shape[1]):
            s = part[r, c]
            if s >= 0:
                total[s] += maps[s, r, c]
                count[s] += 1.0
    return total, count


def covered_evidence_reference(maps: Float32, part: Int) -> tuple[Float, Float]:
    """Readable twin of `covered_evidence`."""
    shown = part == np.arange(len(maps))[:, None, None]
    return np.where(shown, maps, 0.0).sum(axis=(1, 2)), shown.sum(axis=(1, 2)).astype(float)


def evidence_maps_reference(
    features: Float32, background: Background, palette: Palette, colours: Float,
    clip: float,
) -> Float:  # fmt: skip
    """Readable twin of `evidence_maps`."""
    mean, inverse, _, known = background
    behind = np.where(known, _log_density(features, mean, 1.0 / inverse), _palette_density(features, palette))
    front = np.stack([_log_density(features, *_moments_of(c)) for c in colours])
    return colours[:, 0, None, None] * np.clip(front - behind, -clip, clip)


def sampled_evidence_reference(
    features: Float32, part: Int, grid: tuple[int, int, float, int], background: Background,
    palette: Palette, colours: Float, clip: float, beside: bool = True,
) -> tuple[Float, Float]:  # fmt: skip
    """Readable twin of `sampled_evidence`."""
    mean, inverse, _, known = background
    variance = 1.0 / inverse
    x0, y0, factor, stride = grid
    out, fits = np.zeros((3, len(colours))), np.zeros(2)
    for r, c in np.ndindex(*part.shape):
        i, j = int((r + y0 + 0.5) * factor), int((c + x0 + 0.5) * factor)
        sampled = r % stride == stride // 2 and c % stride == stride // 2
        values, s = features[r, c].astype(float), part[r, c]
        if not sampled or i >= known.shape[0] or j >= known.shape[1] or not (s >= 0 or (beside and known[i, j])):
            continue
        behind = _log_density(values, mean[i, j], variance[i, j]) if known[i, j] else _palette_density(values, palette)
        ratios = np.array([_log_density(values, *_moments_of(k)) for k in colours])
        ratios = colours[:, 0] * np.clip(ratios - behind, -clip, clip)
        fitting = _distance(values, mean[i, j], variance[i, j]) < 4.0 * len(values)
        if s >= 0:
            out[:2, s] += ratios[s], colours[s, 0]
        else:
            fits += np.array([float(fitting), 1.0])
            if not fitting and ratios.max() > 0.0:
                out[2, ratios.argmax()] += ratios.max()
    return out, fits


def _distance(values: AnyArray, mean: AnyArray, variance: AnyArray) -> Float:
    return ((values - mean) ** 2 / variance).sum(axis=-1)


def _log_density(values: AnyArray, mean: AnyArray, variance: AnyArray) -> Float:
    return np.maximum(-0.5 * _distance(values, mean, variance) - 0.5 * np.log(variance).sum(axis=-1), _UNLIKE)


def _palette_density(values: AnyArray, palette: Palette) -> Float:
    shares, means, variances = palette
    heights = shares / np.sqrt(variances.prod(axis=1))
    rest = np.exp(-0.5 * _distance(values[..., None, :], means, variances)) @ heights
    return np.maximum(np.log(1e-12 + rest), _UNLIKE)


def _moments_of(colours: Float) -> tuple[Float, Float]:
    """Mean and variance (C,) of a part's colours (1 + 2C,)."""
    C = len(colours) // 2
    return colours[1 : 1 + C], np.maximum(colours[1 + C :] - colours[1 : 1 + C] ** 2, 0.0) + FLOOR
