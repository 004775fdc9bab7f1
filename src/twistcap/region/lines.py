"""Region statistics along the contour's normals, and the posterior of the true contour's place on them.

The same two local Gaussian densities as the level set, inside and outside (Brox, Rosenhahn and Cremers, "Contours,
Optic Flow, and Prior Knowledge", eq. 11.7-11.11), on lines across the projected contour only. Every place along a line
is a hypothesis for the boundary, whose log-likelihood is the sum of the log density ratios on its inner side. There the
samples that hold both sides, as mixtures of the densities, tell the place to a fraction of a pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32, Int

_FAST = {"contract", "reassoc", "arcp", "nsz"}  # never `nnan` or `ninf`: images may hold any numbers

VisibleParts = tuple[Int, Int]
"""Visible triangle (H, W) of a rendered body at each pixel, -1 off it, and the part (F,) of each triangle."""
EDGE = 1.0
"""px from the boundary to a sample that holds one side alone: a pixel's half, and half for lens and bilinear sample."""
SHARES, PLACES = 16, 4
"""Steps in which shares of a mixture are told, and places of the boundary that are compared on each side."""
Lines = tuple[Float, Float, Int, Bool, Float]
"""Pixels (N, 2), unit normals (N, 2), part (N,), whether on the silhouette (N,) and inverse depth (N,), 1/m."""
Measured = tuple[Float, Float, Float, Float]
"""(N,) displacement (px, outward), (N,) information (1/px²), (N,) evidence (nats) and (N, 2) target (px)."""


class LineSettings(NamedTuple):
    """How lines are measured and weighted."""

    half: int  # samples on each side of the contour
    clip: float  # largest log density ratio, nats per px
    fraction: float  # of each line's information that counts, since neighbours measure the same pixels
    inner: float  # a further factor for contours before another part of the body
    least_sigma: float  # standard deviation of the measurement, added, px
    surface_sigma: float  # standard deviation of the body's surface, added, px at 1 m from the camera
    rho: float  # width of the window in which lines of a group pool their statistics, px
    prior_mass: float  # weight of a group's whole statistics, in samples
    floor: float  # least variance
    colour_mass: float  # weight of a group's remembered colours, in samples


@njit(cache=True, nogil=True, fastmath=_FAST)
def measured_lines(
    image: Float32, visible: VisibleParts, lines: Lines, group: Int, colours: Float, reach: float,
    settings: LineSettings,
) -> Measured:  # fmt: skip
    """All lines of a view (H, W, C), by the four steps below.

    Args:
        group: (N,) lines of one number pool their statistics: the part, or 0 for the whole body.
        colours: (G, 1 + 2C) remembered confidence, mean and mean square of each group.
        reach: half length of the lines, px at 1 m from the camera.
    """
    step = np.maximum(reach / settings.half * lines[4], 0.25)
    values, first, last = sample_lines(image, visible, lines, step, settings.half)
    moments = line_moments(values, first, last, step)
    mean, variance = pooled_gaussians(moments, lines[0], group, colours, settings)
    displacement, spread, evidence = boundary_posterior(values, first, last, step, mean, variance, settings.clip)
    displacement += edge_shift(values, first, last, step, mean, variance, displacement, settings.clip)
    return _weighed(lines, (displacement, spread, evidence), settings)


@njit(cache=True, nogil=True)
def ratio_lines(ratio: Float32, visible: VisibleParts, lines: Lines, reach: float, settings: LineSettings) -> Measured:
    """As `measured_lines`, from given log density ratios (H, W) of any region model."""
    step = np.maximum(reach / settings.half * lines[4], 0.25)
    image = ratio.reshape((*ratio.shape, 1))
    values, first, last = sample_lines(image, visible, lines, step, settings.half)
    mean = np.full((len(step), 2, 1), 0.5)  # of Gaussians of unit variance at ±½ a value is its own log ratio
    mean[:, 1] = -0.5
    variance = np.ones_like(mean)
    posterior = boundary_posterior(values, first, last, step, mean, variance, settings.clip)
    return _weighed(lines, posterior, settings)


@njit(cache=True, nogil=True)
def _weighed(lines: Lines, posterior: tuple[Float, Float, Float], settings: LineSettings) -> Measured:
    """What lines measure, from the displacement (N,), spread (N,) and evidence (N,) of their posteriors."""
    (pixels, normals, _, outer, inverse_depth), (displacement, spread, evidence) = lines, posterior
    weight, target = np.empty_like(spread), np.empty_like(pixels)
    for n in range(len(pixels)):
        surface = settings.surface_sigma * inverse_depth[n]
        counts = settings.fraction * (1.0 if outer[n] else settings.inner)
        weight[n] = counts / (spread[n] + settings.least_sigma**2 + surface * surface)
        target[n, 0] = pixels[n, 0] + displacement[n] * normals[n, 0]
        target[n, 1] = pixels[n, 1] + displacement[n] * normals[n, 1]
    return displacement, weight, evidence, target


@njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def _bilinear(flat: Float32, at: int, row: int, channels: int, fx: np.float32, fy: np.float32, out: Float32) -> None:
    """Value at (fx, fy) from the pixel whose first channel is at index `at`; a row has `row` numbers."""
    for c in range(channels):
        a, b = flat[at + c], flat[at + row + c]
        top, bottom = a + fx * (flat[at + channels + c] - a), b + fx * (flat[at + row + channels + c] - b)
        out[c] = top + fy * (bottom - top)


@njit(cache=True, nogil=True, fastmath=_FAST)
def sample_lines(
    image: Float32, visible: VisibleParts, lines: Lines, step: Float, half: int
) -> tuple[Float32, Int, Int]:
    """Bilinear values (N, 2 half + 1, C) along the lines, and the first and last usable sample of each (N,).

    Sample k is ``(k − half) · step`` px outward. Inward a line is usable while it stays on its own part, outward while
    it stays off the body (outer contours) or off the part (inner ones). Other values are 0.
    """
    face_index, face_part = visible
    pixels, normals, part, outer, _ = lines
    N, channels = len(pixels), image.shape[2]
    height, width = image.shape[:2]
    flat, row = image.reshape(-1), width * channels
    values = np.zeros((N, 2 * half + 1, channels), dtype=np.float32)
    first, last = np.full(N, half, dtype=np.int32), np.full(N, half, dtype=np.int32)
    for n in range(N):
        own, off_body, nearest = part[n], outer[n], 1.0 / step[n]  # nearer to the contour rounding would decide
        for direction in (-1, 1):
            for i in range(0 if direction < 0 else 1, half + 1):
                k = half + direction * i
                d = direction * i * step[n]
                x, y = pixels[n, 0] + d * normals[n, 0], pixels[n, 1] + d * normals[n, 1]
                if not (0.0 <= x < width - 1 and 0.0 <= y < height - 1):
                    break
                if i > nearest:
                    face = face_index[int(y + 0.5), int(x + 0.5)]
                    seen = face_part[face] if face >= 0 else -1
                    if direction < 0 and seen != own:
                        break
                    if direction > 0 and ((off_body and seen >= 0) or seen == own):
                        break
                x0, y0 = int(x), int(y)
                fx, fy = np.float32(x - x0), np.float32(y - y0)
                at = y0 * row + x0 * channels
                if channels == 3:  # a constant for the compiler
                    _bilinear(flat, at, row, 3, fx, fy, values[n, k])
                else:
                    _bilinear(flat, at, row, channels, fx, fy, values[n, k])
                if direction < 0:
                    first[n] = k
                else:
                    last[n] = k
    return values, first, last


@njit(cache=True, nogil=True, fastmath=_FAST)
def line_moments(values: Float32, first: Int, last: Int, step: Float) -> Float:
    """(N, 2, 1 + 2C) mass, sums and sums of squares of each line, inside and outside, a pixel off the contour."""
    N, length, channels = values.shape
    half = length // 2
    out = np.zeros((N, 2, 1 + 2 * channels))
    for n in range(N):
        skip = int(np.ceil(1.0 / step[n]))
        for side in range(2):
            lo, hi = (first[n], half - skip) if side == 0 else (half + skip, last[n])
            sums = out[n, side]
            sums[0] = max(hi - lo + 1, 0)
            for k in range(lo, hi + 1):
                for c in range(channels):
                    value = values[n, k, c]
                    sums[1 + c] += value
                    sums[1 + channels + c] += value * value
    return out


@njit(cache=True, nogil=True, fastmath=_FAST)
def _pooled(moments: Float, pixels: Float, part: Int, rho: float) -> Float:
    """(N, F) moments of all lines of the same part under a window of `rho` px, each pair seen once."""
    N, fields = moments.shape
    out = moments.copy()
    order = _by_part(part)
    scale = 1.0 / (rho * rho)
    for i in range(N):
        n = order[i]
        for j in range(i + 1, N):
            m = order[j]
            if part[m] != part[n]:
                break
            dx, dy = pixels[m, 0] - pixels[n, 0], pixels[m, 1] - pixels[n, 1]
            d2 = (dx * dx + dy * dy) * scale
            if d2 >= 6.25:
                continue
            u = 1.0 - d2 / 6.25
            weight = u * u * u  # close to exp(-d2 / 2), and continuous at its end
            if fields == 14:  # three channels: a constant for the compiler
                _add_both(out, moments, n, m, weight, 14)
            else:
                _add_both(out, moments, n, m, weight, fields)
    return out


