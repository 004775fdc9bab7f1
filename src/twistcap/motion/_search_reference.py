"""Readable twins of the kernels of `_search`, by exhaustive search."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from twistcap.arrays import Float, Float32, Int
from twistcap.motion._search import ClipArrays


def prepared_reference(query: Float, factors: Float, width: int) -> tuple[Float, bool]:
    """Readable twin of `prepared`."""
    whole = 2.0 * np.pi
    turns = np.round(np.diff(query, axis=0, prepend=query[:1]) / whole)
    unwrapped = query - whole * np.cumsum(turns, axis=0)
    unwrapped -= whole * np.round(unwrapped.mean(axis=0) / whole)
    out = np.pad(unwrapped[::-1] * factors, ((0, 0), (0, width - query.shape[1])))
    return out, bool(np.isfinite(out).all())


def score_reference(base: Float32, query: Float, start: int, j: int, step: float, limit: float) -> float:
    """Readable twin of `score`; infinite above the limit."""
    places = (j - np.arange(len(query))) * step
    poses = [np.interp(places, np.arange(base.shape[1] - start), row[start:]) for row in base.astype(float)]
    total = float(np.linalg.norm(np.array(poses).T - query, axis=1).sum())
    return total if total <= limit else np.inf


def search_reference(
    clips: ClipArrays, query: Float, steps: Float, ahead: float, excluded: tuple[Int, Float], limit: float
) -> tuple[float, int, int, int]:  # fmt: skip
    """Readable twin of `search`."""
    (base, _, starts), found = clips, (limit, -1, -1, -1)
    for clip, (start, end) in enumerate(pairwise(starts)):
        windows = excluded[1][excluded[0] == clip]
        for scale, step in enumerate(steps):
            j = len(query) - 1
            while (j + ahead) * step <= end - start - 1 + 1e-8:
                if not ((windows[:, 0] < j * step) & (j * step < windows[:, 1])).any():
                    value = score_reference(base[:, :end], query, start, j, step, np.inf)
                    found = min(found, (value, clip, scale, j), key=lambda match: match[0])
                j += 1
    return found
