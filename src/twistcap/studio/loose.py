"""Motion that is neither the body's nor the room's: loose cloth, and things that pass behind."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float, Float32
from twistcap.body import Body
from twistcap.studio.background import smooth_noise
from twistcap.studio.config import StudioConfig, stream

_WAVES = 6
_WAVE, _SWINGS = (0.10, 0.25), (0.8, 2.5)  # m, wavelength of the folds; 1/s, their frequency
_LOOSE = ("femur", "tibia", "thigh", "shank", "humerus", "torso", "thorax", "ulna")


def flutter(body: Body, config: StudioConfig, frame: int) -> Float | None:
    """(V, 3) m displacement of the texture of loose cloth over the rest pose in a frame; None for tight clothes.

    Travelling waves of several lengths and directions, with a root mean square of `config.cloth`.
    """
    if config.cloth == 0.0:
        return None
    rng, time = stream(config.seed, "cloth"), frame / config.fps
    out = np.zeros_like(body.vertices)
    for _ in range(_WAVES):
        along, slide = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        phase = 2 * np.pi * (body.vertices @ along / rng.uniform(*_WAVE) + time * rng.uniform(*_SWINGS) + rng.random())
        out += np.sin(phase)[:, None] * slide
    loose = np.array([any(name.startswith(part) for part in _LOOSE) for name in body.segment_names])
    fraction = np.sum(body.skin_weights * loose[body.skin_segments], axis=1)
    return config.cloth / np.sqrt(_WAVES / 2) * fraction[:, None] * out


def passer(room: Float32, config: StudioConfig, number: int, camera: int, frame: int) -> None:
    """Paint a textured thing that crosses the picture (H, W, 3), in place."""
    rng = stream(config.seed, "passers", number, camera)
    height, width = room.shape[:2]
    w, h = int(width * rng.uniform(0.08, 0.16)), int(height * rng.uniform(0.3, 0.75))
    speed = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 1.2) * height / 2.0  # px/s
    x = (rng.uniform(0, width) + speed * frame / config.fps) % (width + w) - w
    y = int(rng.uniform(0.15, 0.5) * height)
    cell = rng.uniform(0.15, 0.85) * (1.0 + 0.25 * smooth_noise(rng, (h, w + 1), 5.0 * height / 280))
    shift = x - np.floor(x)
    left, right = (np.pad(cell[:, :w], ((0, 0), pad, (0, 0))) for pad in ((0, 1), (1, 0)))
    strip = (1 - shift) * left + shift * right
    cover = np.ones(w + 1)
    cover[0], cover[-1] = 1 - shift, shift
    first = int(np.floor(x))
    for column in range(w + 1):
        at = first + column
        if 0 <= at < width:
            rows = room[y : y + h, at]
            room[y : y + h, at] = (1 - cover[column]) * rows + np.clip(strip[: len(rows), column], 0, 1)
