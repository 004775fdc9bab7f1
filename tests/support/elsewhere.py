"""Someone who walks, is away for 20 frames, and then crouches with raised arms four metres farther on."""

from __future__ import annotations

from functools import cache

import numpy as np

from twistcap import se3
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.estimate import Frame, Keypoints
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.studio.motion import gait

GAP = range(12, 32)
BACK = GAP[-1] + 1
_STANCE = {"arm_flex": 150.0, "elbow_flex": 30.0, "hip_flexion": 80.0, "knee_angle": 100.0, "lumbar_extension": -25.0}


@cache
def scene() -> tuple[Capture, list[Frame]]:
    """The capture, and its frames."""
    body = humanoid()
    walk = gait(body, fps=30.0, frames=BACK, speed=1.3)
    q = np.deg2rad([_STANCE.get(name.removesuffix("_r").removesuffix("_l"), 0.0) for name in body.coordinate_names])
    q = np.clip(q, *body.limits.T)
    root = se3.exp(np.r_[0.0, 0.0, 2.4, 0.0, 0.0, 0.0])
    low = Posed(body, Pose(root, q)).vertices[:, 2].min()
    root[:3, 3] = walk[GAP[0] - 1].root[:3, 3] * (1.0, 1.0, 0.0) + (4.0, 0.3, -low)
    poses = [*walk, *[Pose(root, q)] * 4]
    made = capture(StudioConfig(seed=2, frames=len(poses), fps=30.0, dropped=((GAP[0], GAP[-1]),)), body, poses)
    return made, list(made.frames())


def keypoints(index: int, beside: float = 0.0) -> Keypoints:
    """With noise of 3 px, of the person, or of one who is beside by so many metres."""
    made, rng = scene()[0], np.random.default_rng(index)
    points = made.landmarks[index] + (beside, 0.0, 0.0)
    pixels = np.stack([camera.project(points)[0] for camera in made.rig])
    noise = 3.0 * rng.standard_normal(pixels.shape)
    return Keypoints(made.body.landmarks.names, pixels + noise, np.ones(pixels.shape[:2]))


def greatest_error(index: int, pose: Pose) -> float:
    """Of a landmark, m."""
    made = scene()[0]
    return float(np.linalg.norm(Posed(made.body, pose).landmarks - made.landmarks[index], axis=1).max())
