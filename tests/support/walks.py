"""A walk in a circle, in which no direction lasts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from twistcap import se3
from twistcap.estimate import Frame
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.scene import default_body, default_poses


@cache
def in_a_circle() -> Capture:
    """Someone who walks, and turns by 200 degrees in 40 frames, in four views."""
    config = StudioConfig(seed=3, size=(256, 188), frames=40)
    body = default_body(config)
    turns = [se3.exp(np.array([0, 0, np.deg2rad(5.0) * k, 0, 0, 0])) for k in range(40)]
    walk = default_poses(config, body, 0.0)
    return capture(config, body, [replace(p, root=turn @ p.root) for p, turn in zip(walk, turns, strict=True)])


@cache
def every_other_frame() -> list[Frame]:
    """Of the walk in a circle."""
    return [in_a_circle().frame(k) for k in range(0, 40, 2)]
