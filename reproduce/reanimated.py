"""A tracked motion played again by the model alone, from a camera that was not there."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from twistcap.body import Body, Pose, Posed
from twistcap.camera import Camera, look_at
from twistcap.io.videowriter import VideoWriter
from twistcap.studio import StudioConfig
from twistcap.studio.look import look
from twistcap.studio.picture import between, picture_of

_SIZE = (480, 400)


def reanimated(path: Path, model: Body, poses: Sequence[Pose], between_frames: int = 5, fps: float = 30.0) -> Path:
    """Write a video of the poses, with `between_frames` poses between each two, from a camera that goes round."""
    clothes = look(model, StudioConfig(seed=1))
    fine = [between(a, b, k / between_frames) for a, b in pairwise(poses) for k in range(between_frames)]
    room = np.full((_SIZE[1], _SIZE[0], 3), 0.82, dtype=np.float32)
    with VideoWriter(path, fps) as video:
        for n, pose in enumerate(fine):
            middle = pose.root[:3, 3]
            angle = -0.3 * np.pi + 0.5 * np.pi * n / len(fine)
            eye = middle + np.array([5.0 * np.cos(angle), 5.0 * np.sin(angle), 0.6])
            K = np.array([[850.0, 0, (_SIZE[0] - 1) / 2], [0, 850.0, (_SIZE[1] - 1) / 2], [0, 0, 1]])
            camera = Camera("novel", K, look_at(eye, middle), _SIZE)
            picture = picture_of([Posed(model, pose)], camera, clothes, room)
            video.write(np.clip(np.rint(255 * picture), 0, 255).astype(np.uint8))
    return path
