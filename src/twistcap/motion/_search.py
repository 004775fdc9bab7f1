"""Kernels of the exact search for the best match; see `matching`.

Two lower bounds exclude most candidates. Both are rounded down, so that the result is exact:

1. Between stored poses a and b, ``|Θ − P| ≥ (|Θ−a| + |Θ−b| − |b−a|)/2``. Distances to stored poses serve all scales, so
   that a bound for one pose and scale costs m comparisons.
2. At a fraction f from a to b, ``|Θ − P|² = (1−f)|Θ−a|² + f|Θ−b|² − f(1−f)|b−a|²``: the distance itself, in float32.

The remaining candidates are summed in float64 from the angles. Coordinates are rows, padded with rows of zeros to a
multiple of four.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32, Int

_TILE = 512  # poses whose distances are held at a time
_LOSS = np.float32(4e-6)  # relative, above the rounding of sums in float32
_SLACK = 1e-6  # rad, above the rounding of the bounds
NEAR = 1e-8  # poses, above the rounding of positions in a clip

ClipArrays = tuple[Float32, Float32, Int]
"""Weighted coordinates (K, N) of all clips, the distance (N,) of each pose from the next one of its clip, rounded up,
0 at its end, and the starts of clips (C + 1,)."""


@njit(cache=True, nogil=True)
def _add_squares(base: Float32, begin: int, end: int, pose: Float32, k: int, out: Float32) -> None:
    """Add the squared differences of coordinates k … k + 3: four at once, to store the sums less often."""
    a, b, c, d = base[k, begin:end], base[k + 1, begin:end], base[k + 2, begin:end], base[k + 3, begin:end]
    x, y, z, w = pose[k], pose[k + 1], pose[k + 2], pose[k + 3]
    for i in range(len(out)):
        first = (a[i] - x) * (a[i] - x) + (b[i] - y) * (b[i] - y)
        out[i] += first + ((c[i] - z) * (c[i] - z) + (d[i] - w) * (d[i] - w))


@njit(cache=True, nogil=True)
def _distances(
    base: Float32, query: Float32, jumps: Float32, clip: tuple[int, int], first: int, width: int, squares: Float32,
    bounds: Float32,
) -> None:  # fmt: skip
    """Squared distances (m, W) of the query poses to `width` poses from `first` on, and bound 1 of each. Base is (K,
    N), jumps (N,) the lengths from pose to pose. Outside the clip, start … end − 1, both are infinite."""
    start, end = clip
    low, high = max(0, start - first), min(width, end - first)
    squares[:, :width] = np.inf
    bounds[:, :width] = np.inf
    jump, root = jumps[first + low : first + high], np.empty(high - low, np.float32)
    for v in range(len(query)):
        row, bound = squares[v, low:high], bounds[v, low:high]
        row[:] = 0.0
        for k in range(0, len(base), 4):
            _add_squares(base, first + low, first + high, query[v], k, row)
        for i in range(len(root)):
            root[i] = np.sqrt(row[i]) * (np.float32(1.0) - _LOSS)
        for i in range(len(root) - 1):
            bound[i] = np.float32(0.5) * (root[i] + root[i + 1] - jump[i])
        if first + high == end:
            bound[-1] = root[-1]


@njit(cache=True, nogil=True)
def _summed(bounds: Float32, halo: int, step: float, out: Float32) -> None:
    """Bound 1 of matches that end between pose halo + i and the next, for one scale, into out (n,)."""
    out[:] = 0.0
    for v in range(len(bounds)):
        back = v * step
        near, far = int(np.floor(back + NEAR)), int(np.ceil(back - NEAR))
        one = bounds[v, halo - near : halo - near + len(out)]
        other = bounds[v, halo - far : halo - far + len(out)]
        for i in range(len(out)):
            least = one[i] if one[i] < other[i] else other[i]
            out[i] += least if least > 0.0 else np.float32(0.0)


@njit(cache=True, nogil=True)
def _below(squares: Float32, jumps: Float32, start: int, first: int, j: int, step: float, limit: float) -> bool:
    """Whether pose j of a scaled clip may match better than the limit (bound 2); column 0 is its pose `first`."""
    total = 0.0
    for v in range(len(squares)):
        p = (j - v) * step
        i = int(p + NEAR)
        f = np.float32(p - i)
        squared = squares[v, i - first]
        if f > NEAR:
            lost = _LOSS * (squared + squares[v, i - first + 1])
            cut = f * (np.float32(1.0) - f) * jumps[start + i] * jumps[start + i]
            squared = squared + f * (squares[v, i - first + 1] - squared) - cut - lost
        if squared > 0.0:
            total += np.sqrt(squared) * (np.float32(1.0) - _LOSS)
            if total > limit:
                return False
    return True


@njit(cache=True, nogil=True)
def score(base: Float32, query: Float, start: int, j: int, step: float, limit: float) -> float:
    """The sum of norms of pose j of the scaled clip that starts at `start`; anything above the limit if above it."""
    total = 0.0
    for v in range(len(query)):
        p = (j - v) * step
        i = int(p + NEAR)
        f = p - i if p - i > NEAR else 0.0
        i += start
        after = i + 1 if f > 0.0 else i
        squared = 0.0
        for k in range(len(base)):
            d = (1.0 - f) * base[k, i] + f * base[k, after] - query[v, k]
            squared += d * d
        total += np.sqrt(squared)
        if total > limit:
            break
    return total


@njit(cache=True, nogil=True)
def _excluded(clip: int, p: float, excluded: Int, windows: Float) -> bool:
    for e in range(len(excluded)):  # noqa: SIM110 - numba knows no any()
        if excluded[e] == clip and windows[e, 0] < p < windows[e, 1]:
            return True
    return False


@njit(cache=True, nogil=True)
def _stretch(
    poses: tuple[Float32, Float32], asked: tuple[Float, Float32], steps: Float, span: tuple[int, int, int, int],
    ahead: float, excluded: tuple[int, Int, Float], room: tuple[Float32, Float32], limit: tuple[float, float],
) -> tuple[float, int, int]:  # fmt: skip
    """The best match that ends at poses low … high of one clip, if it is better than `best`: score, scale and pose j.

    Poses are base (K, N) and jumps (N,); the query is asked in float64 and in float32. The span is start and end of the
    clip, its last pose not included, and low and high, counted from its start. Excluded are the clip's number, and
    intervals as for `search`. There is room for squares and bounds; the limit is the best so far, and their slack.
    """
    (base, jumps), (query, rounded), (squares, bounds) = poses, asked, room
    (start, end, low, high), (clip, clips, windows), (best, slack) = span, excluded, limit
    m, N, n = len(query), end - start, high - low
    halo = squares.shape[1] - _TILE - 2
    _distances(base, rounded, jumps, (start, end), start + low - halo, halo + n + 2, squares, bounds)
    best_scale, best_pose, least = -1, -1, np.empty(n, np.float32)
    for s in range(len(steps)):
        step = steps[s]
        _summed(bounds, halo, step, least)
        promising, bound = 0, np.float32(best + slack)
        for i in range(n):
            promising += least[i] <= bound
        if promising == 0:
            continue
        for i in range(n):
            if least[i] > best + slack:
                continue
            j = max(int(np.ceil((low + i - NEAR) / step)), m - 1)
            while j * step < low + i + 1 - NEAR and (j + ahead) * step <= N - 1 + NEAR:
                if _below(squares, jumps, start, low - halo, j, step, best + slack) and not _excluded(
                    clip, j * step, clips, windows
                ):
                    value = score(base, query, start, j, step, best)
                    if value < best:
                        best, best_scale, best_pose = value, s, j
                j += 1
    return best, best_scale, best_pose


@njit(cache=True, nogil=True)
def search(
    clips: ClipArrays, query: Float, steps: Float, ahead: float, excluded: tuple[Int, Float], limit: float
) -> tuple[float, int, int, int]:
    """The least sum of norms below a limit, its clip, scale and pose j of the scaled clip; clip −1 if there is none.

    The query (m, K) is weighted, the latest first, with `steps` (S,) poses per frame of it, 1/s; `ahead` frames a clip
    must go on after a match; `excluded` are clips (E,), and positions (E, 2) in them between which no match may end.
    """
    (base, jumps, starts), m = clips, len(query)
    asked = (query, query.astype(np.float32))
    slack = m * _SLACK * (1.0 + np.abs(query).max()) * np.sqrt(query.shape[1])
    halo = int(np.ceil((m - 1) * steps.max())) + 1
    room = (np.empty((m, halo + _TILE + 2), np.float32), np.empty((m, halo + _TILE + 2), np.float32))
    best, best_clip, best_scale, best_pose = limit, -1, -1, -1
    for clip in range(len(starts) - 1):
        start, end = int(starts[clip]), int(starts[clip + 1])
        for low in range(0, end - start, _TILE):
            span = (start, end, low, min(low + _TILE, end - start))
            value, scale, pose = _stretch(
                (base, jumps), asked, steps, span, ahead, (clip, excluded[0], excluded[1]), room, (best, slack)
            )
            if scale >= 0:
                best, best_clip, best_scale, best_pose = value, clip, scale, pose
    return best, best_clip, best_scale, best_pose


def score_reference(base: Float32, query: Float, start: int, j: int, step: float, limit: float) -> float:
    """Readable twin of `score`; infinite above the limit."""
    places = (j - np.arange(len(query))) * step
    poses = [np.interp(places, np.arange(base.shape[1] - start), row[start:]) for row in base.astype(float)]
    total = float(np.linalg.norm(np.array(poses).T - query, axis=1).sum())
    return total if total <= limit else np.inf


def search_reference(
    clips: ClipArrays, query: Float, steps: Float, ahead: float, excluded: tuple[Int, Float], limit: float
) -> tuple[float, int, int, int]:
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
