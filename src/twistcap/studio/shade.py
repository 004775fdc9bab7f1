"""Light and texture on the samples of the rasteriser, averaged to pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32, Int
from twistcap.render.raster import barycentric

LATTICE_BITS = 5  # the texture repeats after 2⁵ lattice steps
OCTAVES = np.array([[0.018, 0.7], [0.034, 0.9], [0.070, 1.0]])  # lattice spacing (half a wave), m; amplitude


@njit(cache=True, nogil=True)
def vertex_normals(vertices: Float, faces: Int) -> Float:
    """(V, 3) unit normals, the mean of the adjoining triangles weighted by their area."""
    normals = np.zeros_like(vertices)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        n0, n1, n2 = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for i in (a, b, c):
            normals[i, 0] += n0
            normals[i, 1] += n1
            normals[i, 2] += n2
    for i in range(len(normals)):
        norm = np.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        for c in range(3):
            normals[i, c] /= max(norm, 1e-12)
    return normals


@njit(cache=True, nogil=True)
def solid_noise(lattice: Float32, octaves: Float, x: float, y: float, z: float, out: Float) -> None:
    """Adds the three channels of value noise at a rest-pose point (m) into `out` (3,); `lattice` is (n³, 3)."""
    n = 1 << LATTICE_BITS
    mask = n - 1
    for o in range(len(octaves)):
        scale, gain = 1.0 / octaves[o, 0], octaves[o, 1]
        px, py, pz = x * scale + 7.3 * o, y * scale + 3.1 * o, z * scale + 5.7 * o
        fx, fy, fz = np.floor(px), np.floor(py), np.floor(pz)
        tx, ty, tz = px - fx, py - fy, pz - fz
        tx, ty, tz = tx * tx * (3 - 2 * tx), ty * ty * (3 - 2 * ty), tz * tz * (3 - 2 * tz)
        ix, iy, iz = int(fx), int(fy), int(fz)
        for i in range(2):
            wx, kx = gain * (tx if i else 1 - tx), (ix + i) & mask
            for j in range(2):
                wxy, kxy = wx * (ty if j else 1 - ty), (kx * n + ((iy + j) & mask)) * n
                for k in range(2):
                    weight, at = wxy * (tz if k else 1 - tz), np.uint64(kxy + ((iz + k) & mask))
                    out[0] += weight * lattice[at, 0]
                    out[1] += weight * lattice[at, 1]
                    out[2] += weight * lattice[at, 2]


def solid_noise_reference(lattice: Float32, octaves: Float, points: Float) -> Float:
    """Readable twin of `solid_noise` for points (N, 3) -> (N, 3)."""
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
def shade(
    face_index: Int,
    origin: tuple[int, int],
    factor: int,
    faces: Int,
    pixels: Float,
    inverse_depth: Float,
    rest: Float,
    normals: Float,
    albedo: Float,
    contrast: Float,
    lattice: Float32,
    octaves: Float,
    lights: Float,
    ambient: Float,
) -> Float:
    """Lit and textured samples averaged over blocks of factor × factor.

    Args:
        face_index: (factor H, factor W) visible triangle of each sample, -1 for none.
        origin: (x, y) of the first sample.
        factor: samples per pixel and axis.
        faces, pixels, inverse_depth: as given to the rasteriser.
        rest: (V, 3) rest-pose vertices, m, where the texture lives.
        normals: (V, 3) world normals of the posed surface.
        albedo: (F, 3) colour, contrast: (F,) of the texture on it.
        lattice, octaves: the texture, see `solid_noise`.
        lights: (L, 6) unit direction towards each light and its colour.
        ambient: (3,) colour of the light from everywhere (70 % of it from below, all from above).

    Returns:
        (H, W, 4) colour times coverage, and coverage in [0, 1].
    """
    height, width = face_index.shape[0] // factor, face_index.shape[1] // factor
    out = np.zeros((height, width, 4))
    share = 1.0 / (factor * factor)
    texture, light = np.zeros(3), np.zeros(3)
    for row in range(height * factor):
        for col in range(width * factor):
            f = face_index[row, col]
            if f < 0:
                continue
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            ax, ay = pixels[a, 0], pixels[a, 1]
            bx, by = pixels[b, 0] - ax, pixels[b, 1] - ay
            cx, cy = pixels[c, 0] - ax, pixels[c, 1] - ay
            x, y = col + origin[0] - ax, row + origin[1] - ay
            area = bx * cy - by * cx
            wb = (x * cy - y * cx) / area * inverse_depth[b]
            wc = (bx * y - by * x) / area * inverse_depth[c]
            wa = (1.0 - (x * cy - y * cx) / area - (bx * y - by * x) / area) * inverse_depth[a]
            total = wa + wb + wc
            wa, wb, wc = wa / total, wb / total, wc / total
            texture[0] = texture[1] = texture[2] = 0.0
            if contrast[f] > 0.0:
                px = wa * rest[a, 0] + wb * rest[b, 0] + wc * rest[c, 0]
                py = wa * rest[a, 1] + wb * rest[b, 1] + wc * rest[c, 1]
                pz = wa * rest[a, 2] + wb * rest[b, 2] + wc * rest[c, 2]
                solid_noise(lattice, octaves, px, py, pz, texture)
            n0 = wa * normals[a, 0] + wb * normals[b, 0] + wc * normals[c, 0]
            n1 = wa * normals[a, 1] + wb * normals[b, 1] + wc * normals[c, 1]
            n2 = wa * normals[a, 2] + wb * normals[b, 2] + wc * normals[c, 2]
            norm = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            n0, n1, n2 = n0 / norm, n1 / norm, n2 / norm
            for ch in range(3):
                light[ch] = ambient[ch] * (0.85 + 0.15 * n2)
            for k in range(len(lights)):
                cosine = max(0.0, n0 * lights[k, 0] + n1 * lights[k, 1] + n2 * lights[k, 2])
                for ch in range(3):
                    light[ch] += cosine * lights[k, 3 + ch]
            i, j = row // factor, col // factor
            for ch in range(3):
                value = albedo[f, ch] * (1.0 + contrast[f] * texture[ch]) * light[ch]
                out[i, j, ch] += share * min(max(value, 0.0), 1.0)
            out[i, j, 3] += share
    return out


def shade_reference(
    face_index: Int,
    origin: tuple[int, int],
    factor: int,
    faces: Int,
    pixels: Float,
    inverse_depth: Float,
    rest: Float,
    normals: Float,
    albedo: Float,
    contrast: Float,
    lattice: Float32,
    octaves: Float,
    lights: Float,
    ambient: Float,
) -> Float:
    """Readable twin of `shade`."""
    rows, cols = np.nonzero(face_index >= 0)
    f = face_index[rows, cols]
    corners = faces[f]
    weights = barycentric(f, faces, pixels, inverse_depth, np.stack([cols, rows], axis=1) + np.array(origin))
    points = np.einsum("nk,nki->ni", weights, rest[corners])
    n = np.einsum("nk,nki->ni", weights, normals[corners])
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    light = ambient * (0.85 + 0.15 * n[:, 2:])
    for source in lights:
        light = light + np.maximum(n @ source[:3], 0.0)[:, None] * source[3:]
    texture = 1.0 + contrast[f, None] * solid_noise_reference(lattice, octaves, points)
    samples = np.zeros((*face_index.shape, 4))
    samples[rows, cols, :3] = np.clip(albedo[f] * texture * light, 0.0, 1.0)
    samples[rows, cols, 3] = 1.0
    H, W = face_index.shape[0] // factor, face_index.shape[1] // factor
    return samples.reshape(H, factor, W, factor, 4).mean(axis=(1, 3))
