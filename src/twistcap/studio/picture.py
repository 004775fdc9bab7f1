"""Anti-aliased pictures of a posed body (rasterised three times larger, shaded, averaged), and what disturbs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from twistcap.arrays import Float, Float32, Int, UInt8
from twistcap.body import Pose, Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.camera import Camera
from twistcap.camera.projection import project
from twistcap.render.raster import barycentric, rasterise
from twistcap.render.view import blended
from twistcap.studio.config import StudioConfig, stream
from twistcap.studio.look import LATTICE_BITS, Look

SAMPLES = 3  # per pixel and axis
OCTAVES = np.array([[0.018, 0.7], [0.034, 0.9], [0.070, 1.0]])  # lattice spacing (half a wave), m; amplitude

DrawnMesh = tuple[Int, Float, Float, Float, Float]
"""Faces, pixels and inverse depths of the rasteriser, rest-pose vertices (V, 3), m, for the texture, and world normals
(V, 3) of the posed surface."""


@dataclass(frozen=True)
class Layer:
    """A window of an image: pixels (H, W, 4) of colour times coverage, and coverage; its first pixel at (x, y)."""

    x: int
    y: int
    pixels: Float32

    def over(self, picture: Float32) -> None:
        """Lay the window over a picture (H, W, 3), in place."""
        h, w = self.pixels.shape[:2]
        part = picture[self.y : self.y + h, self.x : self.x + w]
        part *= 1.0 - self.pixels[..., 3:]
        part += self.pixels[..., :3]


def render_body(posed: Posed, camera: Camera, look: Look, slide: Float | None = None) -> Layer:
    """A body in a camera without distortion, in the window that it covers.

    The texture is looked up at `slide` (V, 3) m from the vertices of the rest pose.
    """
    faces, n = posed.body.faces, SAMPLES
    pixels, inverse_depth = project(camera.scaled(n).P, posed.vertices)
    shown = pixels[inverse_depth > 0] if np.any(inverse_depth > 0) else np.zeros((1, 2))
    low = np.clip(np.floor(shown.min(axis=0) / n) - 1, 0, camera.size).astype(int)
    high = np.clip(np.ceil(shown.max(axis=0) / n) + 2, 0, camera.size).astype(int)
    (x, y), (width, height) = low.tolist(), (n * (high - low)).tolist()
    index, _ = rasterise(pixels, inverse_depth, faces, (n * x, n * y), (width, height))
    rest = posed.body.vertices if slide is None else posed.body.vertices + slide
    drawn = (faces, pixels, inverse_depth, rest, unit_vertex_normals(posed.vertices, faces))
    return Layer(x, y, shade(index, (n * x, n * y), n, drawn, look))


def picture_of(
    moments: Sequence[Posed], camera: Camera, look: Look, room: Float32, slide: Float | None = None
) -> Float32:
    """(H, W, 3) the room with the body, averaged over the moments of the open shutter."""
    pictures = [room.copy() for _ in moments]
    for posed, picture in zip(moments, pictures, strict=True):
        render_body(posed, camera, look, slide).over(picture)
    return pictures[0] if len(pictures) == 1 else np.mean(np.stack(pictures), axis=0).astype(np.float32)


def between(first: Pose, second: Pose, fraction: float) -> Pose:
    """The pose at a fraction of the way from one to another; outside [0, 1] it is extrapolated."""
    return first.retract(fraction * second.minus(first))


def marred(picture: Float32, config: StudioConfig, frame: int, camera: int) -> UInt8:
    """The camera's 8-bit image of a picture (H, W, 3) or (H, W) in [0, 1], which is overwritten."""
    if config.sensor_noise > 0:
        noise = stream(config.seed, "sensor", camera, frame).standard_normal(picture.shape, dtype=np.float32)
        noise *= np.float32(config.sensor_noise)
        picture += noise
    paint_rectangles(picture, config.rectangles, stream(config.seed, "rectangles", camera, frame))
    replace_pixels(picture, config.noise_fraction(frame), stream(config.seed, "uniform", camera, frame))
    picture *= np.float32(255)
    return np.clip(np.rint(picture, out=picture), 0, 255, out=picture).astype(np.uint8)


def paint_rectangles(picture: Float32, count: int, rng: np.random.Generator) -> None:
    """Paint rectangles of random place, colour and size (up to a tenth of the width) into a picture, in place."""
    height, width = picture.shape[:2]
    for _ in range(count):
        x, y = rng.integers(0, width), rng.integers(0, height)
        w, h = rng.integers(max(2, width // 60), max(3, width // 10), size=2)
        picture[y : y + h, x : x + w] = rng.random(picture.shape[2:])


def replace_pixels(picture: Float32, fraction: float, rng: np.random.Generator) -> None:
    """Replace a fraction of the pixels by uniform noise in every channel, in place."""
    if fraction <= 0:
        return
    hit = rng.random(picture.shape[:2]) < fraction
    picture[hit] = rng.random((int(hit.sum()), *picture.shape[2:]))


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

    corners = faces[f]
    cover, place, normal = (blended(values, corners, weights) for values in (look.cover, rest, normals))
    garment = np.argmax(cover, axis=1)
    texture = 1.0 + look.contrast[garment, None] * solid_noise(look.lattice, OCTAVES, place)
    samples = np.zeros((*face_index.shape, 4))
    samples[rows, cols, :3] = np.clip(look.albedo[garment] * texture * _light(normal, look.lights), 0.0, 1.0)
    samples[rows, cols, 3] = 1.0
    H, W = face_index.shape[0] // factor, face_index.shape[1] // factor
    rows = samples.reshape(H, factor, 4 * factor * W).sum(axis=1)  # a mean over both axes at once takes twice the time
    return (rows.reshape(H, W, factor, 4).sum(axis=2) / factor**2).astype(np.float32)


def _light(normals: Float, lights: Float) -> Float:
    """(N, 3) light on surface points of these normals (N, 3), by Lambert's law; ambient light comes from above."""
    n = normals / np.sqrt(np.einsum("ni,ni->n", normals, normals))[:, None]
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
