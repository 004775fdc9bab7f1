"""Terms of surface points against the image: contour points on their normals or rays, keypoints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap.arrays import Float
from twistcap.body import Posed
from twistcap.body.kinematics import skin_points_reference
from twistcap.camera import pinhole
from twistcap.camera.projection import NEAR, along
from twistcap.render import SurfaceArrays, SurfacePoints
from twistcap.terms.accumulate import PointTerm, Rows, projected_point, skinned_point
from twistcap.terms.robust import huber, weighted_cauchy, weighted_cauchy_reference

_FAST = {"contract", "reassoc", "arcp"}


@njit(cache=True, nogil=True, fastmath=_FAST)
def projected_rows(P: Float, world: Float, direction: Float, target: Float) -> tuple[Float, Float]:
    """Residual ``direction · (π(x) − target)`` (N,) px and its gradient by x (N, 3); 0 behind the camera."""
    N = len(world)
    residual, gradient = np.zeros(N), np.zeros((N, 3))
    for n in range(N):
        x, y, z = world[n, 0], world[n, 1], world[n, 2]
        depth = P[2, 0] * x + P[2, 1] * y + P[2, 2] * z + P[2, 3]
        if depth < NEAR:
            continue
        w, a, b = 1.0 / depth, direction[n, 0], direction[n, 1]
        u = (P[0, 0] * x + P[0, 1] * y + P[0, 2] * z + P[0, 3]) * w
        v = (P[1, 0] * x + P[1, 1] * y + P[1, 2] * z + P[1, 3]) * w
        residual[n] = a * (u - target[n, 0]) + b * (v - target[n, 1])
        g0, g1, g2 = along(P, u, v, a, b)
        gradient[n, 0], gradient[n, 1], gradient[n, 2] = g0 * w, g1 * w, g2 * w
    return residual, gradient


def projected_rows_reference(P: Float, world: Float, direction: Float, target: Float) -> tuple[Float, Float]:
    """Readable twin of `projected_rows`."""
    pixels, depth, by_point = pinhole(P, world)
    before = depth[:, None] >= NEAR
    pixels, by_point = np.where(before, pixels, 0.0), np.where(before[..., None], by_point, 0.0)
    facing = np.where(before, direction, 0.0)
    return np.sum(facing * (pixels - target), axis=1), np.einsum("ni,nij->nj", facing, by_point)


@dataclass(frozen=True)
class PointNormalTerm(PointTerm):
    """Contour points pulled along their image normals to measured places: Cauchy on the residual in pixels.

    Attributes:
        P: (3, 4) projection of the view.
        target, normal: (N, 2) measured places of the contour, px, and unit image normals.
        weight: (N,) information of each measurement, 1/px².
        scale_px: residual from which a point is down-weighted.
    """

    P: Float
    points: SurfacePoints
    target: Float
    normal: Float
    weight: Float
    scale_px: float = 3.0
    name: str = "contour"

    def rows(self, posed: Posed) -> tuple[float, SurfacePoints, Rows]:
        residual, gradient = projected_rows(self.P, self.points.at(posed), self.normal, self.target)
        energy, weight = weighted_cauchy(residual, self.weight, self.scale_px)
        return energy, self.points, Rows(gradient, residual, weight)

    def energy(self, posed: Posed) -> float:
        surface = self.points.bound_to(posed)
        return normal_energy(surface, self.P, self.normal, self.target, self.weight, self.scale_px)


@njit(cache=True, nogil=True, fastmath=_FAST)
def normal_energy(
    surface: SurfaceArrays, P: Float, direction: Float, target: Float, weight: Float, scale: float
) -> float:
    """The energy of `PointNormalTerm.rows` alone."""
    transforms, segments, weights, local = surface
    energy, per = 0.0, 1.0 / scale
    for n in range(len(weight)):
        if weight[n] == 0.0:
            continue
        u, v, w = projected_point(P, transforms, segments, weights, local, n)
        if w == 0.0:
            continue
        r = (direction[n, 0] * (u - target[n, 0]) + direction[n, 1] * (v - target[n, 1])) * per
        energy += weight[n] * np.log1p(r * r)
    return 0.5 * scale * scale * energy


def normal_energy_reference(
    surface: SurfaceArrays, P: Float, direction: Float, target: Float, weight: Float, scale: float
) -> float:
    """Readable twin of `normal_energy`."""
    residual, _ = projected_rows_reference(P, skin_points_reference(*surface), direction, target)
    return weighted_cauchy_reference(residual, weight, scale)[0]


@njit(cache=True, nogil=True, fastmath=_FAST, inline="always")
def _ray_offset(x: float, y: float, z: float, n: Float, m: Float, scale: float) -> tuple[float, float, float, float]:
    """``scale (x × n − m)`` and its length."""
    a = scale * (y * n[2] - z * n[1] - m[0])
    b = scale * (z * n[0] - x * n[2] - m[1])
    c = scale * (x * n[1] - y * n[0] - m[2])
    return a, b, c, np.sqrt(a * a + b * b + c * c)


@njit(cache=True, nogil=True, fastmath=_FAST)
def ray_rows(
    world: Float, direction: Float, moment: Float, scale: Float, weight: Float, knee: float
) -> tuple[float, Float, Float, Float]:
    """Rows of ``scale (x × n − m)`` (px) along two unit directions e across each ray: N of one, then N of the other.

    ``d(x × n) = −n̂ dx``, so along e it is ``e · (dx × n) = dx · (n × e)``. The loss is Huber's of the length of both.

    Returns:
        Energy, residuals (2 N,), gradients (2 N, 3) and robust weights (2 N,).
    """
    N = len(world)
    energy, residual, gradient, robust = 0.0, np.empty(2 * N), np.empty((2 * N, 3)), np.empty(2 * N)
    for i in range(N):
        n, f = direction[i], scale[i]
        a, b, c, size = _ray_offset(world[i, 0], world[i, 1], world[i, 2], n, moment[i], f)
        energy += weight[i] * (0.5 * size * size if size <= knee else knee * (size - 0.5 * knee))
        robust[i] = robust[N + i] = weight[i] * (1.0 if size <= knee else knee / size)
        if abs(n[0]) < 0.7:  # e: n × an axis, of unit length
            length = np.sqrt(n[1] * n[1] + n[2] * n[2])
            e0, e1, e2 = 0.0, n[2] / length, -n[1] / length
        else:
            length = np.sqrt(n[0] * n[0] + n[2] * n[2])
            e0, e1, e2 = -n[2] / length, 0.0, n[0] / length
        u0, u1, u2 = n[1] * e2 - n[2] * e1, n[2] * e0 - n[0] * e2, n[0] * e1 - n[1] * e0
        residual[i], residual[N + i] = e0 * a + e1 * b + e2 * c, u0 * a + u1 * b + u2 * c
        gradient[i, 0], gradient[i, 1], gradient[i, 2] = f * u0, f * u1, f * u2
        gradient[N + i, 0], gradient[N + i, 1], gradient[N + i, 2] = -f * e0, -f * e1, -f * e2
    return energy, residual, gradient, robust


def ray_rows_reference(
    world: Float, direction: Float, moment: Float, scale: Float, weight: Float, knee: float
) -> tuple[float, Float, Float, Float]:
    """Readable twin of `ray_rows`."""
    apart = scale[:, None] * (np.cross(world, direction) - moment)
    axis = np.where(np.abs(direction[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    e = np.cross(direction, axis)
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    across = np.stack([e, np.cross(direction, e)])  # (2, N, 3)
    energy, robust = huber(np.linalg.norm(apart, axis=1), knee)
    gradient = scale[:, None] * np.asarray(np.cross(direction, across), np.float64)
    residual = np.sum(across * apart, axis=2)
    return float(weight @ energy), residual.ravel(), gradient.reshape(-1, 3), np.tile(weight * robust, 2)


@dataclass(frozen=True)
class PointRayTerm(PointTerm):
    """Contour points pulled to the Plücker rays of their partners in the image: Huber on the distance in pixels.

    The residual ``x × n − m`` is the distance to the ray in metres; times f/z it is in pixels, so that near and far
    cameras have equal weight (Brox, Rosenhahn and Cremers, eq. 11.16-11.19; method.md 3). It has rank 2 and is taken
    along two directions across the ray.

    Attributes:
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

    def rows(self, posed: Posed) -> tuple[float, SurfacePoints, Rows]:
        energy, residual, gradient, weight = ray_rows(
            self.points.at(posed), self.direction, self.moment, self.scale, self.weight, self.huber_px
        )
        return energy, self.points, Rows(gradient, residual, weight)

    def energy(self, posed: Posed) -> float:
        surface = self.points.bound_to(posed)
        return ray_energy(surface, self.direction, self.moment, self.scale, self.weight, self.huber_px)


