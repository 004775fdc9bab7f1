"""Brightness constancy of surface points, in full perspective.

The image brightness at a surface point's projection stays what it was in the frame that the template was taken from
(Bregler and Malik, DOI 10.1109/CVPR.1998.698581, with perspective instead of scaled orthography).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32
from twistcap.body import Posed
from twistcap.render import SurfacePoints
from twistcap.terms.accumulate import Rows, normal_equations
from twistcap.terms.quadratic import Quadratic
from twistcap.terms.robust import cauchy


@njit(cache=True, nogil=True)
def sample_with_gradient(image: Float32, x: Float, y: Float) -> tuple[Float, Float, Float, Float]:
    """Bilinear value, ∂x, ∂y (central differences of the bilinear surface) and validity (0/1), each (N,)."""
    N = len(x)
    height, width = image.shape
    value, gx, gy, valid = np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(N)
    for n in range(N):
        x0, y0 = int(np.floor(x[n])), int(np.floor(y[n]))
        if x0 < 1 or y0 < 1 or x0 >= width - 2 or y0 >= height - 2:
            continue
        fx, fy = x[n] - x0, y[n] - y0
        row0 = (1.0 - fx) * image[y0 - 1, x0] + fx * image[y0 - 1, x0 + 1]
        row1 = (1.0 - fx) * image[y0, x0] + fx * image[y0, x0 + 1]
        row2 = (1.0 - fx) * image[y0 + 1, x0] + fx * image[y0 + 1, x0 + 1]
        row3 = (1.0 - fx) * image[y0 + 2, x0] + fx * image[y0 + 2, x0 + 1]
        left = (1.0 - fy) * image[y0, x0 - 1] + fy * image[y0 + 1, x0 - 1]
        middle_left = (1.0 - fy) * image[y0, x0] + fy * image[y0 + 1, x0]
        middle_right = (1.0 - fy) * image[y0, x0 + 1] + fy * image[y0 + 1, x0 + 1]
        right = (1.0 - fy) * image[y0, x0 + 2] + fy * image[y0 + 1, x0 + 2]
        value[n] = (1.0 - fy) * row1 + fy * row2
        gx[n] = 0.5 * ((1.0 - fx) * (middle_right - left) + fx * (right - middle_left))
        gy[n] = 0.5 * ((1.0 - fy) * (row2 - row0) + fy * (row3 - row1))
        valid[n] = 1.0
    return value, gx, gy, valid


@njit(cache=True, nogil=True)
def brightness_rows(
    P: Float, world: Float, image: Float32, template: Float, template_gradient: Float
) -> tuple[Float, Float, Float]:
    """Residual ``I(π(x)) − template``, its gradient by x (N, 3), and validity (N,).

    The image gradient is averaged with the template's (second-order minimisation: the mean of the two gradients is
    right to second order in the displacement).
    """
    N = len(world)
    x, y, depth = np.zeros(N), np.zeros(N), np.ones(N)
    for n in range(N):
        d = P[2, 0] * world[n, 0] + P[2, 1] * world[n, 1] + P[2, 2] * world[n, 2] + P[2, 3]
        if d < 1e-3:
            x[n], y[n] = -1e6, -1e6
            continue
        depth[n] = d
        x[n] = (P[0, 0] * world[n, 0] + P[0, 1] * world[n, 1] + P[0, 2] * world[n, 2] + P[0, 3]) / d
        y[n] = (P[1, 0] * world[n, 0] + P[1, 1] * world[n, 1] + P[1, 2] * world[n, 2] + P[1, 3]) / d
    value, gx, gy, valid = sample_with_gradient(image, x, y)
    residual, gradient = np.zeros(N), np.zeros((N, 3))
    for n in range(N):
        if valid[n] == 0.0:
            continue
        residual[n] = value[n] - template[n]
        a, b = 0.5 * (gx[n] + template_gradient[n, 0]), 0.5 * (gy[n] + template_gradient[n, 1])
        for i in range(3):
            gradient[n, i] = (a * (P[0, i] - x[n] * P[2, i]) + b * (P[1, i] - y[n] * P[2, i])) / depth[n]
    return residual, gradient, valid


@dataclass(frozen=True)
class PhotometricTerm:
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

    def _rows(self, posed: Posed) -> tuple[Float, Float, Float]:
        return brightness_rows(self.P, self.points.at(posed), self.image, self.template, self.template_gradient)

    def energy(self, posed: Posed) -> float:
        residual, _, valid = self._rows(posed)
        return float((self.weight * valid) @ cauchy(residual, self.scale)[0])

    def linearize(self, posed: Posed) -> Quadratic:
        residual, gradient, valid = self._rows(posed)
        energy, robust = cauchy(residual, self.scale)
        weight = self.weight * valid
        rows = Rows(gradient, residual, weight * robust)
        return Quadratic(float(weight @ energy), *normal_equations(posed, self.points, rows))
