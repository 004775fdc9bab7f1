"""Readable twins of the kernels of `_search`, by exhaustive search."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.motion._search import BLOCK, ClipArrays


def prepared_reference(query: Float, factors: Float, width: int) -> tuple[Float, bool]:
    """Readable twin of `prepared`."""
    whole = 2.0 * np.pi
    turns = np.round(np.diff(query, axis=0, prepend=query[:1]) / whole)
    unwrapped = query - whole * np.cumsum(turns, axis=0)
    unwrapped -= whole * np.round(unwrapped.mean(axis=0) / whole)
    out = np.pad(unwrapped[::-1] * factors, ((0, 0), (0, width - query.shape[1])))
    return out, bool(np.isfinite(out).all())


def tubes_reference(base: Float32, begin: Int, end: Int) -> tuple[Float, Float, Float, Float]:
    """Readable twin of `tubes`."""
    K, B = len(base), len(begin)
    middles, lines, halves, radii = np.empty((K, B)), np.zeros((K, B)), np.empty(B), np.empty(B)
    for b in range(B):
        poses = base[:, begin[b] : end[b]].astype(float)
        way = poses[:, -1] - poses[:, 0]
        middles[:, b] = (poses.min(axis=1) + poses.max(axis=1)) / 2
        lines[:, b] = way / length if (length := np.linalg.norm(way)) > 0.0 else 0.0
        away = poses - middles[:, b, None]
        along = lines[:, b] @ away
        halves[b] = np.abs(along).max()
        radii[b] = np.linalg.norm(away - np.outer(lines[:, b], along), axis=0).max()
    return middles, lines, halves, radii


def tube_distances_reference(
    middles: Float32, lines: Float32, halves: Float32, radii: Float32, query: Float32, lags: Int
) -> Float:
    """Readable twin of `tube_distances`, not rounded down."""
    away = middles.astype(float) - query[lags][:, :, None]  # (L, K, B)
    along = np.sum(away * lines, axis=1)
    across = np.linalg.norm(away - along[:, None] * lines, axis=1)
    beyond = np.maximum(np.abs(along) - halves, 0.0)
    return np.maximum(np.hypot(across, beyond) - radii, 0.0)


def block_bounds_reference(away: Float32, lags: Int, slow: float, fast: float, first_block: Int) -> Float:
    """Readable twin of `block_bounds`."""
    out = np.zeros(away.shape[1])
    for row, v in zip(away, lags, strict=True):
        for b, first in enumerate(first_block):
            nearest = max(first, b - int(np.floor(slow * v / BLOCK)))
            farthest = max(first, b - int(np.ceil(fast * v / BLOCK)))
            out[b] += row[farthest : nearest + 1].min()
    return out


def score_reference(base: Float32, query: Float, start: int, j: int, step: float, limit: float) -> float:
    """Readable twin of `score`; infinite above the limit."""
    places = (j - np.arange(len(query))) * step
    poses = [np.interp(places, np.arange(base.shape[1] - start), row[start:]) for row in base.astype(float)]
    total = float(np.linalg.norm(np.array(poses).T - query, axis=1).sum())
    return total if total <= limit else np.inf


def _ends(m: int, poses: int, step: float, ahead: float) -> Iterator[tuple[int, float]]:
    """The poses j of a scaled clip at which m poses may end, and their positions in the clip."""
    j = m - 1
    while (j + ahead) * step <= poses - 1 + 1e-8:
        yield j, j * step
        j += 1


def search_reference(
    clips: ClipArrays, query: Float, steps: Float, blocks: tuple[Float32, Int, Int], ahead: float,
    excluded: tuple[Int, Float], limit: float,
) -> tuple[float, int, int, int]:  # fmt: skip
    """Readable twin of `search`; the bounds of the blocks are not needed."""
    (base, _, starts), found = clips, (limit, -1, -1, -1)
    for clip, (start, end) in enumerate(pairwise(starts)):
        windows = excluded[1][excluded[0] == clip]
        for scale, step in enumerate(steps):
            for j, place in _ends(len(query), end - start, step, ahead):
                if not ((windows[:, 0] < place) & (place < windows[:, 1])).any():
                    value = score_reference(base[:, :end], query, start, j, step, np.inf)
                    found = min(found, (value, clip, scale, j), key=lambda match: match[0])
    return found


def nearby_reference(
    base: Float32, query: Float, steps: Float, start: int, end: int, low: float, high: float, ahead: float
) -> tuple[float, int, int]:  # fmt: skip
    """Readable twin of `nearby`."""
    found = (np.inf, -1, -1)
    for scale, step in enumerate(steps):
        for j, place in _ends(len(query), end - start, step, ahead):
            if low - 1e-8 <= place <= high + 1e-8:
                value = score_reference(base[:, :end], query, start, j, step, np.inf)
                found = min(found, (value, scale, j), key=lambda match: match[0])
    return found
