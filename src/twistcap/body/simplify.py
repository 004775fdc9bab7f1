"""Bodies with fewer joints, such as one side of a person."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.body.kinematics import Pose, Posed
from twistcap.body.model import Body, Landmarks
from twistcap.errors import InputError

SIDE_VIEW = ("neck_extension", "arm_flex", "elbow_flex", "hip_flexion", "knee_angle", "ankle_angle")
"""Joints of the planar model: head, one arm and one leg on the trunk."""

NINETEEN = ("neck_extension", "neck_bending", "neck_rotation", *(
    f"{joint}_{side}" for side in "rl" for joint in (
        "arm_add", "arm_flex", "arm_rot", "elbow_flex", "hip_flexion", "hip_adduction", "hip_rotation", "knee_angle")
))  # fmt: skip
"""Hips, shoulders and neck of three axes, knees and elbows of one: the 19 joint angles of the photographic plates."""


def simplified(
    body: Body,
    kept: Sequence[str],
    *,
    at: Float | None = None,
    without: Collection[str] = (),
    axis: Float | None = None,
) -> Body:
    """The body with some of its joints only, the others fixed.

    Args:
        body: with more coordinates.
        kept: names of the coordinates that stay; the segments between them are merged.
        at: (J,) angles of the fixed joints; by default rest.
        without: names of segments whose surface and landmarks are left out.
        axis: (3,) in the body's frame; all axes are turned parallel to it, in the nearer direction. A planar model.

    Raises:
        InputError: for a coordinate or segment that the body lacks.
    """
    unknown = [n for n in kept if n not in body.coordinate_names] + [n for n in without if n not in body.segment_names]
    if unknown:
        raise InputError(f"body {body.name!r} has no {unknown[0]!r}; choose among its coordinates and segments.")
    stays = np.array([name in kept for name in body.coordinate_names])
    q = np.zeros(len(stays)) if at is None else np.where(stays, 0.0, at)
    posed = Posed(body, Pose(np.eye(4), q))
    joint, segment = _renumbered(body, stays)
    twists = posed.world_twists[stays]
    if axis is not None:
        twists = _parallel(twists, np.asarray(axis, float))
    dropped = np.array([name in without for name in body.segment_names])
    heads = _heads(segment)
    marks = body.landmarks
    shown = ~dropped[marks.segments]
    landmarks = Landmarks(
        tuple(np.array(marks.names)[shown]), segment[marks.segments[shown]].astype(np.int32), posed.landmarks[shown]
    )
    vertices, faces, used = _surface(body, posed.vertices, dropped)
    return Body(
        name=f"{body.name}-{len(twists)}",
        coordinate_names=tuple(np.array(body.coordinate_names)[stays]),
        parent=np.array([_kept_above(body.parent, joint, int(k)) for k in np.flatnonzero(stays)], np.int32),
        twists=twists,
        limits=body.limits[stays],
        segment_names=tuple(body.segment_names[s] for s in heads),
        segment_joint=np.array([joint[_last(body, stays, s)] for s in heads], np.int32),
        vertices=vertices,
        faces=faces,
        skin_segments=segment[body.skin_segments[used]].astype(np.int32),
        skin_weights=body.skin_weights[used],
        landmarks=landmarks,
    )


def side_view(body: Body, side: str, *, at: Float | None = None, axis: Float | None = None) -> Body:
    """The planar model of a person seen from one side: trunk, head, and the arm and leg nearer to the camera.

    Args:
        body: with OpenSim's coordinate names.
        side: "r" or "l".
        at: angles of the other joints.
        axis: (3,) of all joints, in the body's frame; by default its y axis.

    Raises:
        InputError: for another side, or a body without these joints.
    """
    if side not in ("r", "l"):
        raise InputError(f"side_view: side is {side!r}; it is 'r' or 'l'.")
    own = [name if name.startswith("neck") else f"{name}_{side}" for name in SIDE_VIEW]
    other = [name for name in body.segment_names if name.endswith("_l" if side == "r" else "_r")]
    return simplified(body, own, at=at, without=other, axis=np.array([0.0, 1.0, 0.0]) if axis is None else axis)


def angles_of(model: Body, body: Body, q: Float) -> Float:
    """The angles (..., J') of a simplified model among those (..., J) of its full body."""
    return q[..., [body.coordinate(name) for name in model.coordinate_names]]


def _renumbered(body: Body, stays: Bool) -> tuple[Int, Int]:
    """New index of each coordinate (J + 1,), -1 for none (and in the last place), and new segment of each segment."""
    joint = np.append(np.where(stays, np.cumsum(stays) - 1, -1), -1).astype(np.int32)
    top = np.array([_last(body, stays, s) for s in range(len(body.segment_names))])
    names: dict[int, int] = {}
    return joint, np.array([names.setdefault(int(k), len(names)) for k in top], np.int32)


def _last(body: Body, stays: Bool, segment: int) -> int:
    """The last coordinate that stays and moves a segment, -1 for none."""
    k = int(body.segment_joint[segment])
    while k >= 0 and not stays[k]:
        k = int(body.parent[k])
    return k


def _kept_above(parent: Int, joint: Int, k: int) -> int:
    k = int(parent[k])
    while k >= 0 and joint[k] < 0:
        k = int(parent[k])
    return -1 if k < 0 else int(joint[k])


def _heads(segment: Int) -> list[int]:
    """The first old segment of each new one, which gives its name."""
    return [int(np.flatnonzero(segment == s)[0]) for s in range(int(segment.max()) + 1)]


def _parallel(twists: Float, axis: Float) -> Float:
    """Revolute twists turned parallel to an axis, each about the point of its old axis nearest to the origin."""
    omega = np.sign(twists[:, :3] @ axis)[:, None] * axis / np.linalg.norm(axis)
    points = np.cross(twists[:, :3], twists[:, 3:])
    return np.concatenate([omega, -np.cross(omega, points)], axis=1)


def _surface(body: Body, vertices: Float, dropped: Bool) -> tuple[Float, Int, Int]:
    """Vertices and faces without those of dropped segments, and which vertices are left."""
    stays = ~dropped[body.vertex_part]
    used = np.flatnonzero(stays).astype(np.int32)
    new = np.cumsum(stays) - 1
    faces = body.faces[stays[body.faces].all(axis=1)]
    return np.ascontiguousarray(vertices[used]), np.ascontiguousarray(new[faces].astype(np.int32)), used
