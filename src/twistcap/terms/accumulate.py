"""Normal equations of surface-point rows, accumulated per segment and projected once.

A row is a residual r of a surface point x with gradient g = ∂r/∂x. Its derivative by the twist of segment s, to which
the point is bound with weight w_s, is ``w_s [x_s × g, g]``. So rows are summed into 6×6 blocks, and
``posed.projector`` takes segment twists to pose coordinates once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numba import njit

from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.camera.projection import NEAR
from twistcap.render import SurfaceArrays, SurfacePoints
from twistcap.terms.protocols import Quadratic

TWIST_WIDTH = 8  # twists padded from 6, to align the rows of a block with vector registers


@dataclass(frozen=True)
class Rows:
    """Residuals (R N,) of N surface points, R for each: row n belongs to point n mod N. `gradient` (R N, 3) is their
    derivative by the world points, `weight` (R N,) their information, 1/unit², times the robust weights.
    """

    gradient: Float
    residual: Float
    weight: Float


class SegmentSums:
    """Energy and normal equations of any number of point terms at one pose, by segment twists."""

    def __init__(self, posed: Posed) -> None:
        S = len(posed.body.segment_names)
        self.posed, self.value = posed, 0.0
        self.blocks, self.vector = np.zeros((S, S, 6, TWIST_WIDTH)), np.zeros((S, 6))

    def add_rows(self, energy: float, points: SurfacePoints, rows: Rows) -> None:
        self.value += energy
        surface = points.bound_to(self.posed)
        accumulate(surface, rows.gradient, rows.residual, rows.weight, self.blocks, self.vector)

    def quadratic(self) -> Quadratic:
        """The sums as a quadratic of the pose step."""
        A, S = self.posed.projector, len(self.vector)
        upper = self.blocks[..., :6].transpose(0, 2, 1, 3).reshape(6 * S, 6 * S)
        half = A.T @ (upper @ A)
        return Quadratic(self.value, A.T @ self.vector.ravel(), half + half.T)


class PointTerm:
    """A term of surface points, given by its rows. Subclasses may override `energy` by a kernel that makes no rows."""

    def rows(self, posed: Posed) -> tuple[float, SurfacePoints, Rows]:
        """Energy, the N points and their rows at a pose."""
        raise NotImplementedError

    def energy(self, posed: Posed) -> float:
        """Energy at a pose."""
        return self.rows(posed)[0]

    def masked(self, by_part: Float) -> Self:
        """The same term with the information of each point times the factor (S,) of its part."""
        fields: Any = self  # every point term is a dataclass with points and their weights
        return replace(fields, weight=fields.weight * by_part[fields.points.part])

    def linearize(self, posed: Posed) -> Quadratic:
        """Gauss-Newton quadratic at a pose."""
        sums = SegmentSums(posed)
        sums.add_rows(*self.rows(posed))
        return sums.quadratic()


def normal_equations(
    posed: Posed, points: SurfacePoints, rows: Rows, beside: Float | None = None
) -> tuple[Float, Float]:
    """Gradient (6 + J + C,) and Gauss-Newton Hessian of ½ Σ weight · residual² by the pose's step and C more unknowns.

    `beside` (R N, C) are the derivatives of the residuals by these; NaN is allowed in rows of weight 0.
    """
    sums = SegmentSums(posed)
    sums.add_rows(0.0, points, rows)
    quadratic = sums.quadratic()
    if beside is None:
        return quadratic.gradient, quadratic.hessian
    used = rows.weight != 0.0
    beside, residual = np.where(used[:, None], beside, 0.0), np.where(used, rows.residual, 0.0)
    cross = np.zeros((len(sums.vector), 6, beside.shape[1]))
    accumulate_beside(points.bound_to(posed), rows.gradient, rows.weight, beside, cross)
    weighted = beside.T * rows.weight
    corner = posed.projector.T @ cross.reshape(-1, beside.shape[1])
    gradient = np.concatenate([quadratic.gradient, weighted @ residual])
    return gradient, np.block([[quadratic.hessian, corner], [corner.T, weighted @ beside]])


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, inline="always")
def skinned_point(transforms: Float, segments: Int, weights: Float, local: Float, n: int) -> tuple[float, float, float]:
    """World position of surface point n."""
    x, y, z = local[n, 0], local[n, 1], local[n, 2]
    X, Y, Z = 0.0, 0.0, 0.0
    for k in range(segments.shape[1]):
        w = weights[n, k]
        if w == 0.0:
            continue
        T = transforms[segments[n, k]]
        X += w * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3])
        Y += w * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3])
        Z += w * (T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3])
    return X, Y, Z


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"}, inline="always")
def projected_point(
    P: Float, transforms: Float, segments: Int, weights: Float, local: Float, n: int
) -> tuple[float, float, float]:
    """Pixel (x, y) and inverse depth (1/m) of surface point n; inverse depth 0 where it is behind the camera."""
    X, Y, Z = skinned_point(transforms, segments, weights, local, n)
    depth = P[2, 0] * X + P[2, 1] * Y + P[2, 2] * Z + P[2, 3]
    if depth < NEAR:
        return 0.0, 0.0, 0.0
    w = 1.0 / depth
    x = (P[0, 0] * X + P[0, 1] * Y + P[0, 2] * Z + P[0, 3]) * w
    return x, (P[1, 0] * X + P[1, 1] * Y + P[1, 2] * Z + P[1, 3]) * w, w


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def accumulate(
    surface: SurfaceArrays, gradient: Float, residual: Float, row_weight: Float, blocks: Float, vector: Float
) -> None:
    """Add W j jᵀ to blocks (S, S, 6, 8) and W r j to vector (S, 6), j a row's derivative by its segments' twists.

    Row n of (R N,) is of point n mod N. Only blocks above the diagonal are summed, and half of those on it: with its
    transpose the sum is complete. Flat indices are faster than nested ones.
    """
    transforms, segments, weights, local = surface
    N, K = segments.shape
    S = len(transforms)
    j, own = np.zeros((K, 6)), np.zeros(K, dtype=np.int64)
    T, out = transforms.reshape(-1), blocks.reshape(-1)
    n = -1
    for row in range(len(residual)):
        n = n + 1 if n + 1 < N else 0
        W = row_weight[row]
        if W == 0.0:
            continue
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        g0, g1, g2, Wr = gradient[row, 0], gradient[row, 1], gradient[row, 2], W * residual[row]
        count = 0
        for k in range(K):
            w = weights[n, k]
            if w == 0.0:
                continue
            s = np.int64(segments[n, k])
            o = 16 * s
            X = T[o] * x + T[o + 1] * y + T[o + 2] * z + T[o + 3]
            Y = T[o + 4] * x + T[o + 5] * y + T[o + 6] * z + T[o + 7]
            Z = T[o + 8] * x + T[o + 9] * y + T[o + 10] * z + T[o + 11]
            f0, f1, f2 = w * g0, w * g1, w * g2
            j[count, 0], j[count, 1], j[count, 2] = Y * f2 - Z * f1, Z * f0 - X * f2, X * f1 - Y * f0
            j[count, 3], j[count, 4], j[count, 5] = f0, f1, f2
            for p in range(6):
                vector[s, p] += Wr * j[count, p]
            own[count] = s
            count += 1
        for b in range(count):
            j0, j1, j2, j3, j4, j5 = j[b, 0], j[b, 1], j[b, 2], j[b, 3], j[b, 4], j[b, 5]
            for a in range(count):
                if own[b] < own[a]:
                    continue
                half = 0.5 * W if a == b else W
                base = (own[a] * S + own[b]) * 6 * TWIST_WIDTH
                for p in range(6):
                    Wj, o = half * j[a, p], base + p * TWIST_WIDTH
                    out[o] += Wj * j0
                    out[o + 1] += Wj * j1
                    out[o + 2] += Wj * j2
                    out[o + 3] += Wj * j3
                    out[o + 4] += Wj * j4
                    out[o + 5] += Wj * j5


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"}, error_model="numpy")
def accumulate_beside(surface: SurfaceArrays, gradient: Float, row_weight: Float, beside: Float, cross: Float) -> None:
    """Add W j cᵀ to cross (S, 6, C), j as in `accumulate` and c the row's derivatives (R N, C) by other unknowns."""
    transforms, segments, weights, local = surface
    N, K = segments.shape
    for row in range(len(row_weight)):
        n, W = row % N, row_weight[row]
        if W == 0.0:
            continue
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        for k in range(K):
            w = weights[n, k] * W
            if w == 0.0:
                continue
            s = segments[n, k]
            T = transforms[s]
            X = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            f0, f1, f2 = w * gradient[row, 0], w * gradient[row, 1], w * gradient[row, 2]
            by_twist = (Y * f2 - Z * f1, Z * f0 - X * f2, X * f1 - Y * f0, f0, f1, f2)
            for p in range(6):
                for c in range(beside.shape[1]):
                    cross[s, p, c] += by_twist[p] * beside[row, c]


