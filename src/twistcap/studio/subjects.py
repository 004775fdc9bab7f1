"""Other people's walks, to train priors on: nobody walks exactly like the one who is tracked."""

from __future__ import annotations

import numpy as np

from twistcap._typing import Float
from twistcap.body import Body
from twistcap.studio.config import stream
from twistcap.studio.motion import gait

MEAN_DEG = 3.0  # how far another person carries each joint from where the built-in walk has it, standard deviation
SHARE = 0.1  # by how much the excursions of each joint are wider or narrower, standard deviation
SPEEDS = (1.1, 1.5)  # m/s, of the walks


def walks_of_another(body: Body, seed: int, walks: int = 3, frames: int = 120, fps: float = 60.0) -> Float:
    """Joint angles of another person, who carries every joint a few degrees otherwise and moves it more or less.

    The person of a seed is another than the one whom a capture of that seed films; both sides of a body differ.

    Args:
        body: with OpenSim's coordinate names.
        seed: who it is.
        walks: at speeds evenly spread over those of people.
        frames, fps: of each walk; 120 frames at 60 per second are about two cycles.

    Returns:
        (walks · frames, J) rad, within the limits of the body.
    """
    speeds = np.linspace(*SPEEDS, walks) if walks > 1 else [sum(SPEEDS) / 2]
    q = np.concatenate([[p.q for p in gait(body, fps=fps, frames=frames, speed=float(v))] for v in speeds])
    rng = stream(seed, "another person")
    moving = np.ptp(q, axis=0) > 0
    shift = np.deg2rad(MEAN_DEG) * rng.standard_normal(q.shape[1])
    share = np.maximum(0.5, 1.0 + SHARE * rng.standard_normal(q.shape[1]))
    mean = q.mean(axis=0)
    return np.clip(np.where(moving, mean + shift + share * (q - mean), q), body.limits[:, 0], body.limits[:, 1])


def squats(body: Body, frames: int = 120, times: int = 2) -> Float:
    """Joint angles (frames, J) rad of knee bends with the arms held forward: what a walker never does."""
    deep = 0.5 - 0.5 * np.cos(2 * np.pi * times * np.arange(frames) / frames)
    q = np.zeros((frames, len(body.coordinate_names)))
    for joint, degrees in {"hip_flexion": 95, "knee_angle": 110, "ankle_angle": 25, "arm_flex": 80}.items():
        for side in ("r", "l"):
            if f"{joint}_{side}" in body.coordinate_names:
                q[:, body.coordinate(f"{joint}_{side}")] = np.deg2rad(degrees) * deep
    return np.clip(q, body.limits[:, 0], body.limits[:, 1])
