"""Terms of surface points against the image: contour points on their normals or rays, keypoints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap._typing import Float
from twistcap.body import Posed
from twistcap.render import SurfacePoints
from twistcap.terms.accumulate import Rows, normal_equations
from twistcap.terms.quadratic import Quadratic
from twistcap.terms.robust import cauchy, huber


@njit(cache=True, nogil=True)
def projected_rows(P: Float, world: Float, direction: Float, target: Float) -> tuple[Float, Float]:
    """Residual ``direction · (π(x) − target)`` (N,) px and its gradient by x (N, 3); 0 behind the camera."""
    N = len(world)
    residual, gradient = np.zeros(N), np.zeros((N, 3))
    for n in range(N):
        x, y, z = world[n, 0], world[n, 1], world[n, 2]
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        if depth < 1e-3:
            continue
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) / depth
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) / depth
        a, b = direction[n, 0], direction[n, 1]
        residual[n] = a * (u - target[n, 0]) + b * (v - target[n, 1])
        for i in range(3):
            gradient[n, i] = (a * (P[0, i] - u * P[2, i]) + b * (P[1, i] - v * P[2, i])) / depth
    return residual, gradient


def projected_rows_reference(P: Float, world: Float, direction: Float, target: Float) -> tuple[Float, Float]:
    """Readable twin of `projected_rows`."""
    homogeneous = world @ P[:, :3].T + P[:, 3]
    depth = homogeneous[:, 2:]
    pixels = homogeneous[:, :2] / depth
    by_point = (P[None, :2, :3] - pixels[:, :, None] * P[2, :3]) / depth[:, :, None]
    return np.sum(direction * (pixels - target), axis=1), np.einsum("ni,nij->nj", direction, by_point)


@dataclass(frozen=True)
class PointNormalTerm:
    """Contour points pulled along their image normals to measured places: Cauchy on the residual in pixels.

    Attributes:
        P: (3, 4) projection of the view.
        points: N places on the surface.
        target: (N, 2) px, where the contour was measured.
        normal: (N, 2) unit image normals.
        weight: (N,) information of each measurement, 1/px².
        scale_px: residual at which a point begins to lose its say.
    """

    P: Float
    points: SurfacePoints
    target: Float
    normal: Float
    weight: Float
    scale_px: float = 3.0
    name: str = "contour"

    def energy(self, posed: Posed) -> float:
        residual, _ = projected_rows(self.P, self.points.at(posed), self.normal, self.target)
        return float(self.weight @ cauchy(residual, self.scale_px)[0])

    def linearize(self, posed: Posed) -> Quadratic:
        residual, gradient = projected_rows(self.P, self.points.at(posed), self.normal, self.target)
        energy, robust = cauchy(residual, self.scale_px)
        rows = Rows(gradient, residual, self.weight * robust)
        return Quadratic(float(self.weight @ energy), *normal_equations(posed, self.points, rows))


@dataclass(frozen=True)
class PointRayTerm:
    """Contour points drawn to the Plücker rays of their partners in the image.

    The residual ``x × n − m`` is the distance to the ray in metres; times f/z it is in pixels, so that near and far
    cameras weigh alike (Brox, Rosenhahn and Cremers, eq. 11.16-11.19; method.md 3). It is taken along two directions
    across the ray, which hold all of it (the 3-vector has rank 2).

    Attributes:
        points: N places on the surface.
        direction, moment: (N, 3) rays (n, m), world, m.
        scale: (N,) f/z, px/m.
        weight: (N,) information, 1/px².
        huber_px: length of the residual beyond which the loss is linear.
    """

    points: SurfacePoints
    direction: Float
    moment: Float
    scale: Float
    weight: Float
    huber_px: float = 3.0
    name: str = "contour"

    def _residual(self, world: Float) -> Float:
        return self.scale[:, None] * (np.cross(world, self.direction) - self.moment)

    def energy(self, posed: Posed) -> float:
        length = np.linalg.norm(self._residual(self.points.at(posed)), axis=1)
        return float(self.weight @ huber(length, self.huber_px)[0])

    def linearize(self, posed: Posed) -> Quadratic:
        residual = self._residual(self.points.at(posed))
        energy, robust = huber(np.linalg.norm(residual, axis=1), self.huber_px)
        across = np.stack(_across(self.direction))  # (2, N, 3)
        # d(x × n) = −n̂ dx, so along a unit e: e · (dx × n) = dx · (n × e).
        gradient = self.scale[:, None] * np.cross(self.direction, across)
        value = np.einsum("eni,ni->en", across, residual)
        both = np.tile(np.arange(len(self.points)), 2)
        rows = Rows(gradient.reshape(-1, 3), value.ravel(), np.tile(self.weight * robust, 2))
        return Quadratic(float(self.weight @ energy), *normal_equations(posed, self.points[both], rows))


def _across(direction: Float) -> tuple[Float, Float]:
    """Two unit vectors (N, 3) that make an orthonormal frame with each direction."""
    helper = np.where(np.abs(direction[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(direction, first)


@dataclass(frozen=True)
class KeypointTerm:
    """Landmarks against 2D keypoints in one view, Cauchy on each coordinate.

    Attributes:
        P: (3, 4) projection.
        points: N landmarks as surface points (rigid on their segments).
        target: (N, 2) px.
        weight: (N,) information, 1/px² (0 for missing ones).
        scale_px: residual at which a keypoint begins to lose its say.
    """

    P: Float
    points: SurfacePoints
    target: Float
    weight: Float
    scale_px: float = 5.0
    name: str = "keypoints"

    def _rows(self, posed: Posed) -> tuple[Float, Float, Float]:
        world = self.points.at(posed)
        both = np.concatenate([world, world])
        axes = np.repeat(np.eye(2), len(world), axis=0)
        residual, gradient = projected_rows(self.P, both, axes, np.concatenate([self.target, self.target]))
        return residual, gradient, np.tile(self.weight, 2)

    def energy(self, posed: Posed) -> float:
        residual, _, weight = self._rows(posed)
        return float(weight @ cauchy(residual, self.scale_px)[0])

    def linearize(self, posed: Posed) -> Quadratic:
        residual, gradient, weight = self._rows(posed)
        energy, robust = cauchy(residual, self.scale_px)
        both = np.tile(np.arange(len(self.points)), 2)
        rows = Rows(gradient, residual, weight * robust)
        return Quadratic(float(weight @ energy), *normal_equations(posed, self.points[both], rows))
