"""How far two surfaces lie apart."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from twistcap.arrays import Float, Int

_SAMPLES, _DENSE = 5000, 60000


def surface_samples(vertices: Float, faces: Int, count: int, seed: int = 0) -> tuple[Float, Int]:
    """Random points (count, 3) of a triangle mesh, evenly over its area, and the face (count,) of each."""
    rng = np.random.default_rng(seed)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    face = rng.choice(len(faces), count, p=area / area.sum()).astype(np.int32)
    u, v = rng.random((2, count))
    beyond = u + v > 1.0
    u[beyond], v[beyond] = 1.0 - u[beyond], 1.0 - v[beyond]
    return a[face] + u[:, None] * (b - a)[face] + v[:, None] * (c - a)[face], face


def surface_distances(vertices: Float, faces: Int, to_vertices: Float, to_faces: Int) -> Float:
    """Distances (5000,) of points spread over one surface from another, in its unit.

    The other surface is sampled densely; the distance is that from the tangent plane of the nearest sample, which for
    surfaces that are smooth between samples is the distance from the surface.
    """
    points, _ = surface_samples(vertices, faces, _SAMPLES)
    dense, face = surface_samples(to_vertices, to_faces, _DENSE, seed=1)
    away, nearest = KDTree(dense).query(points)
    a, b, c = (to_vertices[to_faces[face[nearest], k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    height = np.abs(np.einsum("ni,ni->n", points - dense[nearest], normal))
    spacing = np.sqrt(_area(to_vertices, to_faces) / _DENSE)
    return np.where(away < 3.0 * spacing, height, away)


def _area(vertices: Float, faces: Int) -> float:
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
