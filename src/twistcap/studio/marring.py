"""Disturbances of an image after the lens: sensor noise, painted rectangles, uniform noise."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float32, UInt8
from twistcap.studio.config import StudioConfig, stream


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
