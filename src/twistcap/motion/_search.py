"""Kernels of the exact search for the best match; see `matching`.

Three lower bounds exclude most candidates. All are rounded down, so that the result is exact:

1. A block of consecutive poses is inside a tube around a straight line. The query's distance from the tubes excludes
   whole blocks.
2. Between stored poses a and b, ``|Θ − P| ≥ (|Θ−a| + |Θ−b| − |b−a|)/2``. Distances to stored poses serve all scales, so
   that a bound for one pose and scale costs m comparisons.
3. At a fraction f from a to b, ``|Θ − P|² = (1−f)|Θ−a|² + f|Θ−b|² − f(1−f)|b−a|²``: the distance itself, in float32.

The remaining candidates are summed in float64 from the angles. Coordinates are rows, padded with rows of zeros to a
multiple of four.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32, Int

BLOCK = 8  # poses whose neighbourhood is bounded by one tube
FEW = 256  # blocks that are all searched: for so few, bounds save no time
_TILE = 512  # poses whose distances are held at a time
_GROUP = 512  # blocks of which the one with the least bound is searched first
_GAP = 4  # blocks that are searched with their neighbours though bounds exclude them, which is cheaper than a new tile
_LOSS = np.float32(4e-6)  # relative, above the rounding of sums in float32
_SLACK = 1e-6  # rad, above the rounding of the bounds
_NEAR = 1e-8  # poses, above the rounding of positions in a clip

ClipArrays = tuple[Float32, Float32, Int]
"""Weighted coordinates (K, N) of all clips, the distance (N,) of each pose from the next one of its clip, rounded up,
0 at its end, and the starts of clips (C + 1,)."""


@njit(cache=True, nogil=True)
def prepared(query: Float, factors: Float, width: int) -> tuple[Float, bool]:
    """(m, width) the query (m, K) unwrapped as by `library.unwrapped`, weighted, the latest pose first; then zeros.

    Also whether all of it is finite.
    """
    m, K = query.shape
    out = np.zeros((m, width))
    for k in range(K):
        turn, total = 0.0, 0.0
        for i in range(m):
            if i > 0:
                turn -= 2.0 * np.pi * np.round((query[i, k] - query[i - 1, k]) / (2.0 * np.pi))
            out[m - 1 - i, k] = query[i, k] + turn
            total += query[i, k] + turn
        whole = 2.0 * np.pi * np.round(total / m / (2.0 * np.pi))
        for i in range(m):
            out[i, k] = (out[i, k] - whole) * factors[k]
    return out, np.isfinite(out.sum())


@njit(cache=True, nogil=True)
def tubes(base: Float32, begin: Int, end: Int) -> tuple[Float32, Float32, Float32, Float32]:
    """Tubes around stretches of poses begin … end − 1 of base (K, N).

    Returns:
        Middles and unit directions (K, B) and half lengths (B,) of straight lines along the motion, and the radii (B,)
        of the tubes about them that hold all poses, and so all interpolated ones.
    """
    K, B = len(base), len(begin)
    middles, lines = np.empty((K, B), np.float32), np.zeros((K, B), np.float32)
    halves, radii = np.empty(B, np.float32), np.empty(B, np.float32)
    for b in range(B):
        poses = base[:, begin[b] : end[b]]
        length = np.sqrt(np.sum((poses[:, -1] - poses[:, 0]).astype(np.float64) ** 2))
        for k in range(K):
            middles[k, b] = 0.5 * (poses[k].min() + poses[k].max())
            if length > 0.0:
                lines[k, b] = (poses[k, -1] - poses[k, 0]) / length
        half, radius = 0.0, 0.0
        for i in range(poses.shape[1]):
            away = poses[:, i].astype(np.float64) - middles[:, b]
            along = np.sum(away * lines[:, b])
            half = max(half, np.abs(along))
            radius = max(radius, np.sum((away - along * lines[:, b]) ** 2))
        halves[b], radii[b] = half * (1.0 + _LOSS), np.sqrt(radius) * (1.0 + _LOSS)
    return middles, lines, halves, radii


@njit(cache=True, nogil=True)
def _add_squares(base: Float32, begin: int, end: int, pose: Float32, k: int, out: Float32) -> None:
    """Add the squared differences of coordinates k … k + 3: four at once, to store the sums less often."""
    a, b, c, d = base[k, begin:end], base[k + 1, begin:end], base[k + 2, begin:end], base[k + 3, begin:end]
    x, y, z, w = pose[k], pose[k + 1], pose[k + 2], pose[k + 3]
    for i in range(len(out)):
        first = (a[i] - x) * (a[i] - x) + (b[i] - y) * (b[i] - y)
        out[i] += first + ((c[i] - z) * (c[i] - z) + (d[i] - w) * (d[i] - w))


@njit(cache=True, nogil=True)
def _add_products(middles: Float32, lines: Float32, begin: int, end: int, pose: Float32, k: int, out: Float32) -> None:
    """Add coordinates k … k + 3 of the products of directions with the vectors from the pose to the middles."""
    a, b, c, d = middles[k, begin:end], middles[k + 1, begin:end], middles[k + 2, begin:end], middles[k + 3, begin:end]
    p, q, r, s = lines[k, begin:end], lines[k + 1, begin:end], lines[k + 2, begin:end], lines[k + 3, begin:end]
    x, y, z, w = pose[k], pose[k + 1], pose[k + 2], pose[k + 3]
    for i in range(len(out)):
        first = (a[i] - x) * p[i] + (b[i] - y) * q[i]
        out[i] += first + ((c[i] - z) * r[i] + (d[i] - w) * s[i])


@njit(cache=True, nogil=True)
def _to_tubes(squares: Float32, along: Float32, halves: Float32, radii: Float32) -> None:
    """Distances to tubes, written into `squares`, from squared distances to their middles and distances along them."""
    for i in range(len(squares)):
        beyond = max(np.float32(0.0), np.abs(along[i]) - halves[i])
        lost = np.float32(4.0) * _LOSS * squares[i]
        squared = max(np.float32(0.0), squares[i] - along[i] * along[i] + beyond * beyond - lost)
        squares[i] = max(np.float32(0.0), np.sqrt(squared) - radii[i])


@njit(cache=True, nogil=True)
def tube_distances(
    middles: Float32, lines: Float32, halves: Float32, radii: Float32, query: Float32, lags: Int
) -> Float32:  # fmt: skip
    """(L, B) distances, rounded down, of the query poses (m, K), the latest first, at L lags from tubes of `tubes`."""
    B = len(radii)
    out, along = np.zeros((len(lags), B), np.float32), np.empty(_TILE, np.float32)
    for begin in range(0, B, _TILE):
        end = min(begin + _TILE, B)
        for lag in range(len(lags)):
            row, on = out[lag, begin:end], along[: end - begin]
            on[:] = 0.0
            for k in range(0, len(middles), 4):
                _add_squares(middles, begin, end, query[lags[lag]], k, row)
                _add_products(middles, lines, begin, end, query[lags[lag]], k, on)
            _to_tubes(row, on, halves[begin:end], radii[begin:end])
    return out


@njit(cache=True, nogil=True)
def block_bounds(away: Float32, lags: Int, slow: float, fast: float, first_block: Int) -> Float32:
    """(B,) lower bound of the sum of norms of matches that end in each block (bound 1).

    Args:
        away: (L, B), of `tube_distances`.
        lags: (L,) of the query poses that are used; fewer make a lower bound.
        slow, fast: least and greatest step of the scales, poses per frame.
        first_block: (B,) first block of each block's clip.
    """
    B = away.shape[1]
    out = np.zeros(B, np.float32)
    for lag in range(len(lags)):
        v = lags[lag]
        # The pose at this lag is `slow·v` to `fast·v` poses before one in the block.
        nearest, farthest = int(np.floor(slow * v / BLOCK)), int(np.ceil(fast * v / BLOCK))
        for b in range(B):
            low = away[lag, max(first_block[b], b - nearest)]
            for c in range(max(first_block[b], b - farthest), b - nearest):
                low = min(low, away[lag, c])
            out[b] += low
    return out


@njit(cache=True, nogil=True)
def _distances(
    base: Float32, query: Float32, jumps: Float32, clip: tuple[int, int], first: int, width: int, squares: Float32,
    bounds: Float32,
) -> None:  # fmt: skip
    """Squared distances (m, W) of the query poses to `width` poses from `first` on, and bound 2 of each.

    Base is (K, N), jumps (N,) the lengths from pose to pose. Outside the clip, start … end − 1, both are infinite.
    """
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
    """Bound 2 of matches that end between pose halo + i and the next, for one scale, into out (n,)."""
    out[:] = 0.0
    for v in range(len(bounds)):
        back = v * step
        near, far = int(np.floor(back + _NEAR)), int(np.ceil(back - _NEAR))
        one = bounds[v, halo - near : halo - near + len(out)]
        other = bounds[v, halo - far : halo - far + len(out)]
        for i in range(len(out)):
            least = one[i] if one[i] < other[i] else other[i]
            out[i] += least if least > 0.0 else np.float32(0.0)


@njit(cache=True, nogil=True)
def _below(
    squares: Float32, jumps: Float32, start: int, first: int, j: int, step: float, limit: float
) -> bool:  # fmt: skip
    """Whether pose j of a scaled clip may match better than the limit (bound 3); column 0 is its pose `first`."""
    total = 0.0
    for v in range(len(squares)):
        p = (j - v) * step
        i = int(p + _NEAR)
        f = np.float32(p - i)
        squared = squares[v, i - first]
        if f > _NEAR:
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
        i = int(p + _NEAR)
        f = p - i if p - i > _NEAR else 0.0
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

    Args:
        poses: base (K, N) and jumps (N,); asked: the query in float64 and in float32.
        steps: (S,).
        span: start and end of the clip (its poses are start … end − 1), and low and high, counted from its start.
        ahead: frames that the clip must go on after a match.
        excluded: the clip's number, and intervals as for `search`.
        room: for squares and bounds of (m, halo + _TILE + 2) values.
        limit: the best so far, and the slack of the bounds.
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
            j = max(int(np.ceil((low + i - _NEAR) / step)), m - 1)
            while j * step < low + i + 1 - _NEAR and (j + ahead) * step <= N - 1 + _NEAR:
                if _below(squares, jumps, start, low - halo, j, step, best + slack) and not _excluded(
                    clip, j * step, clips, windows
                ):
                    value = score(base, query, start, j, step, best)
                    if value < best:
                        best, best_scale, best_pose = value, s, j
                j += 1
    return best, best_scale, best_pose


@njit(cache=True, nogil=True)
def _run(least: Float32, clip_of: Int, b: int, limit: float) -> int:
    """One after the last of the blocks from b on that are searched together: those below the limit, with small gaps."""
    last = b + 1
    for c in range(b + 1, min(len(least), b + _TILE // BLOCK) if least[b] <= limit else b):
        if clip_of[c] != clip_of[b] or c - last > _GAP:
            break
        if least[c] <= limit:
            last = c + 1
    return last


@njit(cache=True, nogil=True)
def search(
    clips: ClipArrays, query: Float, steps: Float, blocks: tuple[Float32, Int, Int], ahead: float,
    excluded: tuple[Int, Float], limit: float,
) -> tuple[float, int, int, int]:  # fmt: skip
    """The least sum of norms below a limit, its clip, scale and pose j of the scaled clip; clip −1 if there is none.

    Args:
        clips: the library.
        query: (m, K) weighted, the latest first.
        steps: (S,) poses per frame of the query, 1/s.
        blocks: (B,) bound of each block, of `block_bounds`, the first block of its clip, and the clip.
        ahead: frames that the clip must go on after a match.
        excluded: (E,) clips, and (E, 2) positions in them between which no match may end.
        limit: worse matches are not searched.
    """
    (base, jumps, starts), (least, first_block, clip_of) = clips, blocks
    m, B = len(query), len(least)
    rounded = query.astype(np.float32)
    slack = m * _SLACK * (1.0 + np.abs(query).max()) * np.sqrt(query.shape[1])
    halo = int(np.ceil((m - 1) * steps.max())) + 1
    room = (np.empty((m, halo + _TILE + 2), np.float32), np.empty((m, halo + _TILE + 2), np.float32))
    best, best_clip, best_scale, best_pose = limit, -1, -1, -1
    # The block of least bound of each group goes first, so that most others are excluded early.
    leads = -(-B // _GROUP) if B > FEW else 0
    turn, b = 0, 0
    while b < B:
        if turn < leads:
            begin = turn * _GROUP
            b = begin + int(np.argmin(least[begin : begin + _GROUP]))
            last = b + 1
        else:
            last = _run(least, clip_of, b, best + slack)
        if least[b] <= best + slack:
            start, end = int(starts[clip_of[b]]), int(starts[clip_of[b] + 1])
            low = (b - first_block[b]) * BLOCK
            high = min(low + (last - b) * BLOCK, end - start)
            span, not_there = (start, end, low, high), (clip_of[b], excluded[0], excluded[1])
            value, scale, pose = _stretch(
                (base, jumps), (query, rounded), steps, span, ahead, not_there, room, (best, slack)
            )
            if scale >= 0:
                best, best_clip, best_scale, best_pose = value, clip_of[b], scale, pose
        turn += 1
        b = last if turn > leads else 0
    return best, best_clip, best_scale, best_pose


@njit(cache=True, nogil=True)
def nearby(
    base: Float32, query: Float, steps: Float, start: int, end: int, low: float, high: float, ahead: float
) -> tuple[float, int, int]:  # fmt: skip
    """The best match that ends at positions low … high of the clip start … end − 1: score, scale and pose j."""
    m, N = len(query), end - start
    best, best_scale, best_pose = np.inf, -1, -1
    for s in range(len(steps)):
        step = steps[s]
        j = max(int(np.ceil((low - _NEAR) / step)), m - 1)
        while j * step <= high + _NEAR and (j + ahead) * step <= N - 1 + _NEAR:
            value = score(base, query, start, j, step, best)
            if value < best:
                best, best_scale, best_pose = value, s, j
            j += 1
    return best, best_scale, best_pose
