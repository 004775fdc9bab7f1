"""Kernels of the exact search for the best match; `matching` explains what is searched.

Poses lie in blocks of neighbours, each inside a ball. How far the query is from the balls bounds from below how well a
block can match, so that most blocks are never looked into. Inside a block, distances to the stored poses are shared by
all time scales: at a share f between two poses a and b, ``|Θ − P|² = (1−f)|Θ−a|² + f|Θ−b|² − f(1−f)|b−a|²``.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32, Int

_SLACK = 1e-7  # rad, above the rounding of the bounds
_NEAR = 1e-8  # poses, above the rounding of positions in a clip


@njit(cache=True, nogil=True)
def balls(base: Float32, begin: Int, end: Int) -> tuple[Float32, Float]:
    """Middles (D, B) of stretches of poses begin … end − 1 of base (D, N), and radii (B,) that reach all of them."""
    D, B = len(base), len(begin)
    centres, radii = np.empty((D, B), np.float32), np.empty(B)
    for b in range(B):
        for k in range(D):
            poses = base[k, begin[b] : end[b]]
            centres[k, b] = 0.5 * (poses.min() + poses.max())
        largest = 0.0
        for i in range(begin[b], end[b]):
            squared = 0.0
            for k in range(D):
                squared += (np.float64(base[k, i]) - centres[k, b]) ** 2
            largest = max(largest, squared)
        radii[b] = np.sqrt(largest)
    return centres, radii


@njit(cache=True, nogil=True)
def ball_distances(centres: Float32, radii: Float, query: Float, lags: Int) -> Float:
    """(L, B) least distance that each query pose can have to a pose of each block. Centres are (D, B)."""
    out = np.empty((len(lags), centres.shape[1]))
    for n in range(len(lags)):
        squares = out[n]
        squares[:] = 0.0
        for k in range(centres.shape[0]):
            row, x = centres[k], query[lags[n], k]
            for b in range(len(row)):
                d = row[b] - x
                squares[b] += d * d
        for b in range(len(squares)):
            squares[b] = max(0.0, np.sqrt(squares[b]) - radii[b])
    return out


@njit(cache=True, nogil=True)
def block_bounds(
    distances: Float, lags: Int, slow: float, fast: float, first_block: Int, clip_of: Int, size: int
) -> Float:
    """(B,) a sum of norms that no match ending in each block undercuts.

    Args:
        distances: of `ball_distances`.
        lags: query poses before the last, by row of `distances`.
        slow, fast: least and greatest step of the scales, poses.
        first_block, clip_of: first block of each clip, and the clip of each block.
        size: poses of a block.
    """
    B = distances.shape[1]
    out = np.zeros(B)
    for n in range(len(lags)):
        row, v = distances[n], lags[n]
        # The pose at this lag stands `fast·v` to `slow·v` poses before one in the block.
        farthest = int(np.ceil(fast * v / size))
        nearest = int(np.floor(slow * v / size))
        for b in range(B):
            first = first_block[clip_of[b]]
            low = row[max(first, b - nearest)]
            for c in range(max(first, b - farthest), max(first, b - nearest)):
                low = min(low, row[c])
            out[b] += low
    return out - _SLACK


@njit(cache=True, nogil=True)
def _scale_bound(distances: Float, lags: Int, step: float, block: int, first: int, size: int) -> float:
    """As `block_bounds`, for one block and one scale."""
    total = 0.0
    for n in range(len(lags)):
        back = lags[n] * step / size
        low = max(first, block - int(np.ceil(back)))
        high = max(first, block - int(np.floor(back)))
        total += min(distances[n, low], distances[n, high])
    return total - _SLACK


@njit(cache=True, nogil=True)
def _squares(base: Float32, query: Float, start: int, low: int, high: int, slow: float, fast: float, out: Float) -> None:
    """Squared distances of every query pose to the poses low … high − 1 that its lag can reach, into out (m, W).

    Column i is pose start + i. Base is (D, N).
    """
    for v in range(len(query)):
        begin = max(start, low - int(np.ceil(v * fast)))
        end = min(high, high - int(np.floor(v * slow)) + 1)
        row = out[v, begin - start : end - start]
        row[:] = 0.0
        for k in range(base.shape[0]):
            poses, x = base[k, begin:end], query[v, k]
            for i in range(len(poses)):
                d = poses[i] - x
                row[i] += d * d


@njit(cache=True, nogil=True)
def _score(squares: Float, jumps: Float, origin: int, j: int, step: float, order: Int, limit: float) -> float:
    """Sum of norms at pose j of a scaled clip; some number above the limit as soon as it is sure to be above it."""
    total = 0.0
    for n in range(len(order)):
        v = order[n]
        p = (j - v) * step
        i = int(p + _NEAR)
        f = p - i
        squared = squares[v, i - origin]
        if f > _NEAR:
            squared = (1.0 - f) * squared + f * squares[v, i - origin + 1] - f * (1.0 - f) * jumps[i]
        total += np.sqrt(max(squared, 0.0))
        if total > limit:
            break
    return total


@njit(cache=True, nogil=True)
def search(
    base: Float32, jumps: Float, query: Float, steps: Float, order: Int, distances: Float, lags: Int, bounds: Float,
    first_block: Int, clip_of: Int, starts: Int, size: int, ahead: float,
    barred: Int, windows: Float, limit: float,
) -> tuple[float, int, int, int]:  # fmt: skip
    """The least sum of norms below a limit, its clip, scale and pose j of the scaled clip; clip −1 where there is none.

    Args:
        base: (D, N) weighted coordinates.
        jumps: (N,) squared distance of each pose to the next one of its clip.
        query: (m, D) weighted, the latest first.
        steps: (S,) poses per query pose, 1/s.
        order: (m,) in which lags are summed.
        distances, lags, bounds: of `ball_distances` and `block_bounds`.
        first_block, clip_of, starts, size: how the poses lie in clips and blocks.
        ahead: query poses by which a match must be followed inside its clip.
        barred: (E,) clips, and
        windows: (E, 2) positions in them where no match may end.
        limit: worse matches are not looked for.
    """
    m, B = len(query), len(bounds)
    best, best_clip, best_scale, best_pose = limit, -1, -1, -1
    slow, fast = steps.min(), steps.max()
    scratch = np.empty((m, size + int(np.ceil((m - 1) * fast)) + 2))
    candidates = np.flatnonzero(bounds <= limit)
    if len(candidates) == 0:
        return best, best_clip, best_scale, best_pose
    turn = 0
    lead = candidates[np.argmin(bounds[candidates])]
    while turn <= len(candidates):
        b = lead if turn == 0 else candidates[turn - 1]
        turn += 1
        if bounds[b] > best or (turn > 1 and b == lead):
            continue
        clip = clip_of[b]
        start, end = starts[clip], starts[clip + 1]
        low = (b - first_block[clip]) * size  # within the clip
        high = min(low + size, end - start)
        ready = False
        for s in range(len(steps)):
            step = steps[s]
            last_allowed = min(high - _NEAR, end - start - 1 - ahead * step + _NEAR)
            j = max(int(np.ceil((low - _NEAR) / step)), m - 1)
            if j * step > last_allowed or _scale_bound(distances, lags, step, b, first_block[clip], size) > best:
                continue
            if not ready:
                origin = max(0, low - int(np.ceil((m - 1) * fast)))
                _squares(base[:, start:end], query, origin, low, min(high + 1, end - start), slow, fast, scratch)
                ready = True
            while j * step <= last_allowed:
                p = j * step
                taken = False
                for e in range(len(barred)):
                    taken = taken or (barred[e] == clip and windows[e, 0] < p < windows[e, 1])
                if not taken:
                    score = _score(scratch, jumps[start:end], origin, j, step, order, best)
                    if score < best or (best_clip < 0 and score <= best):
                        best, best_clip, best_scale, best_pose = score, clip, s, j
                j += 1
    return best, best_clip, best_scale, best_pose
