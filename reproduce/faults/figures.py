"""Several bodies and pieces of furniture in one picture, each before what is behind it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from twistcap.arrays import Float, Int
from twistcap.body import Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.camera import Camera
from twistcap.camera.projection import project
from twistcap.render.raster import rasterise
from twistcap.studio.look import Look
from twistcap.studio.picture import SAMPLES, Layer, shade


@dataclass(frozen=True)
class Figure:
    """A surface in the room and its colours.

    Attributes:
        vertices: (V, 3) world, m.
        rest: (V, 3) where the texture is looked up, m.
        faces: (F, 3) counter-clockwise seen from outside.
        cover: (V, G) fraction of each garment in each vertex.
        albedo: (G, 3) colour of each garment.
        contrast: (G,) of the texture on it.
    """

    vertices: Float
    rest: Float
    faces: Int
    cover: Float
    albedo: Float
    contrast: Float


def figure_of(posed: Posed, look: Look) -> Figure:
    """A body in its clothes."""
    return Figure(posed.vertices, posed.body.vertices, posed.body.faces, look.cover, look.albedo, look.contrast)


def together(figures: Sequence[Figure], camera: Camera, look: Look) -> Layer:
    """Figures in a camera without distortion, under the lights of a look, in the window that they cover.

    As `twistcap.studio.picture.render_body`, which draws one.
    """
    n, vertices = SAMPLES, np.concatenate([f.vertices for f in figures])
    starts = np.cumsum([0, *(len(f.vertices) for f in figures[:-1])])
    faces = np.concatenate([f.faces + start for f, start in zip(figures, starts, strict=True)]).astype(np.int32)
    clothes = Look(
        np.asarray(block_diag(*(f.cover for f in figures)), float),
        np.concatenate([f.albedo for f in figures]),
        np.concatenate([f.contrast for f in figures]),
        look.lattice,
        look.lights,
    )
    pixels, nearness = project(camera.scaled(n).P, vertices)
    shown = pixels[nearness > 0] if np.any(nearness > 0) else np.zeros((1, 2))
    low = np.clip(np.floor(shown.min(axis=0) / n) - 1, 0, camera.size).astype(int)
    high = np.clip(np.ceil(shown.max(axis=0) / n) + 2, 0, camera.size).astype(int)
    (x, y), (width, height) = low.tolist(), (n * (high - low)).tolist()
    index, _ = rasterise(pixels, nearness, faces, (n * x, n * y), (width, height))
    rest = np.concatenate([f.rest for f in figures])
    drawn = (faces, pixels, nearness, rest, unit_vertex_normals(vertices, faces))
    return Layer(x, y, shade(index, (n * x, n * y), n, drawn, clothes))


def box(low: Float, high: Float, heading: float, place: Float, colour: Float) -> Figure:
    """A box from `low` to `high` (3,) m, turned by `heading` rad about the vertical and set down at `place` (3,)."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    rest = (low + corners * (high - low))[np.array(sides).ravel()]  # corners of their own: flat shading
    c, s = np.cos(heading), np.sin(heading)
    vertices = rest @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T + place
    faces = np.array([(4 * k + a, 4 * k + b, 4 * k + d) for k in range(6) for a, b, d in ((0, 1, 2), (0, 2, 3))])
    return Figure(vertices, rest, faces.astype(np.int32), np.ones((24, 1)), colour[None], np.array([0.05]))