def dense_rows(surface: SurfaceArrays, gradient: Float, used: Int) -> Float:
    """(U, S, 6) derivative by every segment's twist of the rows (U,) that are used."""
    transforms, segments, weights, local = surface
    n = used % len(local)
    out = np.zeros((len(used), len(transforms), 6))
    for k in range(segments.shape[1]):
        T = transforms[segments[n, k]]
        x, g = (T[:, :3, :3] @ local[n, :, None])[..., 0] + T[:, :3, 3], gradient[used]
        by_twist = weights[n, k, None] * np.concatenate([np.cross(x, g), g], axis=1)
        np.add.at(out, (np.arange(len(used)), segments[n, k]), by_twist)
    return out


def accumulate_reference(
    surface: SurfaceArrays, gradient: Float, residual: Float, row_weight: Float, blocks: Float, vector: Float
) -> None:
    """Readable twin of `accumulate`: dense rows."""
    used = np.flatnonzero(row_weight).astype(np.int32)
    j, W, S = dense_rows(surface, gradient, used), row_weight[used], len(vector)
    vector += np.einsum("r,rsi->si", W * residual[used], j)
    kept = np.triu(np.ones((S, S))) - 0.5 * np.eye(S)
    blocks[..., :6] += kept[:, :, None, None] * np.einsum("r,rai,rbj->abij", W, j, j)


def accumulate_beside_reference(
    surface: SurfaceArrays, gradient: Float, row_weight: Float, beside: Float, cross: Float
) -> None:
    """Readable twin of `accumulate_beside`."""
    used = np.flatnonzero(row_weight).astype(np.int32)
    cross += np.einsum("r,rsi,rc->sic", row_weight[used], dense_rows(surface, gradient, used), beside[used])


def skinned_point_reference(
    transforms: Float, segments: Int, weights: Float, local: Float, n: int
) -> tuple[float, float, float]:
    """Readable twin of `skinned_point`."""
    x, y, z, _ = np.sum(weights[n, :, None] * (transforms[segments[n]] @ np.append(local[n], 1.0)), axis=0)
    return x, y, z


def projected_point_reference(
    P: Float, transforms: Float, segments: Int, weights: Float, local: Float, n: int
) -> tuple[float, float, float]:
    """Readable twin of `projected_point`."""
    x, y, depth = P @ np.array([*skinned_point_reference(transforms, segments, weights, local, n), 1.0])
    return (x / depth, y / depth, 1.0 / depth) if depth >= NEAR else (0.0, 0.0, 0.0)
