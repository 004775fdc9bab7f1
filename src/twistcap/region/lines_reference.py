"""Readable twins of the kernels of `lines`."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.region.lines import EDGE, PLACES, SHARES, Lines, LineSettings, Measured, VisibleParts


def measured_lines_reference(
    image: Float32, visible: VisibleParts, lines: Lines, group: Int, colours: Float, reach: float,
    settings: LineSettings,
) -> Measured:  # fmt: skip
    """Readable twin of `measured_lines`."""
    s, step = settings, np.maximum(reach / settings.half * lines[4], 0.25)
    values, first, last = sample_lines_reference(image, visible, lines, step, s.half)
    moments = line_moments_reference(values, first, last, step)
    mean, variance = pooled_gaussians_reference(moments, lines[0], group, colours, s)
    posterior = boundary_posterior_reference(values, first, last, step, mean, variance, s.clip)
    shift = edge_shift_reference(values, first, last, step, mean, variance, posterior[0], s.clip)
    return _weighed(lines, posterior[0] + shift, *posterior[1:], s)


def ratio_lines_reference(
    ratio: Float32, visible: VisibleParts, lines: Lines, reach: float, settings: LineSettings
) -> Measured:
    """Readable twin of `ratio_lines`: Gaussians of unit variance at ±½ have the value itself for their log ratio."""
    step = np.maximum(reach / settings.half * lines[4], 0.25)
    values, first, last = sample_lines_reference(ratio[..., None], visible, lines, step, settings.half)
    mean = np.tile([[0.5], [-0.5]], (len(step), 1, 1))
    posterior = boundary_posterior_reference(values, first, last, step, mean, np.ones_like(mean), settings.clip)
    return _weighed(lines, *posterior, settings)


def _weighed(lines: Lines, displacement: Float, spread: Float, evidence: Float, s: LineSettings) -> Measured:
    pixels, normals, _, outer, inverse_depth = lines
    variance = spread + s.least_sigma**2 + (s.surface_sigma * inverse_depth) ** 2
    weight = s.fraction * np.where(outer, 1.0, s.inner) / variance
    return displacement, weight, evidence, pixels + displacement[:, None] * normals


def sample_lines_reference(
    image: Float32, visible: VisibleParts, lines: Lines, step: Float, half: int
) -> tuple[Float, Int, Int]:
    """Readable twin of `sample_lines`."""
    (face_index, face_part), (pixels, normals, part, outer, _) = visible, lines
    seen = np.where(face_index >= 0, face_part[face_index], -1)
    height, width, channels = image.shape
    values = np.zeros((len(pixels), 2 * half + 1, channels))
    ends = np.full((len(pixels), 2), half)
    for n in range(len(pixels)):
        for side, ks in enumerate((range(half, -1, -1), range(half + 1, 2 * half + 1))):
            for k in ks:
                x, y = pixels[n] + (k - half) * step[n] * normals[n]
                if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                    break
                there, asked = seen[int(y + 0.5), int(x + 0.5)], abs(k - half) > 1.0 / step[n]
                stays = there == part[n] if side == 0 else there < 0 or (there != part[n] and not outer[n])
                if asked and not stays:
                    break
                c, r = int(x), int(y)
                weights = np.outer([1.0 - y + r, y - r], [1.0 - x + c, x - c])
                values[n, k] = np.einsum("ij,ijc->c", weights, image[r : r + 2, c : c + 2])
                ends[n, side] = k
    return values, ends[:, 0], ends[:, 1]


def line_moments_reference(values: Float | Float32, first: Int, last: Int, step: Float) -> Float:
    """Readable twin of `line_moments`."""
    half, out = values.shape[1] // 2, []
    for line, lo, hi, skip in zip(values.astype(float), first, last, np.ceil(1.0 / step).astype(int), strict=True):
        sides = (line[lo : max(half - skip + 1, 0)], line[half + skip : hi + 1])
        out.append([np.concatenate([[len(v)], v.sum(axis=0), (v**2).sum(axis=0)]) for v in sides])
    return np.array(out)


def pooled_gaussians_reference(
    moments: Float, pixels: Float, part: Int, colours: Float, s: LineSettings
) -> tuple[Float, Float]:
    """Readable twin of `pooled_gaussians`."""
    channels, same = (moments.shape[2] - 1) // 2, part[:, None] == part
    d2 = np.sum((pixels[:, None] - pixels) ** 2, axis=2) / s.rho**2
    sums = np.einsum("nm,msf->nsf", same * np.maximum(1.0 - d2 / 6.25, 0.0) ** 3, moments)
    whole = np.einsum("nm,msf->nsf", same, moments)
    whole = np.where(whole[..., :1] > 0.0, whole, moments.sum(axis=0))
    prior = np.where(whole[..., :1] > 0.0, s.prior_mass * whole / np.maximum(whole[..., :1], 1e-300), 0.0)
    confidence = colours[part, :1]
    known = np.concatenate([np.ones_like(confidence), colours[part, 1:]], axis=1)
    prior[:, 0] = np.where(confidence > 0.0, s.colour_mass * confidence * known, prior[:, 0])
    mean_and_square = (sums + prior)[..., 1:] / np.maximum((sums + prior)[..., :1], 1e-9)
    mean = mean_and_square[..., :channels]
    return mean, np.maximum(mean_and_square[..., channels:] - mean**2, 0.0) + s.floor


def boundary_posterior_reference(
    values: Float | Float32, first: Int, last: Int, step: Float, mean: Float, variance: Float, clip: float
) -> tuple[Float, Float, Float]:
    """Readable twin of `boundary_posterior`."""
    half = values.shape[1] // 2
    displacement, spread, evidence = np.zeros(len(values)), np.zeros(len(values)), np.zeros(len(values))
    for n, (lo, hi) in enumerate(zip(first, last, strict=True)):
        I = values[n, lo : hi + 1].astype(float)
        log_p = -0.5 * ((I[:, None] - mean[n]) ** 2 / variance[n] + np.log(variance[n]))  # (samples, side, channel)
        ratio = np.clip((log_p[:, 0] - log_p[:, 1]).sum(axis=-1), -clip, clip)
        score = np.concatenate([[0.0], np.cumsum(step[n] * ratio)])
        p = np.exp(score - score.max())
        p /= p.sum()
        d = (np.arange(lo, hi + 2) - half - 0.5) * step[n]
        displacement[n] = p @ d
        spread[n] = p @ d**2 - displacement[n] ** 2
        evidence[n] = score.max() - max(score[0], score[-1])
    return displacement, spread, evidence


def edge_shift_reference(
    values: Float | Float32, first: Int, last: Int, step: Float, mean: Float, variance: Float, displacement: Float,
    clip: float,
) -> Float:  # fmt: skip
    """Readable twin of `edge_shift`."""
    half, shift = values.shape[1] // 2, np.zeros(len(values))
    for n, (lo, hi) in enumerate(zip(first, last, strict=True)):
        reach = max(step[n], 1.0)
        tried = displacement[n] + np.linspace(-reach, reach, 2 * PLACES + 1)
        at = (np.arange(lo, hi + 1) - half) * step[n]
        near = np.abs(at - displacement[n]) <= reach + EDGE
        share = np.clip(0.5 + (tried - at[near][:, None]) / (2.0 * EDGE), 0.0, 1.0)  # (samples, places)
        share = np.floor(share * SHARES + 0.5)[..., None] / SHARES
        mu = share * mean[n, 0] + (1.0 - share) * mean[n, 1]
        spread = share**2 * variance[n, 0] + (1.0 - share) ** 2 * variance[n, 1]
        I = values[n, lo : hi + 1].astype(float)[near][:, None]
        log_p = -0.5 * ((I - mu) ** 2 / spread + np.log(spread)).sum(axis=2)
        if len(log_p):
            log_p = np.maximum(log_p - log_p.max(axis=1, keepdims=True), -clip)
        score = min(step[n], 1.0) * log_p.sum(axis=0)
        p = np.exp(score - score.max())
        shift[n] = p @ tried / p.sum() - displacement[n]
    return shift
