"""Rows of surface points by the twist and the stretch of each segment, summed into blocks by pairs of segments.

A residual r with gradient g = ∂r/∂x has, on segment s that carries the fraction w_s of the point, eleven derivatives:
six by its twist, ``w_s [x_s × g, g]``, three by a shift of its rest points, and two by their stretch along and across
its axis a from its origin, all of them rotated as skinning rotates the point: with ``t = Σ_k w_k R_kᵀ g``,
``w_s [t, (a·l)(a·t), l·t − (a·l)(a·t)]``, l the rest point from the origin. Rows do not depend on the skeleton or on a
shape parameter; one projection of each frame's sums gives both.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.body.shape import RestMotion, carried
from twistcap.render import SurfacePoints

WIDTH = 11
"""Derivatives by each segment: twist (6), shift (3), stretch along and across (2)."""


Derivatives = tuple[Int, Float]
"""Segments (N, K) that carry the points of N residuals, -1 where there is none; derivatives by them (N, K, 11)."""


def derivatives(posed: Posed, motion: RestMotion, points: SurfacePoints, gradient: Float) -> Derivatives:
    """Of N points whose residuals have gradients (R N, 3) by them, row n of point n mod N."""
    return segment_rows(*points.bound_to(posed), motion.origins, motion.axes, gradient)


class FrameSums:
    """Gradient and Gauss-Newton matrix of a frame's own rows, by its S segments."""

    def __init__(self, posed: Posed, motion: RestMotion) -> None:
        S = len(posed.body.segment_names)
        self.posed, self.motion = posed, motion
        self.blocks, self.vector = np.zeros((S, S, WIDTH, WIDTH)), np.zeros((S, WIDTH))

    def add(self, rows: Derivatives, weight: Float, residual: Float) -> None:
        """Add rows of weights (N,) and residuals (N,)."""
        add_products(*rows, *rows, weight, self.blocks)
        add_pulls(*rows, weight * residual, self.vector)

    def projected(self) -> tuple[Float, Float]:
        """Gradient (6 + J + K,) and matrix by the pose step and the K shape parameters."""
        A = projection(self.posed, self.motion)
        return A.T @ self.vector.ravel(), A.T @ flat(self.blocks) @ A


def flat(blocks: Float) -> Float:
    """Blocks (S, S, 11, 11) as one matrix (11 S, 11 S)."""
    S = len(blocks)
    return blocks.transpose(0, 2, 1, 3).reshape(S * WIDTH, S * WIDTH)


def projection(posed: Posed, motion: RestMotion) -> Float:
    """(11 S, 6 + J + K) from a pose step and the shape parameters to the twist, shift and stretch of each segment."""
    S, D, K = len(posed.body.segment_names), posed.body.dof, len(motion.joints)
    out = np.zeros((S, WIDTH, D + K))
    out[:, :6, :D] = posed.projector.reshape(S, 6, D)
    out[:, 3:6, D:] = carried(posed, motion.joints).transpose(1, 2, 0)
    out[:, 6:9, D:] = motion.shifts.transpose(1, 2, 0)
    out[:, 9:, D:] = motion.stretches.transpose(1, 2, 0)
    return out.reshape(S * WIDTH, D + K)


