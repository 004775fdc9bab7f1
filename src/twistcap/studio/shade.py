"""Light and texture on the samples of the rasteriser, averaged to pixels."""

from __future__ import annotations

import numpy as np
from numba import njit

from twistcap._typing import Float, Float32, Int
from twistcap.render.raster import barycentric

OCTAVES = np.array([[0.018, 0.7], [0.034, 0.9], [0.070, 1.0]])  # lattice spacing in m, amplitude; a wave is two spacings


@njit(cache=True, nogil=True)
def vertex_normals(vertices: Float, faces: Int) -> Float:
    """(V, 3) unit normals, the mean of the adjoining triangles weighted by their area."""
    normals = np.zeros_like(vertices)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        n0, n1, n2 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        for i in (a, b, c):
            normals[i, 0] += n0
            normals[i, 1] += n1
            normals[i, 2] += n2
    for i in range(len(normals)):
        norm = np.sqrt(normals[i, 0] ** 2 + normals[i, 1] ** 2 + normals[i, 2] ** 2)
        normals[i] /= max(norm, 1e-12)
    return normals


@njit(cache=True, nogil=True)
def solid_noise(lattice: Float32, octaves: Float, x: float, y: float, z: float, out: Float) -> None:
    """Adds the three channels of value noise at a rest-pose point (m) into `out` (3,); `lattice` is (n, n, n, 3)."""
    mask = len(lattice) - 1  # n is a power of two
    for o in range(len(octaves)):
        scale, gain = 1.0 / octaves[o, 0], octaves[o, 1]
        px, py, pz = x * scale + 7.3 * o, y * scale + 3.1 * o, z * scale + 5.7 * o
        fx, fy, fz = np.floor(px), np.floor(py), np.floor(pz)
        tx, ty, tz = px - fx, py - fy, pz - fz
        tx, ty, tz = tx * tx * (3 - 2 * tx), ty * ty * (3 - 2 * ty), tz * tz * (3 - 2 * tz)
        ix, iy, iz = int(fx) & mask, int(fy) & mask, int(fz) & mask
        jx, jy, jz = (ix + 1) & mask, (iy + 1) & mask, (iz + 1) & mask
        for c in range(3):
            a = lattice[ix, iy, iz, c] * (1 - tx) + lattice[jx, iy, iz, c] * tx
            b = lattice[ix, jy, iz, c] * (1 - tx) + lattice[jx, jy, iz, c] * tx
            d = lattice[ix, iy, jz, c] * (1 - tx) + lattice[jx, iy, jz, c] * tx
            e = lattice[ix, jy, jz, c] * (1 - tx) + lattice[jx, jy, jz, c] * tx
            near, far = a * (1 - ty) + b * ty, d * (1 - ty) + e * ty
            out[c] += gain * (near * (1 - tz) + far * tz)


def solid_noise_reference(lattice: Float32, octaves: Float, points: Float) -> Float:
    """Readable twin of `solid_noise` for points (N, 3) -> (N, 3)."""
    n = len(lattice)
    out = np.zeros((len(points), 3))
    for o, (spacing, gain) in enumerate(octaves):
        p = points / spacing + o * np.array([7.3, 3.1, 5.7])
        base = np.floor(p)
        t = p - base
        t = t * t * (3 - 2 * t)
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(np.array(corner) == 1, t, 1 - t), axis=1)
            ix, iy, iz = ((base + corner).astype(int) % n).T
            out += gain * weight[:, None] * lattice[ix, iy, iz]
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
    texture = np.zeros(3)
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
            texture[:] = 0.0
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
            cell = out[row // factor, col // factor]
            for ch in range(3):
                light = ambient[ch] * (0.85 + 0.15 * n2)
                for k in range(len(lights)):
                    cosine = n0 * lights[k, 0] + n1 * lights[k, 1] + n2 * lights[k, 2]
                    light += max(cosine, 0.0) * lights[k, 3 + ch]
                value = albedo[f, ch] * (1.0 + contrast[f] * texture[ch]) * light
                cell[ch] += share * min(max(value, 0.0), 1.0)
            cell[3] += share
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
