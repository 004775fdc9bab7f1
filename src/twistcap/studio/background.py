"""A cluttered room behind the person, one picture per camera, and occluders in front."""

from __future__ import annotations

import cv2
import numpy as np

from twistcap.arrays import AnyArray, Float, Float32, UInt8
from twistcap.studio.config import StudioConfig, stream
from twistcap.studio.look import HARD_GREY

_OVER = 3  # shapes are drawn this many times larger and averaged down: smooth edges


def background(config: StudioConfig, camera: int) -> Float32:
    """(H, W, 3) picture in [0, 1] of the empty room in a camera."""
    rng = stream(config.seed, "background", camera)
    width, height = config.size
    canvas = _room(rng, width * _OVER, height * _OVER)
    for k in range(30):
        _draw_shape(canvas, rng, k)
    cells = [canvas[i::_OVER, j::_OVER].astype(float) for i in range(_OVER) for j in range(_OVER)]
    picture = np.sum(cells, axis=0) / (255.0 * len(cells))
    unit = height / 280
    for spacing, gain in ((60 * unit, 0.05), (9 * unit, 0.035), (3.5 * unit, 0.025)):
        picture += gain * smooth_noise(rng, (height, width), spacing)
    if config.hard:
        picture = HARD_GREY + 0.3 * (picture - picture.mean())
    return np.clip(picture, 0.0, 1.0).astype(np.float32)


def smooth_noise(rng: np.random.Generator, shape: tuple[int, int], spacing: float) -> Float:
    """(H, W, 3) value noise of unit lattice variance, on lattice points `spacing` px apart."""
    rows, cols = (_interpolation(n, spacing) for n in shape)
    common = rng.normal(size=(rows.shape[1], cols.shape[1], 1))
    own = rng.normal(size=(rows.shape[1], cols.shape[1], 3))
    return np.einsum("ik,klc,jl->ijc", rows, 0.95 * common + 0.3 * own, cols, optimize=True)


def _interpolation(n: int, spacing: float) -> Float:
    """(n, m) smooth-step weights of m lattice points at n pixels."""
    at = np.arange(n) / spacing
    base = at.astype(int)
    t = at - base
    t = t * t * (3 - 2 * t)
    out = np.zeros((n, int(base[-1]) + 2))
    out[np.arange(n), base], out[np.arange(n), base + 1] = 1 - t, t
    return out


def _room(rng: np.random.Generator, width: int, height: int) -> UInt8:
    """Wall, floor and skirting board."""
    canvas = np.empty((height, width, 3), np.uint8)
    horizon = int(height * rng.uniform(0.55, 0.72))
    canvas[:horizon], canvas[horizon:] = muted_colour(rng, 0.1), muted_colour(rng, 0.1)
    canvas[horizon : horizon + height // 70] = muted_colour(rng, 0.08)
    return canvas


def muted_colour(rng: np.random.Generator, saturation: float) -> tuple[float, ...]:
    """A colour whose grey is spread as widely as that of clothes."""
    grey = rng.uniform(35, 215)
    return tuple(float(np.clip(round(grey * (1 + saturation * rng.normal())), 0, 255)) for _ in range(3))


def _draw_shape(canvas: AnyArray, rng: np.random.Generator, k: int) -> None:
    """One rectangle, ellipse or line; the first ones are large (furniture), later ones smaller."""
    height, width = canvas.shape[:2]
    extent = height * (0.32 if k < 10 else 0.14) * rng.uniform(0.3, 1.0, size=2)
    centre = (float(rng.uniform(0, width)), float(rng.uniform(0, height)))
    angle = float(rng.choice([0.0, rng.uniform(-30, 30)]))
    colour, kind = muted_colour(rng, 0.2), rng.random()
    box = (centre, (float(extent[0]), float(extent[1])), angle)
    if kind < 0.55:
        cv2.fillPoly(canvas, [np.round(cv2.boxPoints(box)).astype(np.int32)], colour)
    elif kind < 0.8:
        cv2.ellipse(canvas, box, colour, -1)
    else:
        ends = np.round(cv2.boxPoints(box)).astype(int)
        cv2.line(canvas, ends[0].tolist(), ends[2].tolist(), colour, int(rng.integers(2, 8)))


def occluder_layer(config: StudioConfig, camera: int) -> Float32:
    """(H, W, 4) colour times coverage, and coverage, of posts and boxes in front of the person."""
    rng = stream(config.seed, "occluders", camera)
    width, height = config.size
    layer = np.zeros((height, width, 4))
    for _ in range(config.occluders):
        w = int(width * rng.uniform(0.03, 0.07))
        h = int(height * rng.uniform(0.25, 0.7))
        x, y = int(rng.uniform(0.25, 0.75) * width), int(rng.uniform(0.3, 0.9) * height)
        layer[max(0, y) : y + h, x : x + w, :3] = np.array(muted_colour(rng, 0.2)) / 255
        layer[max(0, y) : y + h, x : x + w, 3] = 1.0
    layer[..., :3] *= np.clip(1 + 0.1 * smooth_noise(rng, (height, width), 6.0), 0, 1.5)
    return np.clip(layer, 0.0, 1.0).astype(np.float32)