@njit(cache=True, nogil=True, error_model="numpy")
def segment_rows(
    transforms: Float, segments: Int, weights: Float, local: Float, origins: Float, axes: Float, gradient: Float
) -> tuple[Int, Float]:
    """Segments (R N, K) and derivatives (R N, K, 11) of residuals with gradients (R N, 3); see the module."""
    N, K = segments.shape
    own, out = np.full((len(gradient), K), -1, dtype=np.int32), np.zeros((len(gradient), K, WIDTH))
    for row in range(len(gradient)):
        n = row % N
        g0, g1, g2 = gradient[row, 0], gradient[row, 1], gradient[row, 2]
        x, y, z = local[n, 0], local[n, 1], local[n, 2]
        t0 = t1 = t2 = 0.0
        for k in range(K):
            w = weights[n, k]
            if w != 0.0:
                T = transforms[segments[n, k]]
                t0 += w * (T[0, 0] * g0 + T[1, 0] * g1 + T[2, 0] * g2)
                t1 += w * (T[0, 1] * g0 + T[1, 1] * g1 + T[2, 1] * g2)
                t2 += w * (T[0, 2] * g0 + T[1, 2] * g1 + T[2, 2] * g2)
        for k in range(K):
            w, s = weights[n, k], segments[n, k]
            if w == 0.0:
                continue
            T, o, a, j = transforms[s], origins[s], axes[s], out[row, k]
            X = T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]
            Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]
            Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
            own[row, k] = s
            j[0], j[1], j[2] = w * (Y * g2 - Z * g1), w * (Z * g0 - X * g2), w * (X * g1 - Y * g0)
            j[3], j[4], j[5] = w * g0, w * g1, w * g2
            j[6], j[7], j[8] = w * t0, w * t1, w * t2
            l0, l1, l2 = x - o[0], y - o[1], z - o[2]
            along = (a[0] * l0 + a[1] * l1 + a[2] * l2) * (a[0] * t0 + a[1] * t1 + a[2] * t2)
            j[9], j[10] = w * along, w * (l0 * t0 + l1 * t1 + l2 * t2 - along)
    return own, out


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def add_products(segments: Int, one: Float, other_segments: Int, other: Float, weight: Float, blocks: Float) -> None:
    """Add ``weight one otherᵀ`` to blocks (S, S, 11, 11), of rows (N, K, 11) by segments (N, K), -1 for none."""
    for n in range(len(weight)):
        W = weight[n]
        if W == 0.0:
            continue
        for k in range(segments.shape[1]):
            if segments[n, k] < 0:
                continue
            for m in range(other_segments.shape[1]):
                if other_segments[n, m] < 0:
                    continue
                block, b = blocks[segments[n, k], other_segments[n, m]], other[n, m]
                for p in range(WIDTH):
                    Wa = W * one[n, k, p]
                    for q in range(WIDTH):
                        block[p, q] += Wa * b[q]


@njit(cache=True, nogil=True)
def add_pulls(segments: Int, rows: Float, weighted: Float, vector: Float) -> None:
    """Add ``weighted row`` to vector (S, 11), of weighted residuals (N,)."""
    for n in range(len(weighted)):
        for k in range(segments.shape[1]):
            if weighted[n] != 0.0 and segments[n, k] >= 0:
                for p in range(WIDTH):
                    vector[segments[n, k], p] += weighted[n] * rows[n, k, p]


def segment_rows_reference(
    transforms: Float, segments: Int, weights: Float, local: Float, origins: Float, axes: Float, gradient: Float
) -> tuple[Int, Float]:
    """Readable twin of `segment_rows`."""
    repeats = len(gradient) // len(segments)
    own, w, rest = np.tile(segments, (repeats, 1)), np.tile(weights, (repeats, 1)), np.tile(local, (repeats, 1))
    T, a, arm = transforms[own], axes[own], rest[:, None] - origins[own]
    at, g = np.einsum("nkij,nj->nki", T[..., :3, :3], rest) + T[..., :3, 3], gradient[:, None]
    turned = np.einsum("nk,nkji,nj->ni", w, T[..., :3, :3], gradient)[:, None]
    along = np.sum(arm * a, axis=2) * np.sum(turned * a, axis=2)
    across = np.sum(arm * turned, axis=2) - along
    same = np.broadcast_to(g, at.shape), np.broadcast_to(turned, at.shape)
    out = w[..., None] * np.concatenate([np.cross(at, g), *same, along[..., None], across[..., None]], axis=2)
    return np.where(w != 0.0, own, -1).astype(np.int32), out


def add_products_reference(
    segments: Int, one: Float, other_segments: Int, other: Float, weight: Float, blocks: Float
) -> None:
    """Readable twin of `add_products`."""
    S = len(blocks)
    a, b = stacked(segments, one, S), stacked(other_segments, other, S)
    blocks += (a.T @ (weight[:, None] * b)).reshape(S, WIDTH, S, WIDTH).transpose(0, 2, 1, 3)


def add_pulls_reference(segments: Int, rows: Float, weighted: Float, vector: Float) -> None:
    """Readable twin of `add_pulls`."""
    vector += (weighted @ stacked(segments, rows, len(vector))).reshape(vector.shape)


def stacked(segments: Int, rows: Float, S: int) -> Float:
    """(N, 11 S) the rows with all their zeros."""
    out = np.zeros((len(segments), S, WIDTH))
    used = np.nonzero(segments >= 0)
    np.add.at(out, (used[0], segments[used]), rows[used])
    return out.reshape(len(out), S * WIDTH)
