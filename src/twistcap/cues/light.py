"""How much light falls on a surface, by the direction in which it faces.

Lights stay where they are while a limb turns. Its shading then stays too, and texture alone moves: whoever takes both
for texture finds too little turn. Under distant lights, without cast shadows, the light on a matt surface is nearly a
quadratic function of its normal (Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment
Maps", 2001, DOI 10.1145/383259.383317). Here the logarithm of brightness is one, of all parts together, beside a
constant for the cloth of each part in each view.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap.arrays import Float, Int

TERMS = 8
"""Spherical harmonics of degrees 1 and 2 of a normal."""
_MEMORY = 0.98  # fraction of what was learnt that is kept from frame to frame, of 60 per second
_EVEN = 30.0  # points that speak for even light before any is measured
_TEXTURE = 0.2  # nats, what a point may differ from its part's mean before it counts for less
_DARKEST = 0.03  # brightness

LitPoints = tuple[Float, Int, Float]
"""Unit normals (N, 3) of surface points in the rest pose of their parts, the parts (N,), and the brightness (N,)."""


@dataclass(frozen=True)
class Light:
    """The light, as the surface shows it.

    Attributes:
        coefficients: (8,) of the logarithm of the light by the harmonics of a normal where the light stays in place: in
            the world, or before a camera.
        information, vector: (8, 8) and (8,) normal equations of all that was seen; what is old counts less.
    """

    coefficients: Float
    information: Float
    vector: Float

    @staticmethod
    def even() -> Light:
        """The same from everywhere."""
        return Light(np.zeros(TERMS), np.zeros((TERMS, TERMS)), np.zeros(TERMS))

    def on(self, normal: Float, part: Int, transforms: Float) -> Float:
        """(N,) light, relative to even light, on points with normals (N, 3) in the rest pose of their parts (N,);
        `transforms` (S, 4, 4) are the motions of the parts from there.
        """
        return light_on(normal, part, transforms, self.coefficients)

    def learnt(self, views: Sequence[LitPoints], transforms: Float, frames: int) -> Light:
        """After what the views show of the moved parts (S, 4, 4), which stands for so many frames."""
        information, vector = _MEMORY**frames * self.information, _MEMORY**frames * self.vector
        for normal, part, brightness in views:
            A, b = light_equations(normal, part, transforms, brightness, self.coefficients)
            information, vector = information + frames * A, vector + frames * b
        found = np.linalg.solve(information + _EVEN * np.eye(TERMS), vector)
        return Light(np.asarray(found, np.float64), information, vector)


@njit(cache=True, nogil=True, inline="always")
def _harmonics(T: Float, n: Float, out: Float) -> None:
    """The harmonics (8,) of a normal (3,) after a motion (4, 4), up to factors."""
    x = T[0, 0] * n[0] + T[0, 1] * n[1] + T[0, 2] * n[2]
    y = T[1, 0] * n[0] + T[1, 1] * n[1] + T[1, 2] * n[2]
    z = T[2, 0] * n[0] + T[2, 1] * n[1] + T[2, 2] * n[2]
    out[0], out[1], out[2] = x, y, z
    out[3], out[4], out[5], out[6], out[7] = x * y, y * z, x * z, x * x - y * y, 3.0 * z * z - 1.0


@njit(cache=True, nogil=True)
def light_on(normal: Float, part: Int, transforms: Float, coefficients: Float) -> Float:
    """See `Light.on`; `transforms` (S, 4, 4) are the motions of the parts from their rest pose."""
    out, h = np.empty(len(normal)), np.empty(TERMS)
    for n in range(len(normal)):
        _harmonics(transforms[part[n]], normal[n], h)
        total = 0.0
        for k in range(TERMS):
            total += coefficients[k] * h[k]
        out[n] = np.exp(total)
    return out


@njit(cache=True, nogil=True)
def light_equations(
    normal: Float, part: Int, transforms: Float, brightness: Float, coefficients: Float
) -> tuple[Float, Float]:
    """Normal equations (8, 8) and (8,) of the logarithm of brightness (N,) by the normals, parts' means taken out.

    Points far from what `coefficients` say count less (Cauchy). Brightness that is not finite does not count.
    """
    N, S = len(normal), len(transforms)
    rows, weight = np.zeros((N, TERMS + 1)), np.zeros(N)
    offset, count = np.zeros(S), np.zeros(S)
    for n in range(N):
        if not np.isfinite(brightness[n]):
            continue
        _harmonics(transforms[part[n]], normal[n], rows[n])
        rows[n, TERMS] = np.log(max(brightness[n], _DARKEST))
        weight[n] = rows[n, TERMS]
        for k in range(TERMS):
            weight[n] -= coefficients[k] * rows[n, k]
        offset[part[n]] += weight[n]
        count[part[n]] += 1.0
    means, masses = np.zeros((S, TERMS + 1)), np.zeros(S)
    for n in range(N):
        if not np.isfinite(brightness[n]):
            continue
        s = part[n]
        weight[n] = 1.0 / (1.0 + ((weight[n] - offset[s] / count[s]) / _TEXTURE) ** 2)
        masses[s] += weight[n]
        for k in range(TERMS + 1):
            means[s, k] += weight[n] * rows[n, k]
    A, y = np.zeros((TERMS, TERMS)), np.zeros(TERMS)
    for n in range(N):
        if weight[n] == 0.0:
            continue
        s = part[n]
        for k in range(TERMS + 1):
            rows[n, k] -= means[s, k] / masses[s]
        for i in range(TERMS):
            y[i] += weight[n] * rows[n, i] * rows[n, TERMS]
            for k in range(i, TERMS):
                A[i, k] += weight[n] * rows[n, i] * rows[n, k]
    for i in range(TERMS):
        for k in range(i):
            A[i, k] = A[k, i]
    return A, y


def harmonics_reference(normal: Float, part: Int, transforms: Float) -> Float:
    """(N, 8) readable twin of `_harmonics`, of all points."""
    x, y, z = np.einsum("nij,nj->in", transforms[part, :3, :3], normal)
    return np.stack([x, y, z, x * y, y * z, x * z, x * x - y * y, 3.0 * z * z - 1.0], axis=1)


def light_on_reference(normal: Float, part: Int, transforms: Float, coefficients: Float) -> Float:
    """Readable twin of `light_on`."""
    return np.exp(harmonics_reference(normal, part, transforms) @ coefficients)


def light_equations_reference(
    normal: Float, part: Int, transforms: Float, brightness: Float, coefficients: Float
) -> tuple[Float, Float]:
    """Readable twin of `light_equations`."""
    known = np.isfinite(brightness)
    H, part = harmonics_reference(normal, part, transforms)[known], part[known]
    y = np.log(np.maximum(brightness[known], _DARKEST))
    same = (part[:, None] == part[None]).astype(float)  # (N, N): its rows take means over parts
    rest = y - H @ coefficients
    weight = 1.0 / (1.0 + ((rest - same @ rest / same.sum(axis=1)) / _TEXTURE) ** 2)
    mean = same * weight / (same @ weight)[:, None]
    H, y = H - mean @ H, y - mean @ y
    return (H.T * weight) @ H, (H.T * weight) @ y
