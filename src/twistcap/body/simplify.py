"""Bodies with fewer joints, such as one side of a person."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body.kinematics import Pose, Posed
from twistcap.body.model import Body, Landmarks
from twistcap.errors import InputError, check

SIDE_VIEW = ("neck_extension", "arm_flex", "elbow_flex", "hip_flexion", "knee_angle", "ankle_angle")
"""Joints of the planar model: head, one arm and one leg on the trunk."""


def simplified(
    body: Body, kept: Sequence[str], *, at: Float | None = None, without: Collection[str] = (),
    axis: Float | None = None,
) -> Body:  # fmt: skip
    """The body with some of its joints only, the others fixed.

    Args:
        kept: names of the coordinates that stay; the segments between them are merged.
        at: (J,) angles of the fixed joints; by default rest.
        without: names of segments whose surface and landmarks are left out.
        axis: (3,) in the body's frame; all axes are turned parallel to it, in the nearer direction. A planar model.

    Raises InputError for a coordinate or segment that the body lacks.
    """
    unknown = [n for n in kept if n not in body.coordinate_names] + [n for n in without if n not in body.segment_names]
    if unknown:
        raise InputError(f"body {body.name!r} has no {unknown[0]!r}; choose among its coordinates and segments.")
    stays = np.array([name in kept for name in body.coordinate_names])
    q = np.zeros(len(stays)) if at is None else np.where(stays, 0.0, at)
    posed = Posed(body, Pose(np.eye(4), q))
    twists = posed.world_twists[stays]
    if axis is not None:
        twists = _parallel(twists, np.asarray(axis, float))
    joint = np.append(np.where(stays, np.cumsum(stays) - 1, -1), -1)  # new index of each coordinate, -1 for none
    parent = np.array([joint[_last(body, stays, int(body.parent[k]))] for k in np.flatnonzero(stays)], np.int32)
    last = np.array([_last(body, stays, int(k)) for k in body.segment_joint])
    _, heads, group = np.unique(last, return_index=True, return_inverse=True)  # segments on one coordinate are merged
    order = np.argsort(heads)  # a merged segment has its first one's name and place
    heads, segment = heads[order], np.argsort(order)[group].astype(np.int32)
    dropped, marks = np.array([name in without for name in body.segment_names]), body.landmarks
    shown, faced = ~dropped[marks.segments], ~dropped[body.vertex_part]
    landmarks = Landmarks(tuple(np.array(marks.names)[shown]), segment[marks.segments[shown]], posed.landmarks[shown])
    faces = (np.cumsum(faced) - 1)[body.faces[faced[body.faces].all(axis=1)]].astype(np.int32)
    return Body(
        f"{body.name}-{len(twists)}", tuple(np.array(body.coordinate_names)[stays]), parent, twists, body.limits[stays],
        tuple(body.segment_names[s] for s in heads), joint[last[heads]].astype(np.int32),
        np.ascontiguousarray(posed.vertices[faced]), np.ascontiguousarray(faces), segment[body.skin_segments[faced]],
        body.skin_weights[faced], landmarks,
    )  # fmt: skip


def side_view(body: Body, side: str, *, at: Float | None = None, axis: Float | None = None) -> Body:
    """The planar model of a person seen from one side: trunk, head, and the arm and leg nearer to the camera.

    The body has OpenSim's coordinate names, the side is "r" or "l", `at` are angles of the other joints, and the axis
    (3,) of all joints is in the body's frame, by default its y axis.

    Raises InputError for another side, or a body without these joints.
    """
    check("side_view", side in ("r", "l"), f"side is {side!r}; it is 'r' or 'l'")
    own = [name if name.startswith("neck") else f"{name}_{side}" for name in SIDE_VIEW]
    other = [name for name in body.segment_names if name.endswith("_l" if side == "r" else "_r")]
    return simplified(body, own, at=at, without=other, axis=np.array([0.0, 1.0, 0.0]) if axis is None else axis)


def _last(body: Body, stays: Bool, k: int) -> int:
    """The last coordinate that stays, from one of them towards the root; -1 for none."""
    while k >= 0 and not stays[k]:
        k = int(body.parent[k])
    return k


def _parallel(twists: Float, axis: Float) -> Float:
    """Revolute twists turned parallel to an axis, each about the point of its old axis nearest to the origin."""
    omega = np.sign(twists[:, :3] @ axis)[:, None] * axis / np.linalg.norm(axis)
    points = np.cross(twists[:, :3], twists[:, 3:])
    return np.concatenate([omega, -np.cross(omega, points)], axis=1)
