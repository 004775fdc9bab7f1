"""Faults of cameras, cables and lights: each takes a take and gives it with the fault in its span."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from reproduce.faults.staged import Lighting
from reproduce.faults.take import NONE, Take
from twistcap.arrays import Int
from twistcap.studio.config import stream
from twistcap.studio.look import mean_light

Rng = np.random.Generator


def gap(take: Take, rng: Rng) -> Take:
    """No camera has images for a while."""
    source = take.source.copy()
    source[take.during] = NONE
    return replace(take, source=source)


def blackout(take: Take, rng: Rng) -> Take:
    """Some cameras, never all, have no image for a while, or a black one."""
    cameras = some_cameras(take, rng, take.views - 1)
    if rng.random() < 0.5:
        exposure = take.scene.exposure.copy()
        exposure[take.during, cameras] = 0.0
        return take.staged(exposure=exposure)
    source = take.source.copy()
    source[take.during, cameras] = NONE
    return replace(take, source=source)


def dropped(take: Take, rng: Rng) -> Take:
    """Single images are missing, 10 to 40 % of them."""
    source = take.source.copy()
    lacking = rng.random(source.shape[:2]) < rng.uniform(0.1, 0.4)
    during = np.zeros(take.count, np.bool_)
    during[take.during] = True
    source[lacking & during[:, None]] = NONE
    return replace(take, source=source)


def frozen(take: Take, rng: Rng) -> Take:
    """Some cameras, or all, repeat their last picture for a while."""
    source, cameras = take.source.copy(), some_cameras(take, rng, take.views)
    source[take.during, cameras] = source[max(0, take.span[0] - 1), cameras]
    return replace(take, source=source)


def swapped(take: Take, rng: Rng) -> Take:
    """Two neighbouring cameras give each other's pictures for a while."""
    source, one = take.source.copy(), int(rng.integers(take.views))
    pair = [one, (one + 1) % take.views]
    source[take.during, pair] = source[take.during, pair[::-1]]
    return replace(take, source=source)


def out_of_step(take: Take, rng: Rng) -> Take:
    """One camera gives pictures of 1 to 5 frames before, for a while."""
    source, late, camera = take.source.copy(), int(rng.integers(1, 6)), int(rng.integers(take.views))
    source[take.during, camera, 0] = np.maximum(0, source[take.during, camera, 0] - late)
    return replace(take, source=source)


def bump(take: Take, rng: Rng) -> Take:
    """One camera is turned by 1 to 5 degrees about a random axis."""
    bumps, axis = take.scene.bumps.copy(), rng.standard_normal(3)
    turn = np.deg2rad(rng.uniform(1.0, 5.0)) * axis / np.linalg.norm(axis)
    bumps[take.during, int(rng.integers(take.views))] = turn
    return take.staged(bumps=bumps)


def flicker(take: Take, rng: Rng) -> Take:
    """The exposure of each image wavers by up to ± 50 %, of all cameras together or of each by itself."""
    exposure = take.scene.exposure.copy()
    exposure[take.during] *= rng.uniform(0.5, 1.5, (take.count, take.views if rng.random() < 0.5 else 1))[take.during]
    return take.staged(exposure=exposure)


def light_switched(take: Take, rng: Rng) -> Take:
    """Another light: the lamps of the person's look stand elsewhere, and the room is 35 to 65 % darker or lighter."""
    relit, look = take.scene.relit.copy(), take.scene.look
    relit[take.during] = True
    turn, factor = rng.uniform(1.0, 5.0), rng.choice([rng.uniform(0.35, 0.65), rng.uniform(1.35, 1.65)])
    lights, (c, s) = look.lights.copy(), (np.cos(turn), np.sin(turn))
    lights[:-1, :2] = lights[:-1, :2] @ np.array([[c, s], [-s, c]])
    lights[:, 3:] *= factor * (1.0 + 0.08 * rng.standard_normal(3))
    room = mean_light(lights) / mean_light(look.lights)
    return take.staged(relit=relit, lighting=Lighting(replace(look, lights=lights), room))


def grain(take: Take, rng: Rng) -> Take:
    """A quarter to seven tenths of all pixels are noise for a while."""
    fraction = take.scene.grain.copy()
    fraction[take.during] = rng.uniform(0.25, 0.7)
    return take.staged(grain=fraction)


def some_cameras(take: Take, rng: Rng, most: int) -> Int:
    """Between one and `most` of the cameras."""
    return np.sort(rng.choice(take.views, int(rng.integers(1, most + 1)), replace=False)).astype(np.int32)


def seeded(seed: int, purpose: str) -> Rng:
    """Random numbers of the bench, apart from all those of the studio."""
    return stream(seed, f"faults {purpose}")
