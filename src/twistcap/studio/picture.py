"""Anti-aliased pictures of a posed body (rasterised three times larger, shaded, averaged), and what disturbs them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Float, Float32, UInt8
from twistcap.body import Pose, Posed
from twistcap.body.kinematics import unit_vertex_normals
from twistcap.camera import Camera
from twistcap.camera.projection import project
from twistcap.render.raster import rasterise
from twistcap.studio.config import StudioConfig, stream
from twistcap.studio.look import Look
from twistcap.studio.shade import shade

SAMPLES = 3  # per pixel and axis


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

    Sample ``SAMPLES * i + (SAMPLES - 1) / 2`` is the centre of pixel i, as in `Camera.scaled`. The texture is looked
    up at `slide` (V, 3) m from the vertices of the rest pose.
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
