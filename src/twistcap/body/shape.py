"""Changing a body's proportions: every segment longer or wider, joints, surface and landmarks together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from twistcap import se3
from twistcap._typing import Float, Int
from twistcap.body.kinematics import skin_points
from twistcap.body.model import Body, Landmarks
from twistcap.errors import InputError


def rescaled(
    body: Body,
    lengths: Mapping[str, float] | None = None,
    girths: Mapping[str, float] | None = None,
    stature: float = 1.0,
) -> Body:
    """The body with its segments stretched along (`lengths`) and across (`girths`) their axes, by factors.

    A segment is stretched about its joint, along the line to the next joint (or landmark) down the chain; what hangs
    on it moves along. Offsets across the axis (hips on the pelvis, shoulders on the chest) grow with the girth.

    Raises:
        InputError: for an unknown segment or a factor that is not positive.
    """
    lengths, girths = dict(lengths or {}), dict(girths or {})
    for name, factor in [*lengths.items(), *girths.items(), ("stature", stature)]:
        if name != "stature" and name not in body.segment_names:
            raise InputError(f"body {body.name!r} has no segment {name!r}; it has {', '.join(body.segment_names)}.")
        if not factor > 0:
            raise InputError(f"body {body.name!r}: the factor of {name!r} is {factor}; it must be positive.")
    maps = stretch_maps(body, lengths, girths, stature)
    return warped(body, maps)


def segment_axes(body: Body) -> tuple[Float, Float]:
    """Origin (S, 3) and unit axis (S, 3) of each segment in the rest pose: from its joint to the next one below."""
    S = len(body.segment_names)
    origins, axes = np.zeros((S, 3)), np.zeros((S, 3))
    for s in range(S):
        origins[s] = joint_origin(body, s)
        axes[s] = _axis_from(body, s, origins[s])
    return origins, axes


def joint_origin(body: Body, segment: int) -> Float:
    """(3,) rest-pose position of a segment's proximal joint, m: where the axes of its joint meet.

    Root segments have none: theirs is the centre of their own surface.
    """
    k = int(body.segment_joint[segment])
    if k < 0:
        own = body.vertices[body.vertex_part == segment]
        return own.mean(axis=0) if len(own) else np.zeros(3)
    above = int(body.segment_parent[segment])
    top = int(body.segment_joint[above]) if above >= 0 else -1
    axes: list[Float] = []
    while k >= 0 and k != top:
        axes.append(body.twists[k])
        k = int(body.parent[k])
    w = np.array([a[:3] for a in axes])
    v = np.array([a[3:] for a in axes])
    normal = -se3.hat(w)  # the point p of each axis solves ω × p = −v
    rows, rhs = -normal.reshape(-1, 3), -v.reshape(-1)
    prior = body.landmarks.points[body.landmarks.segments == segment]
    guess = prior[0] if len(prior) else _centroid(body, segment)
    # A hinge fixes the joint only up to its axis: of all points on it, take the one nearest the segment's own landmark.
    return guess + np.linalg.lstsq(rows, rhs - rows @ guess, rcond=1e-9)[0]


def joint_coordinates(body: Body, segment: int) -> list[int]:
    """The coordinates of a segment's own joint, from the last to the first."""
    above = int(body.segment_parent[segment])
    top = int(body.segment_joint[above]) if above >= 0 else -1
    k, out = int(body.segment_joint[segment]), []
    while k >= 0 and k != top:
        out.append(k)
        k = int(body.parent[k])
    return out


def marks_of(body: Body, segment: int, centre: Float, within: float = 0.01) -> Int:
    """Landmarks (indices) that mark a joint: on one of its two segments and at its centre."""
    marks = body.landmarks
    beside = (marks.segments == segment) | (marks.segments == body.segment_parent[segment])
    return np.flatnonzero(beside & (np.linalg.norm(marks.points - centre, axis=1) < within)).astype(np.int32)


def _centroid(body: Body, segment: int) -> Float:
    own = body.vertices[body.vertex_part == segment]
    return own.mean(axis=0) if len(own) else np.zeros(3)


def _axis_from(body: Body, segment: int, origin: Float) -> Float:
    children = np.flatnonzero(body.segment_parent == segment)
    if body.segment_joint[segment] < 0 or len(children) > 1:
        towards = np.array([0.0, 0.0, 1.0])  # trunk segments are stretched upward
    elif len(children) == 1:
        towards = joint_origin(body, int(children[0])) - origin
    else:
        towards = _centroid(body, segment) - origin
    norm = float(np.linalg.norm(towards))
    return towards / norm if norm > 1e-9 else np.array([0.0, 0.0, 1.0])


def stretch_maps(body: Body, lengths: Mapping[str, float], girths: Mapping[str, float], stature: float = 1.0) -> Float:
    """(S, 4, 4) affine maps that take each segment of the rest pose to its stretched place."""
    origins, axes = segment_axes(body)
    S = len(body.segment_names)
    maps = np.zeros((S, 4, 4))
    for s, name in enumerate(body.segment_names):
        along, across = lengths.get(name, 1.0) * stature, girths.get(name, 1.0) * stature
        A = across * np.eye(3) + (along - across) * np.outer(axes[s], axes[s])
        above = int(body.segment_parent[s])
        place = stature * origins[s] if above < 0 else maps[above, :3, :3] @ origins[s] + maps[above, :3, 3]
        maps[s] = se3.transform(A, place - A @ origins[s])
    return maps


def warped(body: Body, maps: Float) -> Body:
    """The body after an affine map (S, 4, 4) of each segment's rest pose; surface blended by the skinning weights."""
    vertices = skin_points(np.ascontiguousarray(maps), body.skin_segments, body.skin_weights, body.vertices)
    marks = body.landmarks
    T = maps[marks.segments]
    points = (T[:, :3, :3] @ marks.points[..., None])[..., 0] + T[:, :3, 3]
    twists = body.twists.copy()
    for s in range(len(body.segment_names)):
        above = int(body.segment_parent[s])
        if body.segment_joint[s] < 0:
            continue
        moved = se3.apply(maps[above], joint_origin(body, s)[None])[0]
        top = int(body.segment_joint[above])
        k = int(body.segment_joint[s])
        while k >= 0 and k != top:  # every axis of the joint moves with the joint's centre, directions stay
            if np.any(twists[k, :3]):
                twists[k, 3:] = -np.cross(twists[k, :3], moved)
            k = int(body.parent[k])
    return replace(body, vertices=vertices, twists=twists, landmarks=Landmarks(marks.names, marks.segments, points))
