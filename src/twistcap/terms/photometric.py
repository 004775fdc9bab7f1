"""Brightness constancy of surface points.

The brightness at a surface point's projection equals that of a template from earlier frames, up to a change of the
exposure: ``r = I(π(x)) − (1 + a) template − b`` (Bregler and Malik, DOI 10.1109/CVPR.1998.698581). π is any 3×4
projection: a pinhole's, or with a third row (0, 0, 0, 1) the paper's scaled orthography.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32
from twistcap.body import Posed
from twistcap.camera.projection import along
from twistcap.render import SurfaceArrays, SurfacePoints
from twistcap.terms.accumulate import PointTerm, Rows, projected_point, projected_point_reference
from twistcap.terms.robust import weighted_cauchy, weighted_cauchy_reference

_FAST = {"contract", "reassoc", "arcp"}
EXPOSURE = 2
"""Numbers of a view's change of exposure: relative gain a and offset b."""


@njit(cache=True, nogil=True, inline="always")
def sample(image: Float32, x: float, y: float) -> tuple[float, float, float, bool]:
    """Bilinear value, its central differences, and whether all pixels that they need are in the image."""
    height, width = image.shape
    if not (1.0 <= x < width - 2 and 1.0 <= y < height - 2):
        return 0.0, 0.0, 0.0, False
    x0, y0 = int(x), int(y)
    fx, fy = x - x0, y - y0
    flat, at = image.reshape(-1), (y0 - 1) * width + x0  # flat indices are faster than nested ones
    a, b, at1, at2, at3 = flat[at], flat[at + 1], at + width, at + 2 * width, at + 3 * width
    c0, c1, c2, c3 = flat[at1 - 1], flat[at1], flat[at1 + 1], flat[at1 + 2]
    d0, d1, d2, d3 = flat[at2 - 1], flat[at2], flat[at2 + 1], flat[at2 + 2]
    e, f = flat[at3], flat[at3 + 1]
    left, middle, next_, right = c0 + fy * (d0 - c0), c1 + fy * (d1 - c1), c2 + fy * (d2 - c2), c3 + fy * (d3 - c3)
    above, upper, lower, below = a + fx * (b - a), c1 + fx * (c2 - c1), d1 + fx * (d2 - d1), e + fx * (f - e)
    gx = 0.5 * ((1.0 - fx) * (next_ - left) + fx * (right - middle))
    gy = 0.5 * ((1.0 - fy) * (lower - above) + fy * (below - upper))
    return float((1.0 - fy) * upper + fy * lower), float(gx), float(gy), True


@njit(cache=True, nogil=True, inline="always")
def brightness_at(image: Float32, x: float, y: float) -> float:
    """The value of `sample` alone; NaN where a pixel that the gradient needs is outside the image."""
    height, width = image.shape
    if not (1.0 <= x < width - 2 and 1.0 <= y < height - 2):
        return np.nan
    x0, y0 = int(x), int(y)
    fx, fy = x - x0, y - y0
    top = image[y0, x0] + fx * (image[y0, x0 + 1] - image[y0, x0])
    bottom = image[y0 + 1, x0] + fx * (image[y0 + 1, x0 + 1] - image[y0 + 1, x0])
    return float(top + fy * (bottom - top))


@njit(cache=True, nogil=True)
def sampled(image: Float32, pixels: Float) -> tuple[Float, Float]:
    """`sample` at pixels (N, 2) of an image (H, W): values (N,) and gradients (N, 2), NaN and 0 off the image."""
    value, gradient = np.full(len(pixels), np.nan), np.zeros((len(pixels), 2))
    for n in range(len(pixels)):
        here, gx, gy, inside = sample(image, pixels[n, 0], pixels[n, 1])
        if inside:
            value[n], gradient[n, 0], gradient[n, 1] = here, gx, gy
    return value, gradient


