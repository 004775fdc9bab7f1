"""The humanoid's surface: a lattice of cells gives the topology, an implicit body of swept limbs gives the shape.

The boundary of a set of lattice cells is closed and two-manifold by construction. Its corners start on rings along the
limbs and are then relaxed along, and projected onto, the zero level of a smooth union of the limbs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import PchipInterpolator

from twistcap._typing import Float, Int
from twistcap.body import _humanoid_profiles as P

_DEEP, _WIDE = 4, 10  # cells of the trunk, front to back and right to left
_SAMPLES = 33
_BLEND = 0.011  # m, radius of the smooth union

_AXES = {  # columns: first and second cross direction, running direction
    "up": np.eye(3),
    "down": np.diag([1.0, 1.0, -1.0]),
    "left": np.array([[1.0, 0, 0], [0, 0, 1.0], [0, 1.0, 0]]),
    "forward": np.array([[0, 0, 1.0], [1.0, 0, 0], [0, 1.0, 0]]),
}


@dataclass(frozen=True)
class Field:
    """Sampled sweeps: world-to-limb maps (N, 3, 4), profiles (N, 33, 4), and (N, 6) length, start, caps, exponent, sole."""

    parts: tuple[str, ...]
    maps: Float
    profiles: Float
    scalars: Float

    def distances(self, points: Float) -> Float:
        """(V, N) approximate signed distance to every sweep, m, negative inside."""
        return _distances(points, self.maps, self.profiles, self.scalars)

    def __call__(self, points: Float) -> Float:
        """(V,) smooth union of all sweeps."""
        d = self.distances(points)
        low = d.min(axis=1)
        return low - _BLEND * np.log(np.exp(-(d - low[:, None]) / _BLEND).sum(axis=1))

    def gradient(self, points: Float) -> Float:
        """(V, 3) by central differences."""
        h = 1e-4
        return np.stack([(self(points + e) - self(points - e)) / (2 * h) for e in h * np.eye(3)], axis=1)

    def lead(self, points: Float, part: str, side: str) -> Float:
        """(V,) by how much a limb is nearer than every other part but its mirror image, m."""
        d = self.distances(points)
        own = [p == f"{part}_{side}" for p in self.parts]
        others = [not p.startswith(part) for p in self.parts]
        return d[:, others].min(axis=1) - d[:, own].min(axis=1)


def field_of(central: Sequence[P.Sweep], paired: Sequence[P.Sweep], motions: dict[str, Float]) -> Field:
    """The implicit body; `motions` (4, 4) carry the left arm and leg from the neutral into the modelling pose."""
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    parts: list[str] = []
    maps, profiles, scalars = [], [], []
    for sweep, side in [(s, "") for s in central] + [(s, t) for s in paired for t in "lr"]:
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = _AXES[sweep.axis], sweep.origin
        placed = motions.get(sweep.part, np.eye(4)) @ frame
        if side == "r":
            placed = mirror @ placed
        parts.append(f"{sweep.part}_{side}" if sweep.part in motions else sweep.part)
        maps.append(np.linalg.inv(placed)[:3])
        table = np.array(sweep.stations)
        profiles.append(_sampled(table))
        sole = 0.0 if sweep.sole else -1.0
        scalars.append([table[-1, 0] - table[0, 0], table[0, 0], *sweep.caps, sweep.exponent, sole])
    return Field(tuple(parts), np.array(maps), np.array(profiles), np.array(scalars))


def _sampled(table: Float) -> Float:
    if len(table) == 1:
        return np.repeat(table[:, 1:], _SAMPLES, axis=0)
    at = np.linspace(table[0, 0], table[-1, 0], _SAMPLES)
    return np.asarray(PchipInterpolator(table[:, 0], table[:, 1:])(at))


@njit(cache=True, nogil=True)
def _distances(points: Float, maps: Float, profiles: Float, scalars: Float) -> Float:
    V, N, M = len(points), len(maps), profiles.shape[1]
    out = np.empty((V, N))
    for v in range(V):
        for i in range(N):
            T = maps[i]
            x = T[0, 0] * points[v, 0] + T[0, 1] * points[v, 1] + T[0, 2] * points[v, 2] + T[0, 3]
            y = T[1, 0] * points[v, 0] + T[1, 1] * points[v, 1] + T[1, 2] * points[v, 2] + T[1, 3]
            s = T[2, 0] * points[v, 0] + T[2, 1] * points[v, 1] + T[2, 2] * points[v, 2] + T[2, 3] - scalars[i, 1]
            length, n = scalars[i, 0], scalars[i, 4]
            inside = min(max(s, 0.0), length)
            at = inside / length * (M - 1) if length > 0 else 0.0
            k = min(int(at), M - 2)
            f = at - k
            a = (1 - f) * profiles[i, k, 0] + f * profiles[i, k + 1, 0]
            b = (1 - f) * profiles[i, k, 1] + f * profiles[i, k + 1, 1]
            c = scalars[i, 2] if s < 0.0 else scalars[i, 3]
            px = abs(x - (1 - f) * profiles[i, k, 2] - f * profiles[i, k + 1, 2]) / a
            py = abs(y - (1 - f) * profiles[i, k, 3] - f * profiles[i, k + 1, 3]) / b
            ps = abs(s - inside) / c
            # First-order distance to the level 1 of a homogeneous function r (Taubin 1994).
            r = (px**n + py**n + ps**n) ** (1.0 / n) + 1e-9
            gx, gy, gs = (px / r) ** (n - 1) / a, (py / r) ** (n - 1) / b, (ps / r) ** (n - 1) / c
            d = (r - 1.0) / (np.sqrt(gx * gx + gy * gy + gs * gs) + 1e-9)
            if scalars[i, 5] >= 0.0:  # the flat sole: a rounded intersection with z > 0
                e = 0.003 - y
                d = 0.5 * (d + e + np.sqrt((d - e) ** 2 + 0.008**2)) - 0.002
            out[v, i] = d
    return out


def lattice(variant: str) -> tuple[Int, Int]:
    """Corners (V, 3) on the lattice and outward quads (Q, 4) of the body's boundary."""
    cells: set[tuple[int, int, int]] = set()

    def block(xs: range, ys: range, zs: range) -> None:
        cells.update((x, y, z) for x in xs for y in ys for z in zs)

    trunk = _trunk_layers(variant)
    legs = len(P.LEG_LEVELS)
    block(range(_DEEP), range(_WIDE), range(trunk))
    for ys in (range(0, 4), range(6, 10)):
        block(range(_DEEP), ys, range(-legs - 2, 0))
        block(range(_DEEP, len(P.FOOT_XS) - 1), ys, range(-legs - 2, -legs))
    if variant == "full":
        block(range(_DEEP), range(3, 7), range(trunk, trunk + len(P.HEAD_LEVELS)))
        arms = len(P.ARM_LEVELS)
        block(range(_DEEP), range(-arms, 0), range(trunk - 4, trunk))
        block(range(_DEEP), range(_WIDE, _WIDE + arms), range(trunk - 4, trunk))
    return _boundary(cells)


