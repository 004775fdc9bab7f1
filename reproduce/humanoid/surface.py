"""The humanoid's surface, with the topology of a lattice of cells and the shape of an implicit body.

The boundary of a set of lattice cells is closed and two-manifold by construction. Its corners start on rings along the
limbs; then they are relaxed along, and projected onto, the zero level of the implicit body.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from reproduce.humanoid import sweeps as W
from reproduce.humanoid.field import Field, field_of
from twistcap import se3
from twistcap.arrays import AnyArray, Float, Int
from twistcap.body import proportions as P
from twistcap.body.humanoid import limb_motions

_DEEP, _WIDE = 4, 10  # cells of the trunk, back to front and right to left
_HALF, _ARM_ROWS, _LEGS_ONLY_LAYERS = 5, 4, 6
_ROUNDS = 14


def modelled(variant: str) -> dict[str, AnyArray]:
    """Arrays of `humanoid.npz` for a variant: points, faces, and each limb's lead (V,), m, under names such as
    "full_arm_l"."""
    motions = limb_motions()
    central = (W.TRUNK, *W.CENTRAL) if variant == "full" else (W.PELVIS_ONLY,)
    paired = (*W.UPPER_LEFT, *W.LOWER_LEFT) if variant == "full" else W.LOWER_LEFT
    field = field_of(central, paired, motions)
    points, faces = surface(field, variant, motions)
    out: dict[str, AnyArray] = {f"{variant}_points": points, f"{variant}_faces": faces}
    for part in ("arm", "leg") if variant == "full" else ("leg",):
        for side in "lr":
            out[f"{variant}_{part}_{side}"] = field.lead(points, part, side)
    return out


def surface(field: Field, variant: str, motions: Mapping[str, Float]) -> tuple[Float, Int]:
    """Vertices (V, 3) in the modelling pose and outward triangles (F, 3) of the zero level of the field."""
    corners, quads = _boundary(_cells(variant))
    foot = corners[:, 2] < -len(W.LEG_LEVELS)  # free relaxation would pull the toes into the foot
    mobility = np.where(foot, 0.1, 0.5)[:, None]
    points = _relaxed(_placed(corners, variant, motions), mobility, quads, field)
    return points, _triangles(quads, points)


def _trunk_layers(variant: str) -> int:
    return len(W.TRUNK_LEVELS) - 1 if variant == "full" else _LEGS_ONLY_LAYERS


def _cells(variant: str) -> set[tuple[int, int, int]]:
    """Cells (x, y, z) of the body: the trunk above z = 0, legs below, arms to both sides, head on top."""
    trunk, legs, arms = _trunk_layers(variant), len(W.LEG_LEVELS), len(W.ARM_LEVELS)
    blocks = [(range(_DEEP), range(_WIDE), range(trunk))]
    for ys in (range(0, 4), range(6, 10)):
        blocks.append((range(_DEEP), ys, range(-legs - 2, 0)))
        blocks.append((range(_DEEP, len(W.FOOT_XS) - 1), ys, range(-legs - 2, -legs)))
    if variant == "full":
        blocks.append((range(_DEEP), range(3, 7), range(trunk, trunk + len(W.HEAD_LEVELS))))
        for ys in (range(-arms, 0), range(_WIDE, _WIDE + arms)):
            blocks.append((range(_DEEP), ys, range(trunk - _ARM_ROWS, trunk)))
    return {(x, y, z) for xs, ys, zs in blocks for x in xs for y in ys for z in zs}


def _boundary(cells: set[tuple[int, int, int]]) -> tuple[Int, Int]:
    """Corners (V, 3) and outward quads (Q, 4) of the cells' free faces."""
    filled = np.array(sorted(cells))
    quads: list[Int] = []
    for axis in range(3):
        unit = np.roll(np.eye(3, dtype=int), -axis, axis=0)  # the face's normal and its two directions
        for side in (0, 1):
            free = [tuple(c) not in cells for c in (filled + (2 * side - 1) * unit[0]).tolist()]
            at = filled[free] + side * unit[0]
            ring = np.stack([at, at + unit[1], at + unit[1] + unit[2], at + unit[2]], axis=1)
            quads.append(ring if side else ring[:, ::-1])
    corners, number = np.unique(np.concatenate(quads).reshape(-1, 3), axis=0, return_inverse=True)
    return corners.astype(np.int32), number.reshape(-1, 4).astype(np.int32)


