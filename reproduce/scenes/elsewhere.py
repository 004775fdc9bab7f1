"""A scene whose colours are alike as a whole and differ everywhere: the floor has the colour of the person's arms."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twistcap.arrays import Float, Float32
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.background import smooth_noise
from twistcap.studio.config import stream
from twistcap.studio.look import GARMENTS, garment_fractions, mean_light

HORIZON = 0.64  # of the image's height: about the knees
TONES = np.array([0.2, 0.42, 0.64, 0.86])  # greys, one each for bare arms, shirt, trousers and wall
NOISE = ((60.0, 0.03), (9.0, 0.03), (3.5, 0.025))  # spacing in px and strength of the room's texture


@dataclass(frozen=True)
class Elsewhere(Capture):
    """A person with bare forearms before a wall unlike any of the clothes, on a floor of the colour of the skin."""

    @cached_property
    def rooms(self) -> tuple[Float32, ...]:
        """The empty room in each view, (H, W, 3) in [0, 1]."""
        return tuple(self._room(camera) for camera in range(len(self.true_rig)))

    def _room(self, camera: int) -> Float32:
        rng, (width, height) = stream(self.config.seed, "elsewhere", camera), self.config.size
        picture = np.empty((height, width, 3))
        horizon = round(height * (HORIZON + float(rng.uniform(-0.02, 0.02))))
        tones = tones_of(self.config.seed)
        picture[:horizon], picture[horizon:] = tones[3], tones[0]
        for spacing, gain in NOISE:
            picture += gain * smooth_noise(rng, (height, width), spacing * height / 280)
        return np.clip(picture, 0.0, 1.0).astype(np.float32)


def tones_of(seed: int) -> Float:
    """(4,) greys of skin, shirt, trousers and wall."""
    return stream(seed, "tones").permutation(TONES)


def elsewhere(config: StudioConfig) -> Elsewhere:
    """The seed's walk in such a room."""
    scene = capture(config)
    albedo = scene.look.albedo.copy()
    tones = tones_of(config.seed)[:3, None] / mean_light(scene.look.lights)
    for name, tone in zip(("skin", "shirt", "trousers"), tones, strict=True):
        albedo[GARMENTS.index(name)] = tone
    cover = garment_fractions(scene.true_body, short_sleeves=True, shorts=False)
    look = replace(scene.look, albedo=albedo, cover=cover)
    known = (scene.body, scene.rig, scene.first_pose, look)
    return Elsewhere(scene.config, scene.true_body, scene.true_rig, scene.true_poses, *known)
