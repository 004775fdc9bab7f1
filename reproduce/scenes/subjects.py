"""Other people's walks, to train priors on: nobody walks exactly like the one who is tracked."""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Float
from twistcap.body import Body, Pose
from twistcap.studio.config import stream
from twistcap.studio.motion import gait

MEAN_DEG = 3.0  # how far another person carries each joint from where the built-in walk has it, standard deviation
EXCURSION = 0.1  # by how much the excursions of each joint are wider or narrower, standard deviation
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
    scale = np.maximum(0.5, 1.0 + EXCURSION * rng.standard_normal(q.shape[1]))
    mean = q.mean(axis=0)
    return np.clip(np.where(moving, mean + shift + scale * (q - mean), q), body.limits[:, 0], body.limits[:, 1])


def squats(body: Body, frames: int = 120, times: int = 2) -> Float:
    """Joint angles (frames, J) rad of knee bends with the arms held forward: what a walker never does."""
    deep = 0.5 - 0.5 * np.cos(2 * np.pi * times * np.arange(frames) / frames)
    q = np.zeros((frames, len(body.coordinate_names)))
    for joint, degrees in {"hip_flexion": 95, "knee_angle": 110, "ankle_angle": 25, "arm_flex": 80}.items():
        for side in ("r", "l"):
            if f"{joint}_{side}" in body.coordinate_names:
                q[:, body.coordinate(f"{joint}_{side}")] = np.deg2rad(degrees) * deep
    return np.clip(q, body.limits[:, 0], body.limits[:, 1])


# Degrees: middle, excursion, and cycles in the whole exercise; the left side half a cycle later.
_LIMBERING: dict[str, tuple[float, float, float]] = {
    "lumbar_extension": (-12, 14, 2), "lumbar_bending": (0, 14, 3), "lumbar_rotation": (0, 20, 2),
    "neck_extension": (0, 18, 3), "neck_bending": (0, 15, 2), "neck_rotation": (0, 25, 3),
    "arm_add": (-50, 28, 2), "arm_flex": (30, 40, 3), "arm_rot": (0, 35, 2),
    "elbow_flex": (60, 45, 3), "pro_sup": (10, 50, 2),
    "hip_flexion": (35, 35, 2), "hip_adduction": (-14, 14, 3), "hip_rotation": (0, 18, 2),
    "knee_angle": (50, 42, 3), "ankle_angle": (0, 17, 2), "subtalar_angle": (3, 13, 3),
}  # fmt: skip


def limbering(body: Body, frames: int = 90) -> list[Pose]:
    """Every joint swung through much of its range, standing on the spot: what shows joint centres.

    Functional calibration of joints asks for such motion (Ehrig et al. 2006, DOI 10.1016/j.jbiomech.2005.10.002).

    Args:
        body: with OpenSim's coordinate names; coordinates that it lacks are left out.
        frames: of the whole exercise, 2 to 3 cycles of each joint.
    """
    at = np.arange(frames) / frames
    q = np.zeros((frames, len(body.coordinate_names)))
    for n, (joint, (middle, excursion, cycles)) in enumerate(_LIMBERING.items()):
        for name, shift in ((joint, 0.0), (f"{joint}_r", 0.0), (f"{joint}_l", 0.5)):
            if name in body.coordinate_names:
                swing = np.sin(2 * np.pi * (cycles * at + shift + 0.381966 * n))
                q[:, body.coordinate(name)] = np.deg2rad(middle + excursion * swing)
    return [Pose(np.eye(4), angles) for angles in np.clip(q, body.limits[:, 0], body.limits[:, 1])]