def sampled_reference(image: Float32, pixels: Float) -> tuple[Float, Float]:
    """Readable twin of `sampled`."""
    here = np.array([sample_reference(image, x, y) for x, y in pixels]).reshape(-1, 4)
    return np.where(here[:, 3] > 0.0, here[:, 0], np.nan), here[:, 1:3]


@dataclass(frozen=True)
class Samples:
    """Surface points of one view, their brightness in earlier frames (N,), and its image gradient (N, 2), 1/px."""

    points: SurfacePoints
    value: Float
    gradient: Float

    def __len__(self) -> int:
        return len(self.value)

    def __add__(self, other: Samples) -> Samples:
        both = (np.concatenate(pair) for pair in ((self.value, other.value), (self.gradient, other.gradient)))
        return Samples(self.points + other.points, *both)

    def residuals(self, posed: Posed, P: Float, image: Float32, exposure: Float) -> Float:
        """(N,) ``I(π(x)) − (1 + a) value − b`` in an image (H, W) of projection P, exposure (a, b); NaN off it."""
        return photometric_residuals(self.points.bound_to(posed), P, image, self.value, exposure)

    def rows(self, posed: Posed, P: Float, image: Float32, exposure: Float, weight: Float) -> Rows:
        """The residuals and their gradients by the point, with weights (N,); all 0 off the image.

        The gradient is the mean of the image's and the template's, which is exact to second order in the displacement
        (efficient second-order minimisation).
        """
        surface = self.points.bound_to(posed)
        residual, gradient, seen = photometric_rows(surface, P, image, self.value, self.gradient, exposure, weight)
        return Rows(gradient, residual, seen)


@njit(cache=True, nogil=True)
def photometric_residuals(surface: SurfaceArrays, P: Float, image: Float32, value: Float, exposure: Float) -> Float:
    """See `Samples.residuals`."""
    transforms, segments, weights, local = surface
    out = np.full(len(value), np.nan)
    for n in range(len(value)):
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        if w > 0.0:
            out[n] = brightness_at(image, x, y) - (1.0 + exposure[0]) * value[n] - exposure[1]
    return out


@njit(cache=True, nogil=True)
def photometric_rows(
    surface: SurfaceArrays, P: Float, image: Float32, value: Float, gradient: Float, exposure: Float, weight: Float
) -> tuple[Float, Float, Float]:
    """Residuals (N,), their gradients (N, 3) by the point and the weights (N,); all 0 off the image."""
    transforms, segments, weights, local = surface
    N = len(value)
    residual, slope, seen = np.zeros(N), np.zeros((N, 3)), np.zeros(N)
    for n in range(N):
        if weight[n] == 0.0:
            continue
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        here, gx, gy, inside = sample(image, x, y)
        if w == 0.0 or not inside:
            continue
        seen[n] = weight[n]
        residual[n] = here - (1.0 + exposure[0]) * value[n] - exposure[1]
        a, b = 0.5 * (gx + gradient[n, 0]) * w, 0.5 * (gy + gradient[n, 1]) * w
        slope[n, 0], slope[n, 1], slope[n, 2] = along(P, x, y, a, b)
    return residual, slope, seen


@dataclass(frozen=True)
class PhotometricTerm(PointTerm):
    """Surface points against their template brightness in one view, Cauchy on the difference.

    Attributes:
        P, image: (3, 4) projection and (H, W) of the current view (blurred as the template's was).
        weight: (N,) information, 1/brightness².
        scale: (N,) brightness difference from which a point is down-weighted.
        exposure: (2,) relative gain and offset against the template.
    """

    P: Float
    samples: Samples
    image: Float32
    weight: Float
    scale: Float
    exposure: Float = field(default_factory=lambda: np.zeros(EXPOSURE))
    name: str = "photometric"

    @property
    def points(self) -> SurfacePoints:
        return self.samples.points

    def rows(self, posed: Posed) -> tuple[float, SurfacePoints, Rows]:
        rows = self.samples.rows(posed, self.P, self.image, self.exposure, self.weight)
        square = self.scale**2
        energy, weight = weighted_cauchy(rows.residual / self.scale, rows.weight * square, 1.0)
        return energy, self.points, replace(rows, weight=weight / square)

    def energy(self, posed: Posed) -> float:
        surface, value = self.points.bound_to(posed), self.samples.value
        return photometric_energy(surface, self.P, self.image, value, self.exposure, self.weight, self.scale)


