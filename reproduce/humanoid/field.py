"""An implicit body: the smooth union of limbs swept with superelliptic cross-sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import PchipInterpolator

from reproduce.humanoid.sweeps import Sweep
from twistcap.arrays import Float

_SAMPLES = 33
_BLEND = 0.011  # m, radius of the smooth union
_FAR = 3.0  # radii beyond which the exponent of a cross-section hardly matters

_AXES = {  # columns: first and second cross direction, running direction
    "up": np.eye(3),
    "down": np.diag([1.0, 1.0, -1.0]),
    "left": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]),
    "forward": np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]]),
}


@dataclass(frozen=True)
class Field:
    """The limbs, sampled.

    Attributes:
        parts: N names such as "trunk" or "arm_l".
        maps: (N, 3, 4) from the body to each limb's cross directions and axis.
        profiles: (N, 33, 4) half widths and offsets along the axis, m.
        scalars: (N, 6) length, start, both caps (m), exponent, and ≥ 0 for limbs that a sole cuts at height 0.
    """

    parts: tuple[str, ...]
    maps: Float
    profiles: Float
    scalars: Float

    def union(self, points: Float) -> tuple[Float, Float]:
        """Distance (V,) to the union, m, negative inside, and its gradient (V, 3), both to first order."""
        return _union(points, self.maps, self.profiles, self.scalars)

    def lead(self, points: Float, part: str, side: str) -> Float:
        """(V,) distance (m) to the nearest other part, without the limb's mirror image, minus that to the limb."""
        d = _distances(points, self.maps, self.profiles, self.scalars)
        own = [p == f"{part}_{side}" for p in self.parts]
        others = [not p.startswith(part) for p in self.parts]
        return d[:, others].min(axis=1) - d[:, own].min(axis=1)


def field_of(central: Sequence[Sweep], paired: Sequence[Sweep], motions: Mapping[str, Float]) -> Field:
    """The implicit body of sweeps on the midline and of left sweeps with their mirror images.

    `motions` (4, 4) by part move the left limbs from the neutral to the modelling pose.
    """
    sided = [(s, "") for s in central] + [(s, side) for s in paired for side in "lr"]
    parts = tuple(f"{s.part}_{side}" if s.part in motions else s.part for s, side in sided)
    maps = [np.linalg.inv(_frame(s, side, motions.get(s.part, np.eye(4))))[:3] for s, side in sided]
    profiles = [_sampled(np.array(s.stations)) for s, _ in sided]
    scalars = [
        [s.stations[-1][0] - s.stations[0][0], s.stations[0][0], *s.caps, s.exponent, 0.0 if s.sole else -1.0]
        for s, _ in sided
    ]
    return Field(parts, np.array(maps, np.float64), np.array(profiles), np.array(scalars))


def _frame(sweep: Sweep, side: str, motion: Float) -> Float:
    """(4, 4) from a limb's cross directions and axis to the body."""
    frame = np.eye(4)
    frame[:3, :3], frame[:3, 3] = _AXES[sweep.axis], sweep.origin
    mirror = np.diag([1.0, -1.0 if side == "r" else 1.0, 1.0, 1.0])
    return mirror @ motion @ frame


def _sampled(table: Float) -> Float:
    """Profiles (33, 4) at even steps through stations (n, 5), without overshoot."""
    if len(table) == 1:
        return np.repeat(table[:, 1:], _SAMPLES, axis=0)
    at = np.linspace(table[0, 0], table[-1, 0], _SAMPLES)
    return np.asarray(PchipInterpolator(table[:, 0], table[:, 1:])(at))


@njit(cache=True, nogil=True)
def _limb(point: Float, T: Float, profile: Float, scalars: Float) -> tuple[float, float, float, float]:
    """Distance to one limb and its gradient in limb axes, to first order (Taubin 1994, DOI 10.1145/174462.156633).

    The slope of the profile along the axis is left out of the gradient.
    """
    x = T[0, 0] * point[0] + T[0, 1] * point[1] + T[0, 2] * point[2] + T[0, 3]
    y = T[1, 0] * point[0] + T[1, 1] * point[1] + T[1, 2] * point[2] + T[1, 3]
    s = T[2, 0] * point[0] + T[2, 1] * point[1] + T[2, 2] * point[2] + T[2, 3] - scalars[1]
    length, n = scalars[0], scalars[4]
    inside = min(max(s, 0.0), length)
    at = inside / length * (len(profile) - 1) if length > 0 else 0.0
    k = min(int(at), len(profile) - 2)
    f = at - k
    a, b, x0, y0 = (1 - f) * profile[k] + f * profile[k + 1]
    c = scalars[2] if s < 0.0 else scalars[3]
    u, v, w = (x - x0) / a, (y - y0) / b, (s - inside) / c
    if n == 2.0 or max(abs(u), abs(v), abs(w)) > _FAR:
        r = np.sqrt(u * u + v * v + w * w) + 1e-9
        gx, gy, gs = u / r / a, v / r / b, w / r / c
    else:
        r = (abs(u) ** n + abs(v) ** n + abs(w) ** n) ** (1.0 / n) + 1e-9
        gx = np.sign(u) * (abs(u) / r) ** (n - 1) / a
        gy = np.sign(v) * (abs(v) / r) ** (n - 1) / b
        gs = np.sign(w) * (abs(w) / r) ** (n - 1) / c
    size = np.sqrt(gx * gx + gy * gy + gs * gs) + 1e-9
    d, gx, gy, gs = (r - 1.0) / size, gx / size, gy / size, gs / size
    if scalars[5] >= 0.0:  # the flat sole: a rounded intersection with the half-space above the floor
        e = 0.003 - y
        root = np.sqrt((d - e) ** 2 + 0.008**2)
        mix = 0.5 * (1.0 + (d - e) / root)
        d = 0.5 * (d + e + root) - 0.002
        gx, gy, gs = mix * gx, mix * gy - (1.0 - mix), mix * gs
    return d, gx, gy, gs


@njit(cache=True, nogil=True)
def _distances(points: Float, maps: Float, profiles: Float, scalars: Float) -> Float:
    """(V, N) distance to every limb."""
    out = np.empty((len(points), len(maps)))
    for v in range(len(points)):
        for i in range(len(maps)):
            out[v, i] = _limb(points[v], maps[i], profiles[i], scalars[i])[0]
    return out


@njit(cache=True, nogil=True)
def _union(points: Float, maps: Float, profiles: Float, scalars: Float) -> tuple[Float, Float]:
    """``−b log Σ exp(−d_i / b)`` and its gradient."""
    V, N = len(points), len(maps)
    value, gradient = np.empty(V), np.zeros((V, 3))
    limb = np.empty((N, 4))
    for v in range(V):
        for i in range(N):
            limb[i, 0], limb[i, 1], limb[i, 2], limb[i, 3] = _limb(points[v], maps[i], profiles[i], scalars[i])
        low = limb[:, 0].min()
        total = 0.0
        for i in range(N):
            if limb[i, 0] > low + 20.0 * _BLEND:
                continue
            weight = np.exp((low - limb[i, 0]) / _BLEND)
            total += weight
            for k in range(3):
                for m in range(3):
                    gradient[v, k] += weight * limb[i, 1 + m] * maps[i, m, k]
        value[v] = low - _BLEND * np.log(total)
        for k in range(3):
            gradient[v, k] /= total
    return value, gradient
