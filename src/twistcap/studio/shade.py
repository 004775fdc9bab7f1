"""Light and texture on the samples of the rasteriser, averaged to pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32, Int
from twistcap.render.raster import barycentric

LATTICE_BITS = 5  # the texture repeats after 2⁵ lattice steps
OCTAVES = np.array([[0.018, 0.7], [0.034, 0.9], [0.070, 1.0]])  # lattice spacing (half a wave), m; amplitude

DrawnMesh = tuple[Int, Float, Float, Float, Float]
"""Faces, pixels and inverse depths of the rasteriser, rest-pose vertices (V, 3), m, for the texture, and world normals
(V, 3) of the posed surface."""
Dress = tuple[Float, Float, Float, Float32, Float]
"""Cover (V, G), the fraction of each garment in each vertex (a sample takes the largest), the garments' colours (G, 3)
and contrast (G,) of the texture on them, and the texture: lattice (n³, 3) and octaves."""


@njit(cache=True, nogil=True)
def _solid_noise(lattice: Float32, octaves: Float, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Three channels of value noise at a rest-pose point (m); `lattice` is (n³, 3)."""
    n = 1 << LATTICE_BITS
    mask = n - 1
    red, green, blue = 0.0, 0.0, 0.0
    for o in range(len(octaves)):
        scale, gain = 1.0 / octaves[o, 0], octaves[o, 1]
        px, py, pz = x * scale + 7.3 * o, y * scale + 3.1 * o, z * scale + 5.7 * o
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
                red += wp * lattice[p, 0] + wq * lattice[q, 0]
                green += wp * lattice[p, 1] + wq * lattice[q, 1]
                blue += wp * lattice[p, 2] + wq * lattice[q, 2]
    return red, green, blue


def _solid_noise_reference(lattice: Float32, octaves: Float, points: Float) -> Float:
    """Readable twin of `_solid_noise` for points (N, 3) -> (N, 3)."""
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


@njit(cache=True, nogil=True)
def _corner_weights(
    pixels: Float, inverse_depth: Float, corners: Int, x: float, y: float
) -> tuple[float, float, float]:
    """Perspective-correct barycentric coordinates of an image point on a triangle."""
    a, b, c = corners[0], corners[1], corners[2]
    ax, ay = pixels[a, 0], pixels[a, 1]
    bx, by = pixels[b, 0] - ax, pixels[b, 1] - ay
    cx, cy = pixels[c, 0] - ax, pixels[c, 1] - ay
    x, y = x - ax, y - ay
    scale = 1.0 / (bx * cy - by * cx)
    lb, lc = (x * cy - y * cx) * scale, (bx * y - by * x) * scale
    wa, wb, wc = (1.0 - lb - lc) * inverse_depth[a], lb * inverse_depth[b], lc * inverse_depth[c]
    total = 1.0 / (wa + wb + wc)
    return wa * total, wb * total, wc * total


@njit(cache=True, nogil=True)
def _blend(values: Float, corners: Int, weights: tuple[float, float, float], column: int) -> float:
    """One column of a vertex array, interpolated on a triangle."""
    wa, wb, wc = weights
    return wa * values[corners[0], column] + wb * values[corners[1], column] + wc * values[corners[2], column]


@njit(cache=True, nogil=True)
def _garment(cover: Float, corners: Int, weights: tuple[float, float, float]) -> int:
    """The garment of largest fraction at a surface point."""
    a, b, c = corners[0], corners[1], corners[2]
    best, most = 0, -1.0
    for g in range(cover.shape[1]):
        if cover[a, g] > 0.5 and cover[b, g] > 0.5 and cover[c, g] > 0.5:
            return g
        fraction = _blend(cover, corners, weights, g)
        if fraction > most:
            best, most = g, fraction
    return best


