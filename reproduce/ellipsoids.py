"""Bodies of ellipsoids: one for each segment, fitted to its surface.

Bregler and Malik, "Tracking People with Twists and Exponential Maps", CVPR 1998, approximate the segments of the body
by ellipsoidal blobs. The body is a `Body` like any other, whose mesh is that of its ellipsoids.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull

from twistcap.arrays import Float, Int
from twistcap.body.model import Body
from twistcap.errors import InputError

_RINGS, _SECTORS = 12, 20


@dataclass(frozen=True)
class Ellipsoids:
    """Ellipsoids fixed to segments, rest pose, m.

    Attributes:
        segments: (E,) that carry them.
        centres: (E, 3).
        axes: (E, 3, 3) unit half axes, in columns, right-handed.
        radii: (E, 3) lengths of the half axes.
    """

    segments: Int
    centres: Float
    axes: Float
    radii: Float

    def forms(self) -> Float:
        """(E, 3, 3) matrices A of ``(x − c)ᵀ A (x − c) = 1``."""
        return np.einsum("eik,ek,ejk->eij", self.axes, self.radii**-2.0, self.axes)

    def mesh(self) -> tuple[Float, Int, Int]:
        """Vertices (V, 3), faces (F, 3) seen from outside counter-clockwise, and the segment (V,) of each vertex."""
        unit, triangles = _unit_sphere()
        vertices = [c + (unit * r) @ A.T for c, A, r in zip(self.centres, self.axes, self.radii, strict=True)]
        faces = [triangles + n * len(unit) for n in range(len(self.centres))]
        owner = np.repeat(self.segments, len(unit))
        return np.concatenate(vertices), np.concatenate(faces).astype(np.int32), owner.astype(np.int32)


def fitted_ellipsoids(body: Body) -> Ellipsoids:
    """The ellipsoid of every segment that carries surface: of the same second moments as the hull of its vertices.

    Raises:
        InputError: where no segment has a surface of its own.
    """
    rows: list[tuple[int, Float, Float, Float]] = []
    for s in range(len(body.segment_names)):
        own = body.vertices[body.vertex_part == s]
        if len(own) >= 8:
            rows.append((s, *_same_moments(own)))
    if not rows:
        raise InputError(f"body {body.name!r} has no surface to fit ellipsoids to; give one with vertices.")
    segments, centres, axes, radii = zip(*rows, strict=True)
    return Ellipsoids(np.array(segments, np.int32), np.array(centres), np.array(axes), np.array(radii))


def ellipsoid_body(body: Body, ellipsoids: Ellipsoids | None = None) -> Body:
    """The body with the mesh of ellipsoids in place of its surface; by default those fitted to it."""
    return with_surface(body, *(ellipsoids or fitted_ellipsoids(body)).mesh())


def with_surface(body: Body, vertices: Float, faces: Int, segments: Int) -> Body:
    """The body with another surface, each vertex rigid on its segment (V,)."""
    one = np.ones((len(vertices), 1))
    return replace(
        body, vertices=vertices, faces=faces, skin_segments=segments[:, None].astype(np.int32), skin_weights=one
    )


def _same_moments(points: Float) -> tuple[Float, Float, Float]:
    """Centre, axes and radii of the ellipsoid with the volume moments of the hull of points (N, 3)."""
    hull = ConvexHull(points)
    apex = points.mean(axis=0)
    corners = points[hull.simplices] - apex
    volume = np.abs(np.linalg.det(corners)) / 6.0
    first = np.einsum("t,tki->i", volume, corners) / 4.0
    total = corners.sum(axis=1)
    second = np.einsum("t,tki,tkj->ij", volume, corners, corners) + np.einsum("t,ti,tj->ij", volume, total, total)
    mean = first / volume.sum()
    covariance = second / (20.0 * volume.sum()) - np.outer(mean, mean)
    values, axes = np.linalg.eigh(covariance)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return apex + mean, axes, np.sqrt(5.0 * values)  # a solid ellipsoid has variance r² / 5 along each axis


def _unit_sphere() -> tuple[Float, Int]:
    """Vertices, scaled so that the mesh has about the sphere's volume, and faces."""
    polar = np.pi * np.arange(1, _RINGS) / _RINGS
    turn = 2 * np.pi * np.arange(_SECTORS) / _SECTORS
    ring = np.stack([np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn)),
                     np.repeat(np.cos(polar)[:, None], _SECTORS, axis=1)], axis=-1).reshape(-1, 3)  # fmt: skip
    vertices = 1.01 * np.concatenate([ring, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    r, s = (i.ravel() for i in np.meshgrid(np.arange(_RINGS - 2), np.arange(_SECTORS), indexing="ij"))
    a, b = r * _SECTORS + s, r * _SECTORS + (s + 1) % _SECTORS
    c, d = a + _SECTORS, b + _SECTORS
    first, after, last = np.arange(_SECTORS), (np.arange(_SECTORS) + 1) % _SECTORS, (_RINGS - 2) * _SECTORS
    top = np.stack([np.full(_SECTORS, len(ring)), first, after], axis=1)
    bottom = np.stack([np.full(_SECTORS, len(ring) + 1), last + after, last + first], axis=1)
    sides = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return vertices, np.concatenate([sides, top, bottom]).astype(np.int32)
