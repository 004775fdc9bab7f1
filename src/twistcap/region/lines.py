"""Region statistics along the contour's normals, and what they say about where the true contour lies.

The direct counterpart of the level set: the same two local Gaussian densities, inside and outside (Brox, Rosenhahn
and Cremers, "Contours, Optic Flow, and Prior Knowledge", eq. 11.7-11.11), evaluated on lines across the projected
contour only. Every place along a line is a hypothesis for the boundary; its log-likelihood is the sum of the log
density ratios on the inner side of it. The posterior's mean is the displacement, its variance the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32, Int


@dataclass(frozen=True)
class LineSamples:
    """Image values on lines across a contour; sample k of a line lies ``(k − M) · step`` px outward.

    Attributes:
        values: (N, 2M + 1, C) channels.
        first, last: (N,) the run of usable samples: own part inward, not own part outward.
        step: (N,) px between samples.
    """

    values: Float32
    first: Int
    last: Int
    step: Float


@njit(cache=True, nogil=True)
def sample_lines(
    image: Float32, part_image: Int, pixels: Float, normals: Float, part: Int, outer: Int,
    step: Float, half: int,
) -> tuple[Float32, Int, Int]:  # fmt: skip
    """Bilinear values (N, 2 half + 1, C) along the lines, and the first and last usable sample of each (N,).

    Inward a line is usable while it stays on its own part, outward while it stays off it: off the body for outer
    contours, off the part for inner ones. `part_image` (H, W) holds the visible part, -1 off the body.
    """
    N, channels = len(pixels), image.shape[2]
    height, width = image.shape[:2]
    values = np.zeros((N, 2 * half + 1, channels), dtype=np.float32)
    first, last = np.full(N, half, dtype=np.int32), np.full(N, half, dtype=np.int32)
    for n in range(N):
        for direction in (-1, 1):
            for i in range(0 if direction < 0 else 1, half + 1):
                k = half + direction * i
                d = direction * i * step[n]
                x, y = pixels[n, 0] + d * normals[n, 0], pixels[n, 1] + d * normals[n, 1]
                if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                    break
                if i * step[n] > 1.0:  # at the contour itself rounding decides: not asked there
                    seen = part_image[int(y + 0.5), int(x + 0.5)]
                    if direction < 0 and seen != part[n]:
                        break
                    if direction > 0 and ((outer[n] and seen >= 0) or seen == part[n]):
                        break
                x0, y0 = int(x), int(y)
                fx, fy = np.float32(x - x0), np.float32(y - y0)
                for c in range(channels):
                    top = image[y0, x0, c] + fx * (image[y0, x0 + 1, c] - image[y0, x0, c])
                    bottom = image[y0 + 1, x0, c] + fx * (image[y0 + 1, x0 + 1, c] - image[y0 + 1, x0, c])
                    values[n, k, c] = top + fy * (bottom - top)
                if direction < 0:
                    first[n] = k
                else:
                    last[n] = k
    return values, first, last


@njit(cache=True, nogil=True)
def line_moments(values: Float32, first: Int, last: Int, step: Float) -> Float:
    """(N, 2, 1 + 2C) mass, sums and sums of squares of each line, inside and outside, a pixel off the contour."""
    N, length, channels = values.shape
    half = length // 2
    out = np.zeros((N, 2, 1 + 2 * channels))
    for n in range(N):
        for k in range(first[n], last[n] + 1):
            if abs(k - half) * step[n] < 1.0:
                continue
            side = 0 if k < half else 1
            out[n, side, 0] += 1.0
            for c in range(channels):
                value = values[n, k, c]
                out[n, side, 1 + c] += value
                out[n, side, 1 + channels + c] += value * value
    return out


@njit(cache=True, nogil=True, fastmath={"contract"})
def _pooled(moments: Float, pixels: Float, part: Int, rho: float) -> Float:
    """(N, F) moments (N, F) of all lines of the same part under a Gaussian window of `rho` px, each pair seen once."""
    N, fields = moments.shape
    out = moments.copy()
    order = np.argsort(part, kind="mergesort")
    for i in range(N):
        n = order[i]
        for j in range(i + 1, N):
            m = order[j]
            if part[m] != part[n]:
                break
            dx, dy = pixels[m, 0] - pixels[n, 0], pixels[m, 1] - pixels[n, 1]
            d2 = (dx * dx + dy * dy) / (rho * rho)
            if d2 >= 6.25:
                continue
            weight = np.exp(-0.5 * d2)
            for f in range(fields):
                out[n, f] += weight * moments[m, f]
                out[m, f] += weight * moments[n, f]
    return out


@njit(cache=True, nogil=True)
def pooled_gaussians(
    moments: Float, pixels: Float, part: Int, rho: float, prior_mass: float, floor: float
) -> tuple[Float, Float]:
    """Local means and variances (N, 2, C) of both sides, pooled over the lines of the same part within about `rho` px.

    A Gaussian window of `rho` px weights the neighbours; the part's whole statistics come in with `prior_mass`
    samples, so that a line without neighbours falls back on them smoothly. `floor` is the least variance.
    """
    N, _, fields = moments.shape
    channels = (fields - 1) // 2
    mean, variance = np.zeros((N, 2, channels)), np.zeros((N, 2, channels))
    pooled = _pooled(moments.reshape(N, 2 * fields), pixels, part, rho).reshape(N, 2, fields)
    whole = np.zeros((part.max() + 1 if N else 1, 2, fields))
    for n in range(N):
        whole[part[n]] += moments[n]
    everything = whole.sum(axis=0)
    for n in range(N):
        for side in range(2):
            fallback = whole[part[n], side] if whole[part[n], side, 0] > 0.0 else everything[side]
            share = prior_mass / fallback[0] if fallback[0] > 0.0 else 0.0
            mass = max(pooled[n, side, 0] + share * fallback[0], 1e-9)
            for c in range(channels):
                mu = (pooled[n, side, 1 + c] + share * fallback[1 + c]) / mass
                second = (pooled[n, side, 1 + channels + c] + share * fallback[1 + channels + c]) / mass
                mean[n, side, c] = mu
                variance[n, side, c] = max(second - mu * mu, 0.0) + floor
    return mean, variance


@njit(cache=True, nogil=True)
def boundary_posterior(
    values: Float32, first: Int, last: Int, step: Float, mean: Float, variance: Float, clip: float
) -> tuple[Float, Float, Float]:
    """Mean (px, outward), variance (px²) and evidence of the contour's displacement along each line.

    The boundary may lie half a step before or behind any usable sample. A sample's log density ratio is clipped to
    ±`clip` nats per px, which keeps one odd pixel from deciding. Evidence is the log-likelihood of the best place
    against that of "no boundary here" (all inside or all outside), in nats: how much the line has to say.
    """
    N, length, channels = values.shape
    half = length // 2
    displacement, spread, evidence = np.zeros(N), np.zeros(N), np.zeros(N)
    score, precision = np.zeros(length + 1), np.zeros((2, channels))
    for n in range(N):
        lo, hi = first[n], last[n]
        total, best, log_spread = 0.0, 0.0, 0.0
        for c in range(channels):
            log_spread += 0.5 * np.log(variance[n, 1, c] / variance[n, 0, c])
            precision[0, c], precision[1, c] = 0.5 / variance[n, 0, c], 0.5 / variance[n, 1, c]
        score[lo] = 0.0
        for k in range(lo, hi + 1):
            ratio = log_spread
            for c in range(channels):
                inside, outside = values[n, k, c] - mean[n, 0, c], values[n, k, c] - mean[n, 1, c]
                ratio += outside * outside * precision[1, c] - inside * inside * precision[0, c]
            total += step[n] * min(max(ratio, -clip), clip)
            score[k + 1] = total
            best = max(best, total)
        sum_p, sum_d, sum_d2 = 0.0, 0.0, 0.0
        for k in range(lo, hi + 2):
            p = np.exp(score[k] - best)
            d = (k - half - 0.5) * step[n]
            sum_p += p
            sum_d += p * d
            sum_d2 += p * d * d
        displacement[n] = sum_d / sum_p
        spread[n] = max(sum_d2 / sum_p - displacement[n] ** 2, 0.0)
        evidence[n] = best - max(0.0, total)
    return displacement, spread, evidence


def boundary_posterior_reference(
    values: Float32, first: Int, last: Int, step: Float, mean: Float, variance: Float, clip: float
) -> tuple[Float, Float]:
    """Readable twin of `boundary_posterior`: mean and variance."""
    half = values.shape[1] // 2
    displacement, spread = np.zeros(len(values)), np.zeros(len(values))
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
    return displacement, spread