@njit(cache=True, nogil=True)
def _illuminate(normals: Float, corners: Int, weights: tuple[float, float, float], lights: Float, light: Float) -> None:
    """Lambert's law: light (3,) on a surface point; the last row of `lights` is the ambient light."""
    n0, n1, n2 = (
        _blend(normals, corners, weights, 0),
        _blend(normals, corners, weights, 1),
        _blend(normals, corners, weights, 2),
    )
    norm = 1.0 / np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    n0, n1, n2 = n0 * norm, n1 * norm, n2 * norm
    last = len(lights) - 1
    for ch in range(3):
        light[ch] = lights[last, 3 + ch] * (0.85 + 0.15 * n2)
    for k in range(last):
        cosine = max(0.0, n0 * lights[k, 0] + n1 * lights[k, 1] + n2 * lights[k, 2])
        for ch in range(3):
            light[ch] += cosine * lights[k, 3 + ch]


@njit(cache=True, nogil=True)
def shade(
    face_index: Int, origin: tuple[int, int], factor: int, drawn: DrawnMesh, dress: Dress, lights: Float
) -> Float:
    """Lit and textured samples averaged over blocks of factor × factor.

    Args:
        face_index: (factor H, factor W) visible triangle of each sample, -1 for none.
        origin: (x, y) of the first sample.
        factor: samples per pixel and axis.
        drawn, dress: the posed body and its clothes.
        lights: (L + 1, 6) unit direction towards each light and its colour; the last row is the ambient light, 15 %
            stronger from above and weaker from below.

    Returns:
        (H, W, 4) colour times coverage, and coverage in [0, 1].
    """
    faces, pixels, inverse_depth, rest, normals = drawn
    cover, albedo, contrast, lattice, octaves = dress
    height, width = face_index.shape[0] // factor, face_index.shape[1] // factor
    out = np.zeros((height, width, 4))
    area = 1.0 / (factor * factor)
    texture, light = np.zeros(3), np.zeros(3)
    for row in range(height * factor):
        for col in range(width * factor):
            if face_index[row, col] < 0:
                continue
            corners = faces[face_index[row, col]]
            weights = _corner_weights(pixels, inverse_depth, corners, float(col + origin[0]), float(row + origin[1]))
            g = _garment(cover, corners, weights)
            if contrast[g] > 0.0:
                x, y = _blend(rest, corners, weights, 0), _blend(rest, corners, weights, 1)
                z = _blend(rest, corners, weights, 2)
                texture[0], texture[1], texture[2] = _solid_noise(lattice, octaves, x, y, z)
            _illuminate(normals, corners, weights, lights, light)
            i, j = row // factor, col // factor
            for ch in range(3):
                value = albedo[g, ch] * (1.0 + contrast[g] * texture[ch]) * light[ch]
                out[i, j, ch] += area * min(max(value, 0.0), 1.0)
            out[i, j, 3] += area
    return out


def shade_reference(
    face_index: Int, origin: tuple[int, int], factor: int, drawn: DrawnMesh, dress: Dress, lights: Float
) -> Float:
    """Readable twin of `shade`."""
    faces, pixels, inverse_depth, rest, normals = drawn
    cover, albedo, contrast, lattice, octaves = dress
    rows, cols = np.nonzero(face_index >= 0)
    f = face_index[rows, cols]
    weights = barycentric(f, faces, pixels, inverse_depth, np.stack([cols, rows], axis=1) + np.array(origin))

    def blend(values: Float) -> Float:
        return np.einsum("nk,nki->ni", weights, values[faces[f]])

    g = np.argmax(blend(cover), axis=1)
    n = blend(normals)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    light = lights[-1, 3:] * (0.85 + 0.15 * n[:, 2:])
    light = light + np.maximum(n @ lights[:-1, :3].T, 0.0) @ lights[:-1, 3:]
    texture = 1.0 + contrast[g, None] * _solid_noise_reference(lattice, octaves, blend(rest))
    samples = np.zeros((*face_index.shape, 4))
    samples[rows, cols, :3] = np.clip(albedo[g] * texture * light, 0.0, 1.0)
    samples[rows, cols, 3] = 1.0
    H, W = face_index.shape[0] // factor, face_index.shape[1] // factor
    return samples.reshape(H, factor, W, factor, 4).mean(axis=(1, 3))
