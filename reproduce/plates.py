"""The joint angles of the photographic plates, and those of a simplified model among its full body's."""

from __future__ import annotations

from twistcap.arrays import Float
from twistcap.body import Body

NINETEEN = ("neck_extension", "neck_bending", "neck_rotation", *(
    f"{joint}_{side}" for side in "rl" for joint in (
        "arm_add", "arm_flex", "arm_rot", "elbow_flex", "hip_flexion", "hip_adduction", "hip_rotation", "knee_angle")
))  # fmt: skip
"""Hips, shoulders and neck of three axes, knees and elbows of one: the 19 joint angles of the photographic plates."""


def angles_of(model: Body, body: Body, q: Float) -> Float:
    """The angles (..., J') of a simplified model among those (..., J) of its full body."""
    return q[..., [body.coordinate(name) for name in model.coordinate_names]]
