"""Small pictures of two parts that change places, and a scene with its views."""

from __future__ import annotations

import numpy as np

from twistcap.body import Posed
from twistcap.cues.view import View, crop_view
from twistcap.studio import Capture, StudioConfig, capture


def labels(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    part = np.full((22, 30), -1, dtype=np.int32)
    part[4:15, 5:12], part[8:20, 10:16] = 0, 1
    other = np.roll(part, (1, 4), axis=(0, 1))
    return rng.uniform(size=(22, 30, 3)).astype(np.float32), part, other


def scene_and_views() -> tuple[Capture, Posed, dict[int, View]]:
    scene = capture(StudioConfig(seed=1, views=2, frames=1))
    truth = Posed(scene.true_body, scene.true_poses[0])
    frame = next(iter(scene.frames()))
    views = {}
    for i, image in enumerate(frame.images):
        assert image is not None
        view = crop_view(image, scene.rig[i], truth, 0.2, "lab")
        assert view is not None
        views[i] = view
    return scene, truth, views
