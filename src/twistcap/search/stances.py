"""Stances that a search begins from where a recording has shown none: made by hand, of no one's motion.

They are written in the joint coordinates of the built-in humanoid; another body takes those that it has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.model import partners
from twistcap.search.placing import Stance

Degrees = Mapping[str, float]

_SIDES = ("_r", "_l")
_TURN = np.diag([-1.0, -1.0, 1.0])
_DOWN: Degrees = {"arm_add": -8, "elbow_flex": 12}
_WALK: Degrees = {
    "hip_flexion_r": 25, "knee_angle_r": 5, "hip_flexion_l": -12, "knee_angle_l": 15, "arm_flex_r": -18,
    "arm_flex_l": 18, "elbow_flex": 25, "arm_add": -8,
}  # fmt: skip
_PASS: Degrees = {"hip_flexion_r": 15, "knee_angle_r": 55, "arm_add": -8, "elbow_flex": 20}
_RUN: Degrees = {
    "hip_flexion_r": 45, "knee_angle_r": 60, "hip_flexion_l": -15, "knee_angle_l": 60, "arm_flex_r": -40,
    "arm_flex_l": 30, "elbow_flex": 80, "arm_add": -12, "lumbar_extension": -5,
}  # fmt: skip

# Tilt of the pelvis forward, and joints; a name without a side holds for both.
STANCES: Mapping[str, tuple[float, Degrees]] = {
    "standing": (0, _DOWN),
    "arms out": (0, {"arm_add": -85}),
    "arms half out": (0, {"arm_add": -45, "elbow_flex": 15}),
    "arms forward": (0, {"arm_flex": 85, "arm_add": -5}),
    "arms up": (0, {"arm_add": -165}),
    "hands before the chest": (0, {"arm_flex": 40, "arm_add": -10, "elbow_flex": 110}),
    "legs apart": (0, {"hip_adduction": -18, "arm_add": -30}),
    "walking": (2, _WALK),
    "mid-swing": (2, _PASS),
    "running": (8, _RUN),
    "one leg up": (0, {"hip_flexion_r": 70, "knee_angle_r": 80, "arm_add": -40}),
    "crouching": (25, {"hip_flexion": 55, "knee_angle": 60, "ankle_angle": 20, "arm_flex": 20, "elbow_flex": 40}),
    "squat": (20, {"hip_flexion": 95, "knee_angle": 110, "ankle_angle": 25, "arm_flex": 60, "elbow_flex": 20}),
    "sitting": (0, {"hip_flexion": 85, "knee_angle": 85, "arm_flex": 25, "elbow_flex": 50}),
    "bent": (45, {"lumbar_extension": -35, "hip_flexion": 50, "knee_angle": 10, "arm_flex": 80}),
}


def bundled(body: Body) -> list[Stance]:
    """The stances that a body can take, with their mirror images, its lowest point at height 0."""
    out = list[Stance]()
    for tilt, degrees in STANCES.values():
        stance = _stance(body, tilt, _coordinates(body, degrees))
        other = stance.mirrored(body)
        out += [stance] if np.allclose(other.q, stance.q) else [stance, other]
    return out


def lowest(body: Body, stances: Sequence[Stance]) -> float:
    """Height (m) of the lowest point of a body in some stances: of the floor, if it stands on one in any of them."""
    return min(stance.height - _height(body, stance.facing(np.eye(3))) for stance in stances) if stances else 0.0


def turned_round(body: Body, pose: Pose) -> Pose:
    """The pose that faces the other way and fills nearly the same space: right limbs take the places of left ones.

    Joints that bend to one side only stay straight there.
    """
    axes, partner = body.twists[:, :3], partners(body.coordinate_names)
    signs = np.round(np.einsum("ji,ji->j", axes, axes[partner] @ _TURN))
    q = np.clip(signs * pose.q[partner], body.limits[:, 0], body.limits[:, 1])
    return Pose(se3.transform(pose.root[:3, :3] @ _TURN, pose.root[:3, 3]), q)


def _coordinates(body: Body, degrees: Degrees) -> Float:
    q = np.zeros(len(body.coordinate_names))
    for j, name in enumerate(body.coordinate_names):
        side = next((s for s in _SIDES if name.endswith(s)), "")
        q[j] = np.deg2rad(degrees.get(name, degrees.get(name.removesuffix(side), 0.0)))
    return np.clip(q, body.limits[:, 0], body.limits[:, 1])


def _stance(body: Body, tilt: float, q: Float) -> Stance:
    turn = se3.exp_rotation(np.array([0.0, np.deg2rad(tilt), 0.0]))
    return Stance(turn, _height(body, Pose(se3.transform(turn, np.zeros(3)), q)), q)


def _height(body: Body, pose: Pose) -> float:
    """Of the root above the lowest point."""
    return float(pose.root[2, 3] - Posed(body, pose).vertices[:, 2].min())
