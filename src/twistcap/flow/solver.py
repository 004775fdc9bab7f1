"""The linear system of one inner fixed point: assembled from lagged weights, relaxed by red-black SOR.

At every pixel the two unknowns are the total flow (u, v), not its increment; a relaxation solves the pixel's 2 by 2
block exactly. Red and black pixels are in separate arrays, so that a row is updated by vector loops. All half sweeps
go down the image together, one row apart, so that rows stay in the cache. The result is that of whole sweeps in turn.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Bool, Float, Float32

FAST = {"contract", "reassoc", "arcp", "nsz"}  # never `nnan` or `ninf`: numbers that are not finite must show
TENSOR = 6  # entries of a symmetric 3 by 3 motion tensor: 11, 12, 22, 13, 23, 33
_SIDES = ((0, -1), (0, 1), (-1, 0), (1, 0))
_COEFFICIENTS = 9  # of a pixel's two equations: right sides, inverse block (11, 12, 22), weights left, right, up, down


def diffusivity(u: Float32, v: Float32, mask: Bool, epsilon: float) -> Float32:
    """(H, W) Ψ'(|∇u|² + |∇v|²) for Ψ(s²) = sqrt(s² + ε²); |∇u|² is half the sum of the squared steps to 4 neighbours.
    Steps across the mask's edge do not exist: the boundary reflects."""
    s2 = np.zeros(mask.shape, np.float32)
    for near, far in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        square = (np.square(u[far] - u[near]) + np.square(v[far] - v[near])) * (mask[far] & mask[near])
        s2[near] += square
        s2[far] += square
    return np.asarray(0.5 / np.sqrt(0.5 * s2 + np.float32(epsilon**2)), np.float32)


def data_weights(tensors: Float32, du: Float32, dv: Float32, gamma: float, epsilon: float) -> Float32:
    """(H, 5, W) weighted data term ψ'₁J₁ + γψ'₂J₂ of the increment: entries 11, 12, 22, 13, 23. Of motion tensors (H,
    12, W), with weights lagged at an increment du, dv (H, W) px and Ψ(s²) = sqrt(s² + ε²)."""
    out = np.zeros((len(du), TENSOR - 1, du.shape[1]), np.float32)
    for J, factor in ((tensors[:, :TENSOR], 1.0), (tensors[:, TENSOR:], gamma)):
        if factor > 0.0:
            a, b, c, d, e, f = (J[:, k] for k in range(TENSOR))
            square = (a * du + 2 * (b * dv + d)) * du + (c * dv + 2 * e) * dv + f
            weight = np.float32(0.5 * factor) / np.sqrt(np.maximum(square, 0) + np.float32(epsilon**2))
            out += weight[:, None] * J[:, : TENSOR - 1]
    return out


