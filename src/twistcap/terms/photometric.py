"""Brightness constancy of surface points, in full perspective.

The image brightness at a surface point's projection stays what it was in the frame that the template was taken from
(Bregler and Malik, DOI 10.1109/CVPR.1998.698581, with perspective instead of scaled orthography).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32, Int
from twistcap.body import Posed
from twistcap.render import SurfacePoints
from twistcap.terms.accumulate import (
    NEAR,
    PointTerm,
    Rows,
    projected_point,
)
from twistcap.terms.robust import weighted_cauchy

_FAST = {"contract", "reassoc", "arcp"}


@njit(cache=True, nogil=True, inline="always")
def sample(image: Float32, x: float, y: float) -> tuple[float, float, float, bool]:
    """Bilinear value, its central differences and whether all pixels they need are there."""
    height, width = image.shape
    if not (1.0 <= x < width - 2 and 1.0 <= y < height - 2):
        return 0.0, 0.0, 0.0, False
    x0, y0 = int(x), int(y)
    fx, fy = x - x0, y - y0
    flat, at = image.reshape(-1), (y0 - 1) * width + x0  # flat indices spare a search for every number
    a, b, at1, at2, at3 = flat[at], flat[at + 1], at + width, at + 2 * width, at + 3 * width
    c0, c1, c2, c3 = flat[at1 - 1], flat[at1], flat[at1 + 1], flat[at1 + 2]
    d0, d1, d2, d3 = flat[at2 - 1], flat[at2], flat[at2 + 1], flat[at2 + 2]
    e, f = flat[at3], flat[at3 + 1]
    left, middle, next_, right = c0 + fy * (d0 - c0), c1 + fy * (d1 - c1), c2 + fy * (d2 - c2), c3 + fy * (d3 - c3)
    above, upper, lower, below = a + fx * (b - a), c1 + fx * (c2 - c1), d1 + fx * (d2 - d1), e + fx * (f - e)
    gx = 0.5 * ((1.0 - fx) * (next_ - left) + fx * (right - middle))
    gy = 0.5 * ((1.0 - fy) * (lower - above) + fy * (below - upper))
    return float((1.0 - fy) * upper + fy * lower), float(gx), float(gy), True


@njit(cache=True, nogil=True)
def brightness_rows(
    P: Float, world: Float, image: Float32, template: Float, template_gradient: Float, weight: Float
) -> tuple[Float, Float]:
    """Residual ``I(π(x)) − template`` (N,) and its gradient by x (N, 3); 0 off the image and where the weight is 0.

    The image gradient is averaged with the template's (second-order minimisation: the mean of the two gradients is
    right to second order in the displacement).
    """
    N = len(world)
    residual, gradient = np.zeros(N), np.zeros((N, 3))
    for n in range(N):
        X, Y, Z = world[n, 0], world[n, 1], world[n, 2]
        depth = P[2, 0] * X + P[2, 1] * Y + P[2, 2] * Z + P[2, 3]
        if weight[n] == 0.0 or depth < NEAR:
            continue
        x = (P[0, 0] * X + P[0, 1] * Y + P[0, 2] * Z + P[0, 3]) / depth
        y = (P[1, 0] * X + P[1, 1] * Y + P[1, 2] * Z + P[1, 3]) / depth
        value, gx, gy, inside = sample(image, x, y)
        if not inside:
            continue
        residual[n] = value - template[n]
        a, b = 0.5 * (gx + template_gradient[n, 0]) / depth, 0.5 * (gy + template_gradient[n, 1]) / depth
        for i in range(3):
            gradient[n, i] = a * (P[0, i] - x * P[2, i]) + b * (P[1, i] - y * P[2, i])
    return residual, gradient


@dataclass(frozen=True)
class PhotometricTerm(PointTerm):
    """Surface points against their template brightness in one view, Cauchy on the difference.

    Attributes:
        P: (3, 4) projection.
        points: N places on the surface.
        image: (H, W) float32, the current view (blurred as the template's was).
        template: (N,) brightness in the template frame.
        template_gradient: (N, 2) its image gradient there, 1/px.
        weight: (N,) information, 1/brightness².
        scale: brightness difference at which a point begins to lose its say.
    """

    P: Float
    points: SurfacePoints
    image: Float32
    template: Float
    template_gradient: Float
    weight: Float
    scale: float = 0.05
    name: str = "photometric"

    def rows(self, posed: Posed) -> tuple[float, SurfacePoints, Rows]:
        residual, gradient = brightness_rows(
            self.P, self.points.at(posed), self.image, self.template, self.template_gradient, self.weight
        )
        energy, weight = weighted_cauchy(residual, self.weight, self.scale)
        return energy, self.points, Rows(gradient, residual, weight)

    def energy(self, posed: Posed) -> float:
        return _brightness_energy(
            *self.points.bound_to(posed), self.P, self.image, self.template, self.weight, self.scale
        )


@njit(cache=True, nogil=True, fastmath=_FAST)
def _brightness_energy(
    transforms: Float, segments: Int, weights: Float, local: Float, P: Float, image: Float32, template: Float,
    weight: Float, scale: float,
) -> float:  # fmt: skip
    """`PhotometricTerm.rows` for its energy alone."""
    energy, per = 0.0, 1.0 / scale
    height, width = image.shape
    for n in range(len(weight)):
        if weight[n] == 0.0:
            continue
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        if w == 0.0:
            continue
        if not (1.0 <= x < width - 2 and 1.0 <= y < height - 2):
            continue
        x0, y0 = int(x), int(y)
        fx, fy = x - x0, y - y0
        top = image[y0, x0] + fx * (image[y0, x0 + 1] - image[y0, x0])
        bottom = image[y0 + 1, x0] + fx * (image[y0 + 1, x0 + 1] - image[y0 + 1, x0])
        r = (top + fy * (bottom - top) - template[n]) * per
        energy += weight[n] * np.log1p(r * r)
    return 0.5 * scale * scale * energy