def _trunk_layers(variant: str) -> int:
    return len(P.TRUNK_LEVELS) - 1 if variant == "full" else 6


def _boundary(cells: set[tuple[int, int, int]]) -> tuple[Int, Int]:
    """Corners (V, 3) and outward quads (Q, 4) of the cells' free faces."""
    quads: list[list[tuple[int, int, int]]] = []
    for cell in sorted(cells):
        for axis in range(3):
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            for side in (0, 1):
                step = np.eye(3, dtype=int)[axis]
                if tuple(np.array(cell) + (step if side else -step)) in cells:
                    continue
                o = np.array(cell) + side * step
                ring = [o, o + u, o + u + v, o + v]
                quads.append([tuple(c) for c in (ring if side else ring[::-1])])
    corners = sorted({c for q in quads for c in q})
    number = {c: i for i, c in enumerate(corners)}
    return np.array(corners, np.int32), np.array([[number[c] for c in q] for q in quads], np.int32)


def place(corners: Int, variant: str, motions: dict[str, Float]) -> Float:
    """(V, 3) first positions of the lattice corners, near the surface."""
    trunk, legs = _trunk_layers(variant), len(P.LEG_LEVELS)
    out = np.zeros((len(corners), 3))
    for i, (ix, iy, iz) in enumerate(corners):
        left = iy >= 5
        jy = iy if left else _WIDE - iy
        if jy > _WIDE:
            p = _on_arm(ix, jy, iz - trunk, motions["arm"])
        elif iz > trunk:
            p = _on_head(ix, jy, iz - trunk)
        elif iz >= 0:
            p = _on_trunk(ix, jy, P.TRUNK_LEVELS[iz])
        elif iz > -legs - 1 or ix < 0:
            p = _on_leg(ix, jy, P.LEG_LEVELS[-iz - 1], motions["leg"])
        else:
            p = _on_foot(ix, jy, iz + legs + 2, motions["leg"])
        out[i] = p if left else p * [1, -1, 1]
    return out