@njit(cache=True, nogil=True, fastmath=FAST)
def assemble(data: Float32, u0: Float32, v0: Float32, g: Float32, alpha: float, mask: Bool) -> Float32:
    """(2, H, 9, K) coefficients of every pixel's equations, red and black pixels apart; 0 outside the mask (H, W).

    Of `data_weights` (H, 5, W), the flow u0, v0 (H, W) px at which images were warped, and the diffusivity g (H, W).
    """
    H, W = mask.shape
    out = np.zeros((2, H, _COEFFICIENTS, (W + 1) // 2), dtype=np.float32)
    half = np.float32(0.5 * alpha)
    for r in range(H):
        for c in range(W):
            if not mask[r, c]:
                continue
            here, total = out[(r + c) & 1, r, :, c >> 1], np.float32(1e-9)
            for side in range(4):
                i, j = r + _SIDES[side][0], c + _SIDES[side][1]
                if 0 <= i < H and 0 <= j < W and mask[i, j]:
                    weight = half * (g[r, c] + g[i, j])
                    here[5 + side] = weight
                    total += weight
            a, b, d = data[r, 0, c], data[r, 1, c], data[r, 2, c]
            here[0] = a * u0[r, c] + b * v0[r, c] - data[r, 3, c]
            here[1] = b * u0[r, c] + d * v0[r, c] - data[r, 4, c]
            a, d = a + total, d + total
            inverse = np.float32(1.0) / (a * d - b * b)
            here[2], here[3], here[4] = d * inverse, -b * inverse, a * inverse
    return out


@njit(cache=True, nogil=True, fastmath=FAST)
def relax(coefficients: Float32, u: Float32, v: Float32, sweeps: int, omega: float) -> None:
    """SOR in place on u, v (H, W): `sweeps` red-black sweeps; pixels off the mask stay as they are."""
    _, H, _, K = coefficients.shape
    W = u.shape[1]
    split = np.zeros((2, 2, H + 2, K + 2), dtype=np.float32)  # u or v, colour, and a border of weight 0
    for r in range(H):
        for c in range(W):
            split[0, (r + c) & 1, r + 1, (c >> 1) + 1] = u[r, c]
            split[1, (r + c) & 1, r + 1, (c >> 1) + 1] = v[r, c]
    su, sv = np.empty(K, dtype=np.float32), np.empty(K, dtype=np.float32)
    w = np.float32(omega)
    for front in range(H + 2 * sweeps - 1):
        for half in range(2 * sweeps):
            r = front - half
            if 0 <= r < H:
                colour = half & 1
                p, row = (r + colour) & 1, coefficients[colour, r]
                _gather(row, split[0, 1 - colour, r : r + 3], p, row[0], su)
                _gather(row, split[1, 1 - colour, r : r + 3], p, row[1], sv)
                _mix(split[0, colour, r + 1, 1:-1], row[2], su, row[3], sv, w)
                _mix(split[1, colour, r + 1, 1:-1], row[3], su, row[4], sv, w)
    for r in range(H):
        for c in range(W):
            if coefficients[(r + c) & 1, r, 2, c >> 1] > 0.0:
                u[r, c] = split[0, (r + c) & 1, r + 1, (c >> 1) + 1]
                v[r, c] = split[1, (r + c) & 1, r + 1, (c >> 1) + 1]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _gather(row: Float32, other: Float32, p: int, right_side: Float32, out: Float32) -> None:
    """out (K,) = right side + Σ weight · neighbour; `other` (3, K + 2) are the rows of the other colour around."""
    K = len(out)
    left, right, up, down = other[1, p : p + K], other[1, p + 1 : p + 1 + K], other[0, 1 : K + 1], other[2, 1 : K + 1]
    a, b = row[5], row[6]
    for k in range(K):
        out[k] = right_side[k] + a[k] * left[k] + b[k] * right[k]
    a, b = row[7], row[8]
    for k in range(K):
        out[k] += a[k] * up[k] + b[k] * down[k]


@njit(cache=True, nogil=True, fastmath=FAST, inline="always")
def _mix(x: Float32, a: Float32, s: Float32, b: Float32, t: Float32, omega: np.float32) -> None:
    """Over-relaxation of x (K,) towards a·s + b·t."""
    for k in range(len(x)):
        x[k] += omega * (a[k] * s[k] + b[k] * t[k] - x[k])


def assemble_reference(data: Float32, u0: Float32, v0: Float32, g: Float32, alpha: float, mask: Bool) -> Float:
    """Readable twin of `assemble`: pixel by pixel."""
    H, W = mask.shape
    out = np.zeros((2, H, _COEFFICIENTS, (W + 1) // 2))
    for r, c in np.argwhere(mask):
        weights = np.zeros(4)
        for k, (i, j) in enumerate((r + dr, c + dc) for dr, dc in _SIDES):
            if 0 <= i < H and 0 <= j < W and mask[i, j]:
                weights[k] = 0.5 * alpha * (g[r, c] + g[i, j])
        a, b, d, e, f = data[r, :, c].astype(float)
        inverse = np.linalg.inv(np.array([[a, b], [b, d]]) + (weights.sum() + 1e-9) * np.eye(2))
        right = (a * u0[r, c] + b * v0[r, c] - e, b * u0[r, c] + d * v0[r, c] - f)
        out[(r + c) & 1, r, :, c >> 1] = *right, inverse[0, 0], inverse[0, 1], inverse[1, 1], *weights
    return out


def relax_reference(coefficients: Float32, u: Float32, v: Float32, sweeps: int, omega: float) -> None:
    """Readable twin of `relax`: whole half sweeps one after the other."""
    H, W = u.shape
    for half in range(2 * sweeps):
        for r, c in np.ndindex(H, W):
            here = coefficients[(r + c) & 1, r, :, c >> 1]
            if (r + c) % 2 == half % 2 and here[2] > 0.0:
                s, x = here[:2].astype(float), np.array([u[r, c], v[r, c]])
                for weight, (dr, dc) in zip(here[5:], _SIDES, strict=True):
                    if weight > 0.0:
                        s += weight * np.array([u[r + dr, c + dc], v[r + dr, c + dc]])
                solved = np.array([[here[2], here[3]], [here[3], here[4]]]) @ s
                u[r, c], v[r, c] = x + omega * (solved - x)
