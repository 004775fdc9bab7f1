"""Light and texture on the samples of the rasteriser, averaged to pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32, Int
from twistcap.render.raster import barycentric
from twistcap.render.view import blended
from twistcap.studio.look import LATTICE_BITS, Look

OCTAVES = np.array([[0.018, 0.7], [0.034, 0.9], [0.070, 1.0]])  # lattice spacing (half a wave), m; amplitude

DrawnMesh = tuple[Int, Float, Float, Float, Float]
"""Faces, pixels and inverse depths of the rasteriser, rest-pose vertices (V, 3), m, for the texture, and world normals
(V, 3) of the posed surface."""


def shade(face_index: Int, origin: tuple[int, int], factor: int, drawn: DrawnMesh, look: Look) -> Float32:
    """(H, W, 4) colour times coverage, and coverage in [0, 1], of lit and textured samples, averaged over blocks.

    Args:
        face_index: (factor H, factor W) visible triangle of each sample, -1 for none; `origin` (x, y) is the first.
        drawn: the posed body.
        look: its clothes, of which a sample shows the one with the largest fraction, and the lights.
    """
    faces, pixels, inverse_depth, rest, normals = drawn
    rows, cols = np.nonzero(face_index >= 0)
    f = face_index[rows, cols]
    weights = barycentric(f, faces, pixels, inverse_depth, np.stack([cols, rows], axis=1) + np.array(origin))

    cover, place, normal = (blended(values, faces[f], weights) for values in (look.cover, rest, normals))
    garment = np.argmax(cover, axis=1)
    texture = 1.0 + look.contrast[garment, None] * solid_noise(look.lattice, OCTAVES, place)
    samples = np.zeros((*face_index.shape, 4))
    samples[rows, cols, :3] = np.clip(look.albedo[garment] * texture * _light(normal, look.lights), 0.0, 1.0)
    samples[rows, cols, 3] = 1.0
    H, W = face_index.shape[0] // factor, face_index.shape[1] // factor
    return samples.reshape(H, factor, W, factor, 4).mean(axis=(1, 3)).astype(np.float32)


def _light(normals: Float, lights: Float) -> Float:
    """(N, 3) light on surface points of these normals (N, 3), by Lambert's law.

    Ambient light is 15 % stronger from above and weaker from below.
    """
    n = normals / np.sqrt((normals * normals).sum(axis=1, keepdims=True))
    ambient = lights[-1, 3:] * (0.85 + 0.15 * n[:, 2:])
    return ambient + np.maximum(n @ lights[:-1, :3].T, 0.0) @ lights[:-1, 3:]


@njit(cache=True, nogil=True)
def solid_noise(lattice: Float32, octaves: Float, points: Float) -> Float:
    """(N, 3) channels of value noise at rest-pose points (N, 3), m; `lattice` is (n³, 3)."""
    n = 1 << LATTICE_BITS
    mask, out = n - 1, np.zeros((len(points), 3))
    for v in range(len(points)):
        for o in range(len(octaves)):
            scale, gain = 1.0 / octaves[o, 0], octaves[o, 1]
            px, py, pz = points[v, 0] * scale + 7.3 * o, points[v, 1] * scale + 3.1 * o, points[v, 2] * scale + 5.7 * o
            fx, fy, fz = np.floor(px), np.floor(py), np.floor(pz)
            tx, ty, tz = px - fx, py - fy, pz - fz
            tx, ty, tz = tx * tx * (3 - 2 * tx), ty * ty * (3 - 2 * ty), tz * tz * (3 - 2 * tz)
            ix, iy = int(fx), int(fy)
            near, far = np.uint64(int(fz) & mask), np.uint64((int(fz) + 1) & mask)
            for i in range(2):
                for j in range(2):
                    weight = gain * (tx if i else 1 - tx) * (ty if j else 1 - ty)
                    row = np.uint64((((ix + i) & mask) * n + ((iy + j) & mask)) * n)  # unsigned: no check for below 0
                    p, q, wp, wq = row + near, row + far, weight * (1 - tz), weight * tz
                    for channel in range(3):
                        out[v, channel] += wp * lattice[p, channel] + wq * lattice[q, channel]
    return out


def solid_noise_reference(lattice: Float32, octaves: Float, points: Float) -> Float:
    """Readable twin of `solid_noise`."""
    n = 1 << LATTICE_BITS
    out = np.zeros((len(points), 3))
    for o, (spacing, gain) in enumerate(octaves):
        p = points / spacing + o * np.array([7.3, 3.1, 5.7])
        base = np.floor(p)
        t = p - base
        t = t * t * (3 - 2 * t)
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(np.array(corner) == 1, t, 1 - t), axis=1)
            ix, iy, iz = ((base + corner).astype(int) % n).T
            out += gain * weight[:, None] * lattice[(ix * n + iy) * n + iz]
    return out