@njit(cache=True, nogil=True, fastmath=_FAST)
def ray_energy(
    surface: SurfaceArrays, direction: Float, moment: Float, scale: Float, weight: Float, knee: float
) -> float:
    """The energy of `PointRayTerm.rows` alone."""
    transforms, segments, weights, local = surface
    energy = 0.0
    for n in range(len(weight)):
        x, y, z = skinned_point(transforms, segments, weights, local, n)
        _, _, _, size = _ray_offset(x, y, z, direction[n], moment[n], scale[n])
        energy += weight[n] * (0.5 * size * size if size <= knee else knee * (size - 0.5 * knee))
    return energy


def ray_energy_reference(
    surface: SurfaceArrays, direction: Float, moment: Float, scale: Float, weight: Float, knee: float
) -> float:
    """Readable twin of `ray_energy`."""
    return ray_rows_reference(skin_points_reference(*surface), direction, moment, scale, weight, knee)[0]


@dataclass(frozen=True)
class KeypointTerm(PointTerm):
    """Landmarks against 2D keypoints in one view, Cauchy on each coordinate.

    Attributes:
        P: (3, 4) projection.
        points, target: N landmarks as surface points (rigid on their segments), and (N, 2) px.
        weight: (N,) information, 1/px² (0 for missing ones).
        scale_px: residual from which a keypoint is down-weighted.
    """

    P: Float
    points: SurfacePoints
    target: Float
    weight: Float
    scale_px: float = 5.0
    name: str = "keypoints"

    def rows(self, posed: Posed) -> tuple[float, SurfacePoints, Rows]:
        axes = np.repeat(np.eye(2), len(self.points), axis=0)
        both, target = np.tile(self.points.at(posed), (2, 1)), np.tile(self.target, (2, 1))
        residual, gradient = projected_rows(self.P, both, axes, target)
        energy, weight = weighted_cauchy(residual, np.tile(self.weight, 2), self.scale_px)
        return energy, self.points, Rows(gradient, residual, weight)