@njit(cache=True, nogil=True)
def _by_part(part: Int) -> Int:
    """Numbers of the lines, ordered by their parts (which are not negative); within one as they come."""
    first = np.zeros(part.max() + 2 if len(part) else 1, np.int32)
    for n in range(len(part)):
        first[part[n] + 1] += 1
    for s in range(1, len(first)):
        first[s] += first[s - 1]
    order = np.empty(len(part), np.int32)
    for n in range(len(part)):
        order[first[part[n]]] = n
        first[part[n]] += 1
    return order


@njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def _add_both(out: Float, moments: Float, n: int, m: int, weight: float, fields: int) -> None:
    """Add the moments of lines n and m to each other's."""
    for f in range(fields):
        out[n, f] += weight * moments[m, f]
    for f in range(fields):
        out[m, f] += weight * moments[n, f]


@njit(cache=True, nogil=True, fastmath=_FAST)
def pooled_gaussians(
    moments: Float, pixels: Float, part: Int, colours: Float, settings: LineSettings
) -> tuple[Float, Float]:
    """Local means and variances (N, 2, C) of both sides, pooled over the lines of the same part within about `rho` px.

    Neighbours are weighted by a window like a Gaussian of `rho` px. The part's whole statistics are added with the
    weight of `prior_mass` samples, for lines without neighbours. Inside, remembered `colours` (S, 1 + 2C) replace them,
    with the weight of `colour_mass` samples times their confidence.
    """
    N, _, fields = moments.shape
    prior_mass, floor, colour_mass = settings.prior_mass, settings.floor, settings.colour_mass
    channels = (fields - 1) // 2
    mean, variance = np.zeros((N, 2, channels)), np.zeros((N, 2, channels))
    pooled = _pooled(moments.reshape(N, 2 * fields), pixels, part, settings.rho).reshape(N, 2, fields)
    whole, everything = np.zeros((part.max() + 1 if N else 1, 2, fields)), np.zeros((2, fields))
    for n in range(N):
        for side in range(2):
            for f in range(fields):
                whole[part[n], side, f] += moments[n, side, f]
                everything[side, f] += moments[n, side, f]
    for n in range(N):
        for side in range(2):
            fallback = whole[part[n], side] if whole[part[n], side, 0] > 0.0 else everything[side]
            scale = prior_mass / fallback[0] if fallback[0] > 0.0 else 0.0
            prior = scale * fallback[0]
            if side == 0 and colours[part[n], 0] > 0.0:
                fallback, scale = colours[part[n]], colour_mass * colours[part[n], 0]
                prior = scale
            mass = max(pooled[n, side, 0] + prior, 1e-9)
            for c in range(channels):
                mu = (pooled[n, side, 1 + c] + scale * fallback[1 + c]) / mass
                second = (pooled[n, side, 1 + channels + c] + scale * fallback[1 + channels + c]) / mass
                mean[n, side, c] = mu
                variance[n, side, c] = max(second - mu * mu, 0.0) + floor
    return mean, variance


@njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def _exp(x: np.float32) -> np.float32:
    """e^x for x ≤ 0 as (1 + x/1024)^1024, with a relative error of x²/2048; the compiler can vectorise it."""
    y = max(np.float32(1.0) + x * np.float32(1.0 / 1024.0), np.float32(0.0))
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    y *= y
    return y * y


@njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def _parabola(values: Float32, linear: Float32, square: Float32, channels: int) -> np.float32:
    """Σ_c value · (linear + square · value)."""
    total = np.float32(0.0)
    for c in range(channels):
        total += values[c] * (linear[c] + square[c] * values[c])
    return total


