"""Normal equations of surface-point rows, accumulated per segment and projected once.

A row is a residual r of a surface point x with gradient g = ∂r/∂x. On the twist of segment s, which carries the share
w_s of the point, its derivative is ``w_s [x_s × g, g]``, so 6×6 blocks gather everything and no row ever sees the
skeleton; ``posed.projector`` then takes segment twists to pose coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float, Int
from twistcap.body import Posed
from twistcap.render import SurfacePoints


@dataclass(frozen=True)
class Rows:
    """Residual rows of surface points.

    Attributes:
        gradient: (N, 3) derivative of each residual by its world point.
        residual: (N,) in the term's own unit.
        weight: (N,) information 1/unit², robust weights included.
    """

    gradient: Float
    residual: Float
    weight: Float


def normal_equations(posed: Posed, points: SurfacePoints, rows: Rows) -> tuple[Float, Float]:
    """Gradient (6 + J,) and Gauss-Newton Hessian (6 + J, 6 + J) of ½ Σ weight · residual²."""
    blocks, vector = accumulate(
        posed.segment_transforms, points.segments, points.weights, points.local, rows.gradient, rows.residual,
        rows.weight,
    )  # fmt: skip
    A = posed.projector
    return A.T @ vector, A.T @ blocks @ A


@njit(cache=True, nogil=True)
def accumulate(
    transforms: Float, segments: Int, weights: Float, local: Float, gradient: Float, residual: Float, row_weight: Float
) -> tuple[Float, Float]:
    """Σ W j jᵀ (6 S, 6 S) and Σ W r j (6 S,) over rows, j the derivative by the stacked segment twists."""
    N, K = segments.shape
    S = len(transforms)
    blocks, vector = np.zeros((6 * S, 6 * S)), np.zeros(6 * S)
    j = np.zeros((K, 6))
    for n in range(N):
        W = row_weight[n]
        if W == 0.0:
            continue
        g0, g1, g2 = gradient[n, 0], gradient[n, 1], gradient[n, 2]
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        for k in range(K):
            w = weights[n, k]
            if w == 0.0:
                continue
            T = transforms[segments[n, k]]
            X = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            j[k, 0], j[k, 1], j[k, 2] = w * (Y * g2 - Z * g1), w * (Z * g0 - X * g2), w * (X * g1 - Y * g0)
            j[k, 3], j[k, 4], j[k, 5] = w * g0, w * g1, w * g2
        for k in range(K):
            if weights[n, k] == 0.0:
                continue
            a = 6 * segments[n, k]
            for p in range(6):
                Wj = W * j[k, p]
                vector[a + p] += Wj * residual[n]
                for l in range(K):
                    if weights[n, l] == 0.0:
                        continue
                    b = 6 * segments[n, l]
                    for q in range(6):
                        blocks[a + p, b + q] += Wj * j[l, q]
    return blocks, vector


def normal_equations_reference(posed: Posed, points: SurfacePoints, rows: Rows) -> tuple[Float, Float]:
    """Readable twin of `normal_equations`: stacked rows."""
    jacobian = posed.point_jacobian(points.segments, points.weights, points.local)
    J = np.einsum("ni,nid->nd", rows.gradient, jacobian)
    return J.T @ (rows.weight * rows.residual), J.T @ (rows.weight[:, None] * J)
