"""A walk in a circle, in which no direction lasts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.scene import default_body, default_poses


def in_a_circle() -> Capture:
    """Someone who walks, and turns by 200 degrees in 40 frames, in four views."""
    config = StudioConfig(seed=3, frames=40)
    body = default_body(config)
    turns = [se3.exp(np.array([0, 0, np.deg2rad(5.0) * k, 0, 0, 0])) for k in range(40)]
    walk = default_poses(config, body, 0.0)
    return capture(config, body, [replace(p, root=turn @ p.root) for p, turn in zip(walk, turns, strict=True)])
