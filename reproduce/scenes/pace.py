"""A person who walks about at a pace that changes, so that no stretch of time is like another."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twistcap import se3
from twistcap.body import Body, Pose
from twistcap.studio.config import stream
from twistcap.studio.motion import gait

SPEED, STEPS, PER_CYCLE, RADIUS = 1.3, 110.4, 200, 0.9  # m/s, steps per minute, samples of a cycle, m of the circle


def walking_about(body: Body, seed: int, length: float) -> Callable[[float], Pose]:
    """The pose at a time (s): a walk in a circle that slows down, stops and goes on, not twice the same.

    It is known up to `length` s.
    """
    rng, rate = stream(seed, "pace"), 240
    times = np.arange(int(length * rate)) / rate
    waves = [np.sin(2 * np.pi * times / rng.uniform(1.2, 5.0) + rng.uniform(0, 2 * np.pi)) for _ in range(4)]
    pace = np.clip(0.75 + 0.45 * np.sum(waves, axis=0), 0.0, 1.3)
    way = np.cumsum(pace) / rate * SPEED
    cycle = gait(body, fps=PER_CYCLE * STEPS / 120.0, frames=PER_CYCLE + 1, speed=SPEED, cadence=STEPS)
    stride, turned, start = SPEED * 120.0 / STEPS, rng.uniform(0, 2 * np.pi), rng.uniform(0, 1)

    def at(time: float) -> Pose:
        along = float(np.interp(time, times, way))
        phase = (start + along / stride) % 1.0
        k, part = divmod(phase * PER_CYCLE, 1.0)
        pose = cycle[int(k)].retract(part * cycle[int(k) + 1].minus(cycle[int(k)]))
        heading = turned + along / RADIUS
        there = se3.exp_rotation(np.array([0.0, 0.0, heading]))
        on_circle = RADIUS * np.array([np.sin(heading), -np.cos(heading), 0.0])
        back = np.array([-phase * stride, 0.0, 0.0])
        return Pose(se3.transform(there, on_circle + there @ back) @ pose.root, pose.q)

    return at
