"""Bones of a human body with anatomical axes: x forward, y along the bone towards the trunk, z to the right.

These are the axes of the International Society of Biomechanics (Wu et al. 2002, DOI 10.1016/S0021-9290(01)00222-6, and
2005, DOI 10.1016/j.jbiomech.2004.05.042). What those papers find by touching bone is taken from the body: joint
centres, and the hinge axes of knee and elbow in place of the lines between the epicondyles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body.model import Body
from twistcap.body.proportions import JOINTS
from twistcap.body.shape import joint_origin

UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])  # columns: these axes in our rest frame
_TOLD_BY = {"thorax": ("torso", "thorax"), "forearm": ("ulna", "radius")}  # bones that two joints of ours move
# Long bones: landmarks at both ends, the hinge across, and the sign of its axis to the right.
_LONG = {
    "humerus": ("shoulder", "elbow", "elbow_flex", 1.0),
    "forearm": ("elbow", "wrist", "elbow_flex", 1.0),
    "femur": ("hip", "knee", "knee_angle", -1.0),
    "tibia": ("knee", "ankle", "knee_angle", -1.0),
}
_LIKE = {"hand": ("forearm", "wrist"), "foot": ("tibia", "ankle")}  # parallel to the bone above while at rest


@dataclass(frozen=True)
class Bone:
    """A segment (by number) and its anatomical frame (4, 4) in the body's rest pose: axes as columns, and the centre of
    its upper joint, m."""

    segment: int
    frame: Float


def bones_of(body: Body) -> dict[str, Bone]:
    """The bones of a body: pelvis, thorax, head, and humerus, forearm, hand, femur, tibia, foot with ``_r``, ``_l``.

    Those that it lacks are left out: bones without a joint of CONVENTIONS.md's names, or without the landmarks at their
    ends. Hand and foot have the axes of the bone above them in the rest pose, as the neutral posture wants.
    """
    root = int(np.argmax(body.segment_joint < 0)) if np.any(body.segment_joint < 0) else 0
    bones = {"pelvis": Bone(root, se3.transform(_pelvis_axes(body), _mark(body, "mid_hip", root)))}
    for name in ("thorax", "head"):
        if (segment := _moved_by(body, name, "")) is not None:
            bones[name] = Bone(segment, se3.transform(UPRIGHT, joint_origin(body, segment)))
    for side in ("_r", "_l"):
        for name in ("humerus", "forearm", "hand", "femur", "tibia", "foot"):
            segment, frame = _moved_by(body, name, side), _frame(body, name, side, bones)
            if segment is not None and frame is not None:
                bones[name + side] = Bone(segment, frame)
    return bones


def _moved_by(body: Body, bone: str, side: str) -> int | None:
    """The segment nearest to the root that all coordinates of a bone's joint move; None where the body lacks it."""
    names = [name for segment in _TOLD_BY.get(bone, (bone,)) for name in JOINTS[segment]]
    own = [body.coordinate(name + side) for name in names if name + side in body.coordinate_names]
    moved = np.flatnonzero(body.chain[:, own].all(axis=1)) if own else np.zeros(0, int)
    return int(moved[np.argmin(body.chain[moved].sum(axis=1))]) if len(moved) else None


def _frame(body: Body, name: str, side: str, bones: Mapping[str, Bone]) -> Float | None:
    if name in _LIKE:
        above, centre = _LIKE[name]
        known = above + side in bones and centre + side in body.landmarks.names
        return se3.transform(bones[above + side].frame[:3, :3], _mark(body, centre + side)) if known else None
    top, bottom, hinge, sign = _LONG[name]
    if hinge + side not in body.coordinate_names or not {top + side, bottom + side} <= set(body.landmarks.names):
        return None
    upper, lower = _mark(body, top + side), _mark(body, bottom + side)
    axes = _axes(upper - lower, sign * body.twists[body.coordinate(hinge + side), :3])
    if name == "forearm":  # its axes are defined palm forward; at rest the thumb is forward
        turn = np.pi / 2 if side == "_r" else -np.pi / 2
        axes = axes @ se3.exp_rotation(np.array([0.0, turn, 0.0]))
    return se3.transform(axes, upper)


def _pelvis_axes(body: Body) -> Float:
    """z from the left to the right hip centre, y as upright as that leaves it."""
    if not {"hip_r", "hip_l"} <= set(body.landmarks.names):
        return UPRIGHT
    z = _unit(_mark(body, "hip_r") - _mark(body, "hip_l"))
    x = _unit(np.cross(UPRIGHT[:, 1], z))
    return np.stack([x, np.cross(z, x), z], axis=1)


def _axes(up: Float, right: Float) -> Float:
    """Columns x, y, z: y along `up`, z as near to `right` as that leaves it."""
    y = _unit(up)
    x = _unit(np.cross(y, right))
    return np.stack([x, y, np.cross(x, y)], axis=1)


def _unit(vector: Float) -> Float:
    return vector / np.linalg.norm(vector)


def _mark(body: Body, name: str, segment: int | None = None) -> Float:
    """A landmark in the rest pose; without it the middle of a segment."""
    if name in body.landmarks.names:
        return body.landmarks.points[body.landmarks.index(name)]
    return body.segment_middles[segment or 0]