def _placed(corners: Int, variant: str, motions: Mapping[str, Float]) -> Float:
    """(V, 3) first positions of the lattice corners, near the surface; the right side mirrors the left."""
    ix, iy, iz = corners.T.astype(np.int64)
    jy = np.where(iy >= _HALF, iy, _WIDE - iy)
    trunk, legs = _trunk_layers(variant), len(W.LEG_LEVELS)
    out = np.zeros((len(corners), 3))
    for rows, place in (
        ((iz >= 0) & (jy <= _WIDE) & (iz <= trunk), lambda m: _on_trunk(ix[m], jy[m], iz[m])),
        ((iz > trunk), lambda m: _on_head(ix[m], jy[m], iz[m] - trunk)),
        ((jy > _WIDE), lambda m: se3.apply(motions["arm"], _on_arm(ix[m], jy[m] - _WIDE, iz[m] - trunk))),
        ((iz < 0) & (iz >= -legs), lambda m: se3.apply(motions["leg"], _on_leg(ix[m], jy[m], -iz[m]))),
        ((iz < 0) & (iz < -legs), lambda m: se3.apply(motions["leg"], _on_foot(ix[m], jy[m], iz[m] + legs + 2))),
    ):
        if rows.any():
            out[rows] = place(rows)
    out[iy < _HALF, 1] *= -1.0
    return out


def _disc(u: Float, v: Float) -> tuple[Float, Float]:
    """The square [-1, 1]² to the unit disc, concentric squares to circles."""
    shrink = np.maximum(np.abs(u), np.abs(v)) / np.maximum(np.hypot(u, v), 1e-9)
    return u * shrink, v * shrink


def _on_trunk(ix: Int, jy: Int, layer: Int) -> Float:
    z = np.array(W.TRUNK_LEVELS)[layer]
    u, v = _disc((ix - 2) / 2, (jy - _HALF) / 5)
    table = np.array(W.TRUNK.stations)
    a, b, x0 = (np.interp(z, table[:, 0], table[:, c]) for c in (1, 2, 3))
    return np.stack([x0 + a * u, b * v, z], axis=1)


def _on_head(ix: Int, jy: Int, layer: Int) -> Float:
    z = np.array(W.HEAD_LEVELS)[layer - 1]
    u, v = _disc((ix - 2) / 2, (jy - _HALF) / 2)
    r = np.interp(z, [0.56, 0.65, 0.72, 0.79, 0.82], [0.06, 0.065, 0.08, 0.06, 0.03])
    return np.stack([np.interp(z, [0.56, 0.65], [-0.03, 0.0]) + r * u, r * v, z], axis=1)


def _on_arm(ix: Int, ring: Int, k: Int) -> Float:
    u, v = _disc((ix - 2) / 2, (k + 2) / 2)
    along = np.array(W.ARM_LEVELS)[ring - 1]
    a, b = np.where(along < 0.5, 0.05, 0.03), np.where(along < 0.5, 0.045, 0.015)
    return np.stack([P.SHOULDER[0] + a * u, P.SHOULDER[1] + b * v, P.SHOULDER[2] - along], axis=1)


def _on_leg(ix: Int, jy: Int, ring: Int) -> Float:
    u, v = _disc((ix - 2) / 2, (jy - 8) / 2)
    along = np.array(W.LEG_LEVELS)[ring - 1]
    return np.stack([0.05 * u, P.HIP[1] + 0.05 * v, P.HIP[2] - along], axis=1)


def _on_foot(ix: Int, jy: Int, k: Int) -> Float:
    height = np.interp(ix, [0, 4, 7, 10], [0.07, 0.085, 0.05, 0.03])
    y = P.HIP[1] + 0.035 * (jy - 8) / 2
    return np.stack([np.array(W.FOOT_XS)[ix], y, P.FLOOR + height * k / 2], axis=1)


def _relaxed(points: Float, mobility: Float, quads: Int, field: Field) -> Float:
    """Corners spread evenly on the zero level; `mobility` (V, 1) is their speed along it."""
    pairs = np.stack([quads, np.roll(quads, -1, axis=1)], axis=-1).reshape(-1, 2)  # every edge once in each sense
    degree = np.bincount(pairs[:, 0], minlength=len(points))
    x = points
    for n in range(_ROUNDS):
        distance, gradient = field.union(x)
        size = np.linalg.norm(gradient, axis=1, keepdims=True) + 1e-9
        normal = gradient / size
        onto = np.clip(-distance[:, None] / np.maximum(size, 0.3), -0.03, 0.03) * normal
        sums = [np.bincount(pairs[:, 0], x[pairs[:, 1], k], len(points)) for k in range(3)]
        apart = np.stack(sums, axis=1) / degree[:, None] - x
        along = apart - (apart * normal).sum(axis=1, keepdims=True) * normal
        x = x + onto + (mobility * along if n < _ROUNDS - 3 else 0.0)
    return x


def _triangles(quads: Int, points: Float) -> Int:
    """(F, 3) each quad cut along its shorter diagonal."""
    a, b, c, d = (points[quads[:, k]] for k in range(4))
    first = np.linalg.norm(a - c, axis=1) < np.linalg.norm(b - d, axis=1)
    cut = np.where(first[:, None, None], quads[:, [[0, 1, 2], [0, 2, 3]]], quads[:, [[0, 1, 3], [1, 2, 3]]])
    return np.ascontiguousarray(cut.reshape(-1, 3).astype(np.int32))
