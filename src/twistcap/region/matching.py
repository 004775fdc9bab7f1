"""Shape matching: corresponding points of the image's contour and the body's.

Two ways (Brox, Rosenhahn and Cremers, section 11.3.3; B. Rosenhahn et al., "A comparison of shape matching methods for
contour based pose estimation", IWCIA 2006, LNCS 4040, 263-276): the nearest point (`nearest_with_normal`), and a smooth
field of displacements between the two signed distances, which also moves points along the contour.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32
from twistcap.ranges import Checked, Count, Positive
from twistcap.region.levelset import signed_distance

_RELAXATION = 1.8
_NEWTON_STEPS = 4


@dataclass(frozen=True)
class Displacement:
    """A displacement `field` (h, w, 2), px of the image, on a grid of `resolution` px of the image."""

    field: Float32
    resolution: int

    def at(self, points: Float) -> Float:
        """(N, 2) px by which points (N, 2) px move; beyond the border as at it."""
        grid = ((points + 0.5) / self.resolution - 0.5).astype(np.float32)
        moved = _bilinear(self.field, grid[:, None, 0], grid[:, None, 1]) if len(grid) else self.field[:0]
        return moved.astype(np.float64).reshape(-1, 2)


def _bilinear(field: Float32, x: Float32, y: Float32) -> Float32:
    """The values of a field (h, w, C) at places (H, W); beyond the border as at it."""
    return np.asarray(cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


@dataclass(frozen=True)
class VariationalRule(Checked):
    """Settings of displacement fields."""

    alpha: Positive = 100.0  # weight of smoothness, in squared px of the image
    resolution: Count = 4  # px of the image in each row and column of the grid; signed distances are smooth
    warps: Count = 2  # linearisations
    iterations: Count = 8  # of the linear solver in each
    reach: float = 12.0  # px from the contour within which the shapes are compared


def displacement(phi0: Float32, phi: Float32, rule: VariationalRule) -> Displacement:
    """The smooth field w that makes Φ(x + w) agree with Φ₀(x).

    Minimises ``∫ (Φ₀(x) − Φ(x + w))² + α (|∇u|² + |∇v|²)`` near the contour of Φ₀, by warping and successive
    over-relaxation (eq. 11.15, with the two shapes exchanged, so that w starts on the body's contour). `phi0` and `phi`
    are signed distances (H, W) px, positive inside; only the sign of `phi` is used.
    """
    r, inside = rule.resolution, phi > 0.0
    distances = (phi0, signed_distance(inside) if inside.any() and not inside.all() else phi)
    size = (max(phi.shape[1] // r, 2), max(phi.shape[0] // r, 2))
    small = (cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in distances)
    source, target = (p.astype(np.float32) / np.float32(r) for p in small)
    slopes = np.gradient(target)
    packed = np.ascontiguousarray(np.stack([target, slopes[1], slopes[0]], axis=2), np.float32)
    weight = (np.abs(source) <= rule.reach / r).astype(np.float32)
    field = np.zeros((*size[::-1], 2), np.float32)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in size))
    for _ in range(rule.warps):
        warped = _bilinear(packed, x + field[..., 0], y + field[..., 1])
        relax(field, warped, source, weight, rule.alpha / r**2, rule.iterations)
    return Displacement(r * field, r)


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc", "arcp"})
def relax(field: Float32, warped: Float32, source: Float32, weight: Float32, alpha: float, iterations: int) -> None:
    """Improve a field (h, w, 2) in place on the system linearised about it, by sweeps of over-relaxation.

    Args:
        warped: (h, w, 3) value and x and y slope of the target at x + w.
        source: (h, w) wanted value.
        weight: (h, w) of the data; 0 where only the smoothness counts.
        alpha: of the smoothness; borders reflect.
    """
    height, width = source.shape
    a, keep, relaxed = np.float32(alpha), np.float32(1.0 - _RELAXATION), np.float32(_RELAXATION)
    # Both equations of a place, divided by α: right sides for u and v, their coupling, and the sweep's steps.
    system = np.empty((height, width, 5), dtype=np.float32)
    for r in range(height):
        for c in range(width):
            m, fx, fy = weight[r, c] / a, warped[r, c, 1], warped[r, c, 2]
            rest = m * (warped[r, c, 0] - source[r, c] - fx * field[r, c, 0] - fy * field[r, c, 1])
            system[r, c, 0], system[r, c, 1], system[r, c, 2] = fx * rest, fy * rest, m * fx * fy
            system[r, c, 3] = relaxed / (np.float32(4.0) + m * fx * fx)
            system[r, c, 4] = relaxed / (np.float32(4.0) + m * fy * fy)
    for _ in range(iterations):
        for r in range(height):
            up, down = max(r - 1, 0), min(r + 1, height - 1)
            for c in range(width):
                left, right = max(c - 1, 0), min(c + 1, width - 1)
                x, y, xy = system[r, c, 0], system[r, c, 1], system[r, c, 2]
                u, v = field[r, c, 0], field[r, c, 1]
                around = field[up, c, 0] + field[down, c, 0] + field[r, right, 0] + field[r, left, 0]
                u = keep * u + system[r, c, 3] * (around - x - xy * v)
                around = field[up, c, 1] + field[down, c, 1] + field[r, right, 1] + field[r, left, 1]
                field[r, c, 0], field[r, c, 1] = u, keep * v + system[r, c, 4] * (around - y - xy * u)


def relax_reference(
    field: Float32, warped: Float32, source: Float32, weight: Float32, alpha: float, iterations: int
) -> None:
    """Readable twin of `relax`: place by place, each unknown moved somewhat beyond the solution of its own equation."""
    height, width = source.shape
    rest = warped[..., 0] - source - np.sum(warped[..., 1:] * field, axis=2)
    for _ in range(iterations):
        for r, c in np.ndindex(height, width):
            around = [(max(r - 1, 0), c), (min(r + 1, height - 1), c), (r, max(c - 1, 0)), (r, min(c + 1, width - 1))]
            for k in range(2):
                slope, other, m = warped[r, c, 1 + k], warped[r, c, 2 - k], weight[r, c] / alpha
                pull = sum(field[i, j, k] for i, j in around) - m * slope * (rest[r, c] + other * field[r, c, 1 - k])
                solved = pull / (4.0 + m * slope**2)
                field[r, c, k] += _RELAXATION * (solved - field[r, c, k])


def displaced_partners(
    points: Float, normals: Float, flow: Displacement, phi: Float32, least_cosine: float
) -> tuple[Float, Float]:
    """Partner (N, 2) px of each point (N, 2) px by the field, and its distance (N,).

    Partners are moved to the zero level of `phi` (H, W). Where that fails, or the outward normal there does not agree
    with the point's own (N, 2), the distance is infinite.
    """
    return _on_contour(points, normals, points + flow.at(points), phi, least_cosine)


@njit(cache=True, nogil=True)
def _on_contour(points: Float, normals: Float, ends: Float, phi: Float32, least_cosine: float) -> tuple[Float, Float]:
    """Newton's steps from `ends` (N, 2) along the slope of Φ to its zero level."""
    height, width = phi.shape
    partner, distance = ends.copy(), np.full(len(points), np.inf)
    for n in range(len(points)):
        gx = gy = value = 0.0
        for _ in range(_NEWTON_STEPS):
            x = min(max(partner[n, 0], 1.0), width - 2.001)
            y = min(max(partner[n, 1], 1.0), height - 2.001)
            value, gx, gy = _sample(phi, x, y)
            slope2 = gx * gx + gy * gy
            if slope2 < 1e-4:
                break
            by = min(max(value / slope2, -3.0), 3.0)
            partner[n, 0], partner[n, 1] = x - by * gx, y - by * gy
            if abs(value) < 0.02:
                break
        slope = np.sqrt(gx * gx + gy * gy)
        if abs(value) > 0.5 or -(gx * normals[n, 0] + gy * normals[n, 1]) < least_cosine * slope:
            continue
        distance[n] = np.hypot(partner[n, 0] - points[n, 0], partner[n, 1] - points[n, 1])
    return partner, distance


@njit(cache=True, nogil=True, inline="always")
def _sample(phi: Float32, x: float, y: float) -> tuple[float, float, float]:
    """Bilinear value of Φ, and its slope within the cell."""
    c, r = int(x), int(y)
    fx, fy = x - c, y - r
    a, b, d, e = phi[r, c], phi[r, c + 1], phi[r + 1, c], phi[r + 1, c + 1]
    top, bottom = a + fx * (b - a), d + fx * (e - d)
    return top + fy * (bottom - top), (1.0 - fy) * (b - a) + fy * (e - d), bottom - top