def _disc(u: float, v: float) -> tuple[float, float]:
    """The square [-1, 1]² to the unit disc, rings to rings."""
    r = float(np.hypot(u, v))
    grow = max(abs(u), abs(v)) / r if r > 0 else 0.0
    return u * grow, v * grow


def _profile(sweep: P.Sweep, at: float) -> Float:
    table = np.array(sweep.stations)
    return np.array([np.interp(at, table[:, 0], table[:, c]) for c in range(1, 5)])


def _on_trunk(ix: int, jy: int, z: float) -> Float:
    u, v = _disc((ix - 2) / 2, (jy - 5) / 5)
    a, b, x0, _ = _profile(P.TRUNK, z)
    return np.array([x0 + a * u, b * v, z])


def _on_head(ix: int, jy: int, k: int) -> Float:
    u, v = _disc((ix - 2) / 2, (jy - 5) / 2)
    z = P.HEAD_LEVELS[k - 1]
    x0 = np.interp(z, [0.56, 0.65, 0.82], [-0.03, 0.0, 0.0])
    r = np.interp(z, [0.56, 0.65, 0.72, 0.79, 0.82], [0.06, 0.065, 0.08, 0.06, 0.03])
    return np.array([x0 + r * u, r * v, z])


def _on_arm(ix: int, jy: int, k: int, motion: Float) -> Float:
    u, v = _disc((ix - 2) / 2, (k + 2) / 2)
    along = P.ARM_LEVELS[jy - _WIDE - 1]
    a, b = (0.05, 0.045) if along < 0.5 else (0.03, 0.015)
    local = np.array([P.SHOULDER[0] + a * u, P.SHOULDER[1] + b * v, P.SHOULDER[2] - along, 1.0])
    return (motion @ local)[:3]


def _on_leg(ix: int, jy: int, along: float, motion: Float) -> Float:
    u, v = _disc((ix - 2) / 2, (jy - 8) / 2)
    local = np.array([0.05 * u, P.HIP[1] + 0.05 * v, P.HIP[2] - along, 1.0])
    return (motion @ local)[:3]


def _on_foot(ix: int, jy: int, k: int, motion: Float) -> Float:
    height = float(np.interp(ix, [0, 4, 7, 10], [0.07, 0.085, 0.05, 0.03]))
    local = np.array([P.FOOT_XS[ix], P.HIP[1] + 0.035 * (jy - 8) / 2, P.FLOOR + height * k / 2, 1.0])
    return (motion @ local)[:3]


def relaxed(
    points: Float, quads: Int, field: Callable[[Float], Float], gradient: Callable[[Float], Float], rounds: int = 14
) -> Float:
    """Corners spread evenly along, and brought onto, the zero level of the field."""
    pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    degree = np.bincount(edges.ravel(), minlength=len(points))[:, None]
    x = points
    for n in range(rounds):
        g = gradient(x)
        size = np.linalg.norm(g, axis=1, keepdims=True) + 1e-9
        normal = g / size
        mean = np.zeros_like(x)
        np.add.at(mean, edges[:, 0], x[edges[:, 1]])
        np.add.at(mean, edges[:, 1], x[edges[:, 0]])
        step = mean / degree - x
        tangential = step - (step * normal).sum(1, keepdims=True) * normal
        to_surface = np.clip(-field(x)[:, None] / np.maximum(size, 0.3), -0.03, 0.03) * normal
        x = x + to_surface + (0.5 if n < rounds - 2 else 0.0) * tangential
    return x


def triangles(quads: Int, points: Float) -> Int:
    """(F, 3) each quad cut along its shorter diagonal (ties as its mirror image would)."""
    a, b, c, d = (points[quads[:, k]] for k in range(4))
    first = np.linalg.norm(a - c, axis=1) < np.linalg.norm(b - d, axis=1)
    one = np.where(first[:, None, None], quads[:, [[0, 1, 2], [0, 2, 3]]], quads[:, [[0, 1, 3], [1, 2, 3]]])
    return np.ascontiguousarray(one.reshape(-1, 3).astype(np.int32))
