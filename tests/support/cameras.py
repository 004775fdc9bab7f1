"""Rigs of cameras."""

from __future__ import annotations

import numpy as np

from twistcap.camera import Camera, Rig, look_at


def ring(count: int = 4, radius: float = 4.0) -> Rig:
    K = np.array([[500.0, 0, 191.5], [0, 505.0, 139.5], [0, 0, 1]])
    angles = 0.3 + 2 * np.pi * np.arange(count) / count
    eyes = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, 1.4)], axis=-1)
    dist = np.array([-0.05, 0.1, 1e-3, -1e-3, 0.02])
    return Rig(tuple(Camera(f"cam{i}", K, look_at(e, [0, 0, 0.9]), (384, 280), dist) for i, e in enumerate(eyes)))