@njit(cache=True, nogil=True, fastmath=_FAST)
def boundary_posterior(
    values: Float32, first: Int, last: Int, step: Float, mean: Float, variance: Float, clip: float
) -> tuple[Float, Float, Float]:
    """Mean (px, outward), variance (px²) and evidence of the contour's displacement along each line.

    The boundary may be half a step before or behind any usable sample. Log density ratios are clipped to ±`clip` nats
    per px. Evidence is the log-likelihood (nats) of the best place minus that of no boundary on the line.
    """
    N, length, channels = values.shape
    half = length // 2
    displacement, spread, evidence = np.zeros(N), np.zeros(N), np.zeros(N)
    score = np.zeros(length + 1, dtype=np.float32)
    # log p_in / p_out = constant + linear · value + square · value², channel by channel
    linear, square = np.zeros(channels, dtype=np.float32), np.zeros(channels, dtype=np.float32)
    for n in range(N):
        lo, hi, h = first[n], last[n], np.float32(step[n])
        limit, total, best = np.float32(clip * step[n]), np.float32(0.0), np.float32(0.0)
        constant, spreads = 0.0, 1.0
        for c in range(channels):
            within, without = 0.5 / variance[n, 0, c], 0.5 / variance[n, 1, c]
            spreads *= within / without
            constant += without * mean[n, 1, c] ** 2 - within * mean[n, 0, c] ** 2
            linear[c] = 2.0 * h * (within * mean[n, 0, c] - without * mean[n, 1, c])
            square[c] = h * (without - within)
        start = np.float32(h * (constant + 0.5 * np.log(spreads)))
        score[lo] = total
        for k in range(lo, hi + 1):
            ratio = start
            if channels == 3:
                ratio += _parabola(values[n, k], linear, square, 3)
            else:
                ratio += _parabola(values[n, k], linear, square, channels)
            total += min(max(ratio, -limit), limit)
            score[k + 1] = total
            best = max(best, total)
        sum_p, sum_d, sum_d2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(lo, hi + 2):
            p, d = _exp(score[k] - best), np.float32(k - half) - np.float32(0.5)
            sum_p += p
            sum_d += p * d
            sum_d2 += p * d * d
        middle = sum_d / sum_p
        displacement[n] = step[n] * middle
        spread[n] = step[n] ** 2 * max(sum_d2 / sum_p - middle * middle, 0.0)
        evidence[n] = best - max(np.float32(0.0), total)
    return displacement, spread, evidence


@njit(cache=True, nogil=True, fastmath=_FAST)
def edge_shift(
    values: Float32, first: Int, last: Int, step: Float, mean: Float, variance: Float, displacement: Float, clip: float
) -> Float:
    """How far (N,) px outward of a displacement the boundary lies, by the samples that hold both sides.

    A sample on the boundary is a mixture: a share of the inside and the rest of the outside, and so are its mean and
    variance. Taken for one side alone, it passes for the side that varies more. Places up to a step away, and at least
    a pixel, are compared by the likelihood of the mixtures, and the answer is their posterior mean.
    """
    N, _, channels = values.shape
    half, shift = values.shape[1] // 2, np.zeros(N)
    linear, square = np.zeros((SHARES + 1, channels), np.float32), np.zeros((SHARES + 1, channels), np.float32)
    constant = np.zeros(SHARES + 1, np.float32)
    score, sample = np.zeros(2 * PLACES + 1, np.float32), np.zeros(2 * PLACES + 1, np.float32)
    for n in range(N):
        _mixtures(mean[n], variance[n], linear, square, constant)
        h, reach, worth = step[n], max(step[n], 1.0), np.float32(min(step[n], 1.0))
        lo = max(first[n], int(np.ceil((displacement[n] - reach - EDGE) / h)) + half)
        hi = min(last[n], int(np.floor((displacement[n] + reach + EDGE) / h)) + half)
        score[:] = 0.0
        for k in range(lo, hi + 1):
            inward, best = displacement[n] - (k - half) * h, np.float32(-np.inf)
            for i in range(2 * PLACES + 1):
                share = 0.5 + (inward + (i - PLACES) * reach / PLACES) / (2.0 * EDGE)
                m = int(min(max(share, 0.0), 1.0) * SHARES + 0.5)
                if channels == 3:
                    sample[i] = constant[m] + _parabola(values[n, k], linear[m], square[m], 3)
                else:
                    sample[i] = constant[m] + _parabola(values[n, k], linear[m], square[m], channels)
                best = max(best, sample[i])
            for i in range(2 * PLACES + 1):
                score[i] += worth * max(sample[i] - best, np.float32(-clip))
        sum_p, sum_d, highest = 0.0, 0.0, score.max()
        for i in range(2 * PLACES + 1):
            p = _exp(score[i] - highest)
            sum_p += p
            sum_d += p * (i - PLACES)
        shift[n] = reach / PLACES * sum_d / sum_p
    return shift


@njit(cache=True, nogil=True)
def _mixtures(mean: Float, variance: Float, linear: Float32, square: Float32, constant: Float32) -> None:
    """Log densities of mixtures, from the outside alone to the inside alone, as parabolas of each channel's value."""
    for m in range(SHARES + 1):
        share, spreads, total = m / SHARES, 1.0, 0.0
        for c in range(mean.shape[1]):
            mu = share * mean[0, c] + (1.0 - share) * mean[1, c]
            spread = share**2 * variance[0, c] + (1.0 - share) ** 2 * variance[1, c]
            spreads *= spread
            total += mu * mu / spread
            linear[m, c], square[m, c] = mu / spread, -0.5 / spread
        constant[m] = -0.5 * (total + np.log(spreads))
