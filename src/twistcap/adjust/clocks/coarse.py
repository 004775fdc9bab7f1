"""Coarse offsets of clocks: signals of all cameras, of sound or of motion, are shifted until they agree."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from twistcap.arrays import AnyArray, Float

_WIDTH = 160  # px of the images whose motion is measured
_NOISE = 4.0  # grey levels by which a pixel changes without motion
_FLOOR = 0.5  # grey levels per second, below which motion does not count
_HOP = 0.002  # s of sound, of which the loudness is one sample
_BLUR = 2.0  # samples: a clap falls into one of them in one camera, and between two in another
_QUIET = 1e-3  # of full loudness: below it nothing is heard
_SWEEPS = 3  # in which each camera is placed again, all others given


@dataclass(frozen=True)
class Signal:
    """Values (N,) at rising times (N,) s of a camera's own clock."""

    times: Float
    values: Float

    def at_rate(self, rate: float) -> Float:
        """(M,) values at even times from the first on."""
        count = max(2, int((self.times[-1] - self.times[0]) * rate) + 1)
        return np.interp(self.times[0] + np.arange(count) / rate, self.times, self.values)


@dataclass(frozen=True)
class Coarse:
    """Offsets (C,) s that bring signals together, the first 0.

    `correlation` (C,) is the mean correlation with the other signals; `margin` (C,) by how much the next different
    offset is worse.
    """

    offsets: Float
    correlation: Float
    margin: Float


def motion_signal(images: Iterable[AnyArray | None], times: Float) -> Signal:
    """How much of a camera's image changes per second, between each image and the next.

    It is the logarithm, so that being near the camera counts less. Images are (H, W) or (H, W, 3) uint8.
    """
    middles, values = list[float](), list[float]()
    for (before, first), (after, second) in pairwise(zip(times, map(_small, images), strict=False)):
        if first is None or second is None:
            continue
        change = np.maximum(cv2.absdiff(first, second).astype(float) - _NOISE, 0.0)
        middles.append(0.5 * float(before + after))
        values.append(float(np.log(change.mean() / max(after - before, 1e-6) + _FLOOR)))
    return Signal(np.array(middles), np.array(values))


def sound_signal(samples: Float, rate: float) -> Signal:
    """How suddenly a camera's sound (N,) at `rate` (1/s) becomes louder: a clap is a peak."""
    hop = max(1, round(rate * _HOP))
    count = len(samples) // hop
    loud = np.log(np.sqrt(np.mean(samples[: count * hop].reshape(count, hop) ** 2, axis=1)) + _QUIET)
    rise = np.maximum(np.diff(loud), 0.0) ** 2
    times = np.arange(1, len(rise) + 1, dtype=np.float64) * (hop / rate)
    return Signal(times, np.asarray(gaussian_filter1d(rise, _BLUR), np.float64))


def _small(image: AnyArray | None) -> AnyArray | None:
    if image is None:
        return None
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    factor = min(1.0, _WIDTH / grey.shape[1])
    return cv2.GaussianBlur(cv2.resize(grey, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA), (0, 0), 1.0)


def coincidence(signals: Sequence[Signal], rate: float, overlap: float, apart: float) -> Coarse:
    """Offsets at which all signals agree best.

    Each camera is placed where its correlation with those that are placed already is best, and again with all others.

    Args:
        signals: of each camera, on its own clock.
        rate: 1/s, at which signals are compared.
        overlap: s that two signals must have in common.
        apart: s by which an offset must differ to be another one.
    """
    even = [signal.at_rate(rate) for signal in signals]
    starts = np.array([signal.times[0] for signal in signals])
    pairs = {
        (a, b): _correlations(even[a], even[b], max(2, int(overlap * rate)))
        for a in range(len(even)) for b in range(len(even)) if a != b
    }  # fmt: skip
    order, shifts = [0], np.zeros(len(even), dtype=int)
    while len(order) < len(even):
        best = {b: _placed(pairs, shifts, order, b) for b in range(len(even)) if b not in order}
        chosen = max(best, key=lambda b: best[b][1])
        shifts[chosen], order = best[chosen][0], [*order, chosen]
    for _ in range(_SWEEPS):
        for b in order[1:]:
            shifts[b] = _placed(pairs, shifts, [a for a in order if a != b], b)[0]
    wide = int(apart * rate)
    placed = [_placed(pairs, shifts, [a for a in order if a != b], b, wide) for b in range(len(even))]
    offsets = shifts / rate - (starts - starts[0])
    return Coarse(offsets, np.array([t[1] for t in placed]), np.array([t[2] for t in placed]))


Curve = tuple[int, Float]
"""Correlations by shift; the first shift, in samples."""


def _placed(
    pairs: dict[tuple[int, int], Curve], shifts: AnyArray, others: Sequence[int], b: int, apart: int = 1
) -> tuple[int, float, float]:
    """Best shift of signal b, its mean correlation with the others, and how much worse it is elsewhere."""
    curves = [(pairs[a, b][0] + shifts[a], pairs[a, b][1]) for a in others]
    first, end = min(c[0] for c in curves), max(c[0] + len(c[1]) for c in curves)
    total = np.zeros(end - first)
    for start, values in curves:
        total[start - first : start - first + len(values)] += values
    best = int(np.argmax(total))
    elsewhere = np.concatenate([total[: max(0, best - apart)], total[best + apart + 1 :]])
    next_best = float(elsewhere.max(initial=0.0))
    return first + best, float(total[best]) / len(others), float(total[best] - next_best) / len(others)


def _correlations(a: Float, b: Float, overlap: int) -> Curve:
    """Pearson's correlation of b shifted by k samples with a, over what they have in common, for all k that leave
    `overlap` samples. It is lowered for short overlaps: by chance these correlate more."""
    from scipy.signal import correlate  # slow to import

    overlap = min(overlap, len(a), len(b))
    one = correlate(np.ones(len(a)), np.ones(len(b)), method="fft").round()
    sums = [correlate(x, y, method="fft") for x, y in (
        (a, np.ones(len(b))), (np.ones(len(a)), b), (a * a, np.ones(len(b))), (np.ones(len(a)), b * b), (a, b),
    )]  # fmt: skip
    n = np.maximum(one, 1.0)
    sa, sb, saa, sbb, sab = sums
    variance = np.maximum(saa - sa * sa / n, 0.0) * np.maximum(sbb - sb * sb / n, 0.0)
    r = (sab - sa * sb / n) / np.sqrt(np.maximum(variance, 1e-12 * variance.max()))
    kept = np.flatnonzero(one >= overlap)
    chance = overlap / (overlap + one[kept])
    return int(kept[0]) - (len(b) - 1), r[kept] * (1.0 - 0.5 * chance)
