"""Segments that lie off as a whole: what their offsets add to the variance of a term's gradient."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Float
from twistcap.render import SurfaceArrays
from twistcap.terms.accumulate import dense_rows


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def add_offset_variance(
    surface: SurfaceArrays, gradient: Float, row_weight: Float, projector: Float, variance: Float
) -> None:
    """Add to `variance` (6 + J, 6 + J) that of the gradient of a term in which each segment has an offset of its own.

    Args:
        surface: N points. Offsets have 1 m standard deviation in all directions; a blended point has a mean of them.
        gradient, row_weight: (R N, 3) and (R N,) of the term's rows; row n is of point n mod N.
        projector: (6 S, 6 + J) from a pose step to the twists of all segments.
        variance: is changed in place.
    """
    transforms, segments, weights, local = surface
    N, K = segments.shape
    S, D = len(transforms), projector.shape[1]
    blocks, touched = np.zeros((S, S, 6, 3)), np.zeros((S, S), dtype=np.bool_)  # [offset of b, twist of a]
    j, n = np.zeros(6), -1
    for row in range(len(row_weight)):
        n = n + 1 if n + 1 < N else 0
        W = row_weight[row]
        if W == 0.0:
            continue
        g0, g1, g2 = gradient[row, 0], gradient[row, 1], gradient[row, 2]
        for k in range(K):
            w, a = weights[n, k], segments[n, k]
            if w == 0.0:
                continue
            T, x, y, z = transforms[a], local[n, 0], local[n, 1], local[n, 2]
            X = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            j[0], j[1], j[2] = Y * g2 - Z * g1, Z * g0 - X * g2, X * g1 - Y * g0
            j[3], j[4], j[5] = g0, g1, g2
            for m in range(K):
                shared, b = W * w * weights[n, m], segments[n, m]
                if shared == 0.0:
                    continue
                touched[b, a] = True
                out = blocks[b, a]
                for p in range(6):
                    out[p, 0] += shared * j[p] * g0
                    out[p, 1] += shared * j[p] * g1
                    out[p, 2] += shared * j[p] * g2
    for b in range(S):
        by_offset = np.zeros((3, D))
        for a in range(S):
            if touched[b, a]:
                for p in range(6):
                    for i in range(3):
                        for d in range(D):
                            by_offset[i, d] += blocks[b, a, p, i] * projector[6 * a + p, d]
        for i in range(3):
            for c in range(D):
                if by_offset[i, c] != 0.0:
                    for d in range(D):
                        variance[c, d] += by_offset[i, c] * by_offset[i, d]


def add_offset_variance_reference(
    surface: SurfaceArrays, gradient: Float, row_weight: Float, projector: Float, variance: Float
) -> None:
    """Readable twin of `add_offset_variance`: the derivative of each row by the pose, times that by the offset."""
    transforms, segments, weights, local = surface
    rows = np.arange(len(row_weight), dtype=np.int32)
    by_pose = dense_rows(surface, gradient, rows).reshape(len(rows), -1) @ projector
    for s in range(len(transforms)):
        of_segment = row_weight * np.sum(weights * (segments == s), axis=1)[rows % len(local)]
        by_offset = by_pose.T @ (of_segment[:, None] * gradient)
        variance += by_offset @ by_offset.T