@njit(cache=True, nogil=True, fastmath=_FAST)
def photometric_energy(
    surface: SurfaceArrays, P: Float, image: Float32, value: Float, exposure: Float, weight: Float, scale: Float
) -> float:
    """The energy of `PhotometricTerm.rows` alone."""
    transforms, segments, weights, local = surface
    energy, gain = 0.0, 1.0 + exposure[0]
    for n in range(len(weight)):
        if weight[n] == 0.0:
            continue
        x, y, w = projected_point(P, transforms, segments, weights, local, n)
        here = brightness_at(image, x, y)
        if w == 0.0 or np.isnan(here):
            continue
        square = scale[n] * scale[n]
        r = here - gain * value[n] - exposure[1]
        energy += weight[n] * square * np.log1p(r * r / square)
    return 0.5 * energy


def sample_reference(image: Float32, x: float, y: float) -> tuple[float, float, float, bool]:
    """Readable twin of `sample`: bilinear values at the pixel and one pixel to each side."""
    height, width = image.shape
    if not (1.0 <= x < width - 2 and 1.0 <= y < height - 2):
        return 0.0, 0.0, 0.0, False

    def value(x: float, y: float) -> float:
        c, r = int(x), int(y)
        return float(np.array([1 - y + r, y - r]) @ image[r : r + 2, c : c + 2] @ np.array([1 - x + c, x - c]))

    return value(x, y), (value(x + 1, y) - value(x - 1, y)) / 2, (value(x, y + 1) - value(x, y - 1)) / 2, True


def brightness_at_reference(image: Float32, x: float, y: float) -> float:
    """Readable twin of `brightness_at`."""
    value, _, _, inside = sample_reference(image, x, y)
    return value if inside else np.nan


def photometric_residuals_reference(
    surface: SurfaceArrays, P: Float, image: Float32, value: Float, exposure: Float
) -> Float:
    """Readable twin of `photometric_residuals`."""
    places = [projected_point_reference(P, *surface, n) for n in range(len(value))]
    here = [brightness_at_reference(image, x, y) if w > 0.0 else np.nan for x, y, w in places]
    return np.array(here) - (1.0 + exposure[0]) * value - exposure[1]


def photometric_rows_reference(
    surface: SurfaceArrays, P: Float, image: Float32, value: Float, gradient: Float, exposure: Float, weight: Float
) -> tuple[Float, Float, Float]:
    """Readable twin of `photometric_rows`."""
    residual, slope, seen = np.zeros(len(value)), np.zeros((len(value), 3)), np.zeros(len(value))
    for n in np.flatnonzero(weight).tolist():
        x, y, w = projected_point_reference(P, *surface, n)
        here, gx, gy, inside = sample_reference(image, x, y)
        if w > 0.0 and inside:
            by_pixel = (np.array([gx, gy]) + gradient[n]) / 2
            slope[n] = by_pixel @ (P[:2, :3] - np.outer([x, y], P[2, :3])) * w
            residual[n], seen[n] = here - (1.0 + exposure[0]) * value[n] - exposure[1], weight[n]
    return residual, slope, seen


def photometric_energy_reference(
    surface: SurfaceArrays, P: Float, image: Float32, value: Float, exposure: Float, weight: Float, scale: Float
) -> float:
    """Readable twin of `photometric_energy`."""
    residual = photometric_residuals_reference(surface, P, image, value, exposure)
    known = np.isfinite(residual)
    ratio, square = residual[known] / scale[known], scale[known] ** 2
    return weighted_cauchy_reference(ratio, weight[known] * square, 1.0)[0]
