"""Errors that the points of a view or of a segment share, and the variance of the gradient that they make."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Int
from twistcap.render import SurfaceArrays
from twistcap.terms.accumulate import dense_rows, skinned_point

NARROWEST = 0.01
"""m, least root mean square distance of a segment's points from their middle."""


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def _moments(surface: SurfaceArrays, gradient: Float, row_weight: Float) -> tuple[Float, Bool, Float]:
    """What segment b's displacements make of the gradient by segment a's twist, if they are affine.

    Returns:
        (S, S, 6, 12) by b and a: of its shift, and of the rates of the displacement by x, y and z; (S, S) where it is
        not 0; (S, 5) mass, sum of places and sum of their squares of the points of b.
    """
    transforms, segments, weights, local = surface
    N, K = segments.shape
    S = len(transforms)
    blocks, touched, places = np.zeros((S, S, 6, 12)), np.zeros((S, S), dtype=np.bool_), np.zeros((S, 5))
    j, shared, n = np.zeros(6), np.zeros(12), -1
    for row in range(len(row_weight)):
        n = n + 1 if n + 1 < N else 0
        W = row_weight[row]
        if W == 0.0:
            continue
        g0, g1, g2 = gradient[row, 0], gradient[row, 1], gradient[row, 2]
        x, y, z = skinned_point(transforms, segments, weights, local, n)
        shared[0], shared[1], shared[2] = W * g0, W * g1, W * g2
        for i in range(3):
            shared[3 + i], shared[6 + i], shared[9 + i] = x * shared[i], y * shared[i], z * shared[i]
        for k in range(K):
            w, a = weights[n, k], segments[n, k]
            if w == 0.0:
                continue
            T, X, Y, Z = transforms[a], local[n, 0], local[n, 1], local[n, 2]
            u = T[0, 0] * X + T[0, 1] * Y + T[0, 2] * Z + T[0, 3]
            v = T[1, 0] * X + T[1, 1] * Y + T[1, 2] * Z + T[1, 3]
            t = T[2, 0] * X + T[2, 1] * Y + T[2, 2] * Z + T[2, 3]
            j[0], j[1], j[2], j[3], j[4], j[5] = v * g2 - t * g1, t * g0 - u * g2, u * g1 - v * g0, g0, g1, g2
            own = places[a]
            own[0], own[1], own[2], own[3] = own[0] + w, own[1] + w * x, own[2] + w * y, own[3] + w * z
            own[4] += w * (x * x + y * y + z * z)
            for m in range(K):
                both, b = w * weights[n, m], segments[n, m]
                if both == 0.0:
                    continue
                touched[b, a] = True
                out = blocks[b, a]
                for p in range(6):
                    for c in range(12):
                        out[p, c] += both * j[p] * shared[c]
    return blocks, touched, places


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def add_shared_variance(
    surface: SurfaceArrays, gradient: Float, row_weight: Float, projector: Float, variance: Float
) -> None:
    """Add to `variance` (6 + J, 6 + J) that of the gradient of a term's rows whose points are displaced together.

    All of them are shifted, and those of each segment once more; beside that a segment's displacement grows from its
    points' middle by a random matrix. Shifts have 1 m standard deviation in all directions, and so has what the matrix
    makes at the points' root mean square distance. A blended point has a mean of its segments' displacements.
    `projector` (6 S, 6 + J) leads from a pose step to the twists of all segments.
    """
    blocks, touched, places = _moments(surface, gradient, row_weight)
    S, D = len(blocks), projector.shape[1]
    whole, by, active = np.zeros((D, 3)), np.zeros((D, 12)), np.zeros(D, np.int32)
    for b in range(S):
        if places[b, 0] == 0.0:
            continue
        middle, scale = _middle_and_scale(places[b])
        count = _by_pose(blocks[b], touched[b], projector, by, active)
        for k in range(count):
            own = by[active[k]]
            for i in range(3):
                whole[active[k], i] += own[i]
                for axis in range(3):
                    own[3 + 3 * axis + i] = scale * (own[3 + 3 * axis + i] - middle[axis] * own[i])
        for k in range(count):
            own = by[active[k]]
            for m in range(k + 1):
                other, total = by[active[m]], 0.0
                for c in range(12):
                    total += own[c] * other[c]
                variance[active[k], active[m]] += total
                if m < k:
                    variance[active[m], active[k]] += total
    variance += whole @ whole.T


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _by_pose(blocks: Float, touched: Bool, projector: Float, out: Float, active: Int) -> int:
    """Rows of `out` (6 + J, 12): `blocks` (S, 6, 12) of twists taken to a pose step, where they are not 0.

    Returns how many rows that are; their numbers are written into `active`.
    """
    count = 0
    for d in range(len(out)):
        row, found = out[d], False
        row[:] = 0.0
        for a in range(len(blocks)):
            if not touched[a]:
                continue
            for p in range(6):
                rate = projector[6 * a + p, d]
                if rate != 0.0:
                    found = True
                    for c in range(12):
                        row[c] += blocks[a, p, c] * rate
        if found:
            active[count] = d
            count += 1
    return count


@njit(cache=True, nogil=True, inline="always")
def _middle_and_scale(places: Float) -> tuple[tuple[float, float, float], float]:
    """Mean of places, m, and 1 over their root mean square distance from it, from their sums (5,)."""
    n = places[0]
    x, y, z = places[1] / n, places[2] / n, places[3] / n
    return (x, y, z), 1.0 / max(np.sqrt(max(places[4] / n - x * x - y * y - z * z, 0.0)), NARROWEST)


def add_shared_variance_reference(
    surface: SurfaceArrays, gradient: Float, row_weight: Float, projector: Float, variance: Float
) -> None:
    """Readable twin of `add_shared_variance`: the derivative of each row by the pose, times that by each error."""
    transforms, segments, weights, local = surface
    rows = np.arange(len(row_weight), dtype=np.int32)
    places = np.sum(weights[..., None] * _each_segments(transforms, segments, local), axis=1)[rows % len(local)]
    by_pose = row_weight[:, None] * (dense_rows(surface, gradient, rows).reshape(len(rows), -1) @ projector)
    by_shift = by_pose.T @ gradient
    variance += by_shift @ by_shift.T
    for s in range(len(transforms)):
        own = np.sum(weights * (segments == s), axis=1)[rows % len(local)]
        if not (own * row_weight).any():
            continue
        mass = own * (row_weight != 0.0)
        apart = places - mass @ places / mass.sum()
        apart /= max(np.sqrt(mass @ np.sum(apart**2, axis=1) / mass.sum()), NARROWEST)
        for grown in (np.ones(len(rows)), *apart.T):
            by_error = by_pose.T @ ((own * grown)[:, None] * gradient)
            variance += by_error @ by_error.T


def _each_segments(transforms: Float, segments: Int, local: Float) -> Float:
    """(N, K, 3) where each of their segments alone would carry points."""
    T = transforms[segments]
    return (T[..., :3, :3] @ local[:, None, :, None])[..., 0] + T[..., :3, 3]
