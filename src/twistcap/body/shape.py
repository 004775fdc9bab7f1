"""Changing a body's proportions: length and girth of segments, with joints, surface and landmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body.kinematics import Posed, skin_points
from twistcap.body.model import Body, Landmarks
from twistcap.errors import InputError, check

_AT_CENTRE = 0.01  # m from a joint's centre, within which a landmark marks it
_CROSSWISE = 0.7  # greatest cosine between a hinge's axis and its segment that counts as across


def rescaled(
    body: Body, lengths: Mapping[str, float] | None = None, girths: Mapping[str, float] | None = None,
    stature: float = 1.0,
) -> Body:  # fmt: skip
    """The body with its segments stretched along (`lengths`) and across (`girths`) their axes, by factors.

    A segment is stretched about its joint, along the line to the next joint (or landmark) down the chain; segments
    below it move along. Offsets across the axis (hips on the pelvis, shoulders on the chest) grow with the girth.
    Raises InputError for an unknown segment or a factor that is not positive.
    """
    lengths, girths = dict(lengths or {}), dict(girths or {})
    for name, factor in [*lengths.items(), *girths.items(), ("stature", stature)]:
        if name != "stature" and name not in body.segment_names:
            raise InputError(f"body {body.name!r} has no segment {name!r}; it has {', '.join(body.segment_names)}.")
        check(f"body {body.name!r}", factor > 0, f"the factor of {name!r} is {factor}; it must be positive")
    return warped(body, stretch_maps(body, lengths, girths, stature))


def segment_axes(body: Body) -> tuple[Float, Float]:
    """Origin (S, 3) and unit axis (S, 3) of each segment in the rest pose: from its joint to the next one below."""
    origins = body.joint_origins
    return origins, np.array([_axis_from(body, s, origins) for s in range(len(origins))]).reshape(-1, 3)


def joint_origin(body: Body, segment: int) -> Float:
    """(3,) rest-pose position of a segment's proximal joint, m, the intersection of the joint's axes. For root segments
    it is the centre of their own surface."""
    if int(body.segment_joint[segment]) < 0:
        return _centroid(body, segment)
    prior = body.landmarks.points[body.landmarks.segments == segment]
    guess = prior[0] if len(prior) else _centroid(body, segment)
    # The joint may be anywhere on a hinge's axis: take the point nearest to the segment's own landmark.
    return meeting_point(body.twists[joint_coordinates(body, segment)], guess)[0]


def meeting_point(axes: Float, guess: Float) -> tuple[Float, float]:
    """(3,) the point on the axes of all twists (K, 6) that is nearest to a guess, and how far it misses them, m."""
    rows, rhs = se3.hat(axes[:, :3]).reshape(-1, 3), -axes[:, 3:].reshape(-1)  # of each axis ω × p = −v
    point = guess + np.linalg.lstsq(rows, rhs - rows @ guess, rcond=1e-9)[0]
    return point, float(np.max(np.abs(rows @ point - rhs), initial=0.0))


def joint_coordinates(body: Body, segment: int) -> list[int]:
    """The coordinates of a segment's own joint, from the last to the first."""
    above = int(body.segment_parent[segment])
    top = int(body.segment_joint[above]) if above >= 0 else -1
    k, out = int(body.segment_joint[segment]), []
    while k >= 0 and k != top:
        out.append(k)
        k = int(body.parent[k])
    return out


def marks_of(body: Body, segment: int) -> Int:
    """Landmarks (indices) of a segment's joint: on one of its two segments and at its centre."""
    marks = body.landmarks
    beside = (marks.segments == segment) | (marks.segments == body.segment_parent[segment])
    distance = np.linalg.norm(marks.points - body.joint_origins[segment], axis=1)
    return np.flatnonzero(beside & (distance < _AT_CENTRE)).astype(np.int32)


def _centroid(body: Body, segment: int) -> Float:
    own = body.vertices[body.vertex_part == segment]
    return own.mean(axis=0) if len(own) else np.zeros(3)


def _axis_from(body: Body, segment: int, origins: Float) -> Float:
    children = np.flatnonzero(body.segment_parent == segment)
    if body.segment_joint[segment] < 0 or len(children) > 1:
        towards = np.array([0.0, 0.0, 1.0])  # trunk segments are stretched upward
    elif len(children) == 1:
        towards = origins[children[0]] - origins[segment]
    else:
        towards = _centroid(body, segment) - origins[segment]
    norm = float(np.linalg.norm(towards))
    return towards / norm if norm > 1e-9 else np.array([0.0, 0.0, 1.0])


def stretch_maps(body: Body, lengths: Mapping[str, float], girths: Mapping[str, float], stature: float = 1.0) -> Float:
    """(S, 4, 4) affine maps from each segment of the rest pose to its stretched place."""
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
    points = se3.apply(maps[marks.segments], marks.points[:, None])[:, 0]
    jointed = np.flatnonzero(body.segment_joint >= 0).tolist()
    moved = {s: se3.apply(maps[body.segment_parent[s]], body.joint_origins[s, None])[0] for s in jointed}
    marks = Landmarks(marks.names, marks.segments, points)
    return replace(body, vertices=vertices, twists=joints_at(body, moved), landmarks=marks)


def joints_at(body: Body, centres: Mapping[int, Float]) -> Float:
    """(J, 6) twists with the joints of some segments (by number) at new centres (3,) m; axes keep their directions."""
    twists = body.twists.copy()
    for s, centre in centres.items():
        for k in joint_coordinates(body, s):
            if np.any(twists[k, :3]):
                twists[k, 3:] = -np.cross(twists[k, :3], centre)
    return twists


@dataclass(frozen=True)
class RestMotion:
    """How a body's rest pose changes with each of K shape parameters, to first order, per unit of the parameter.

    A point l from a segment's origin moves by the segment's shift and by ``along (a·l) a + across (l − (a·l) a)``.

    Origins and axes (S, 3) are those of `segment_axes`; shifts (K, S, 3) m and stretches (K, S, 2), along and across
    the axis, of each segment's surface; joints (K, S, 3) m of its proximal joint centre in the rest pose.
    """

    origins: Float
    axes: Float
    shifts: Float
    stretches: Float
    joints: Float

    def velocities(self, local: Float) -> Float:
        """(N, S, K, 3) velocities of rest points (N, 3) by each segment, m per unit."""
        arm = local[:, None] - self.origins
        along = np.sum(arm * self.axes, axis=2, keepdims=True) * self.axes
        stretched = np.stack([along, arm - along], axis=2)
        return self.shifts.transpose(1, 0, 2) + np.einsum("ksj,nsji->nski", self.stretches, stretched)

    def rates(self, posed: Posed, segments: Int, weights: Float, local: Float, gradient: Float) -> Float:
        """(N, K) derivative by the parameters of residuals whose gradients by their skinned world points are (N, 3).
        The surface moves in the rest pose and is then skinned; joint centres move the segments below them."""
        rotations = posed.segment_transforms[segments][..., :3, :3]
        turned = np.einsum("nb,nbji,nj->ni", weights, rotations, gradient)
        moved = np.take_along_axis(self.velocities(local), segments[..., None, None].astype(np.int64), axis=1)
        joints = carried(posed, self.joints).transpose(1, 0, 2)[segments]
        by_surface = np.einsum("ni,nb,nbki->nk", turned, weights, moved)
        return by_surface + np.einsum("ni,nb,nbki->nk", gradient, weights, joints)


def carried(posed: Posed, joints: Float) -> Float:
    """(K, S, 3) world velocity of each segment by the velocities (K, S, 3) of joint centres in the rest pose."""
    body, R, out = posed.body, posed.segment_transforms[:, :3, :3], np.zeros_like(joints)
    for s in np.argsort(body.chain.sum(axis=1), kind="stable"):  # from the root outward
        above = int(body.segment_parent[s])
        if above >= 0:
            out[:, s] = out[:, above] + joints[:, s] @ (R[above] - R[s]).T
    return out


def rest_motion(
    body: Body, stretched: Sequence[Mapping[str, float]], widened: Sequence[Mapping[str, float]], moved: Sequence[int]
) -> RestMotion:
    """`RestMotion` by log-lengths and log-girths of groups of segments, then by x, y, z (m) of `moved` joint centres.
    Of each parameter the rate of each segment's log-length (`stretched`) or log-girth (`widened`) is given."""
    (origins, axes), G = segment_axes(body), len(stretched) + len(widened)
    K, S = G + 3 * len(moved), len(body.segment_names)
    shifts, stretches = np.zeros((K, S, 3)), np.zeros((K, S, 2))
    for k, rates in enumerate((*stretched, *widened)):
        for name, rate in rates.items():
            stretches[k, body.segment(name), int(k >= len(stretched))] = rate
    for s, above in enumerate(body.segment_parent):  # a segment moves with the one above
        if above >= 0:
            arm = origins[s] - origins[above]
            along = (arm @ axes[above]) * axes[above]
            shifts[:, s] = shifts[:, above] + stretches[:, above] @ np.stack([along, arm - along])
    joints = shifts.copy()
    for i, s in enumerate(moved):
        joints[G + 3 * i : G + 3 * i + 3, s] = np.eye(3)
    return RestMotion(origins, axes, shifts, stretches, joints)


def joints_shifted(body: Body, shifts: Mapping[int, Float]) -> Float:
    """(J, 6) twists with the joints of some segments (by number) shifted by (3,) m; axes keep their directions."""
    twists = body.twists.copy()
    for s, shift in shifts.items():
        for k in joint_coordinates(body, s):
            twists[k, 3:] -= np.cross(twists[k, :3], shift)
    return twists


def joints_moved(body: Body, shifts: Mapping[str, Float]) -> Body:
    """Joint centres and their landmarks moved by (3,) m in the rest pose, by the name of the segment below.

    The axes keep their directions and the surface its place, so that angles keep their meaning. Raises InputError for
    an unknown segment, or one without a joint.
    """
    points = body.landmarks.points.copy()
    for name, shift in shifts.items():
        if name not in body.segment_names or body.segment_joint[body.segment(name)] < 0:
            raise InputError(f"body {body.name!r} has no segment {name!r} with a joint; check the name.")
        points[marks_of(body, body.segment(name))] += shift
    twists = joints_shifted(body, {body.segment(name): shift for name, shift in shifts.items()})
    return replace(body, twists=twists, landmarks=Landmarks(body.landmarks.names, body.landmarks.segments, points))


def hinge_middles(body: Body) -> dict[str, tuple[Float, float]]:
    """Unit axis (3,) of each hinge across its limb, and distance (m) along it from its centre to the limb's middle.

    By the name of the segment below, in the rest pose. Motion does not determine a hinge's centre on its axis; by
    convention (ISB; Wu et al. 2002, 2005) it is the middle of the limb.
    """
    origins, along = segment_axes(body)
    out: dict[str, tuple[Float, float]] = {}
    for s, name in enumerate(body.segment_names):
        joint, above = joint_coordinates(body, s), int(body.segment_parent[s])
        axis = body.twists[joint[0], :3] if len(joint) == 1 else np.zeros(3)
        if not axis.any() or abs(axis @ along[s]) > _CROSSWISE:
            continue
        own = body.faces[np.isin(body.vertex_part[body.faces], (s, above)).all(axis=1)]
        crossed = line_crossings(body.vertices[own], origins[s], axis)
        if crossed.min(initial=0.0) < 0.0 < crossed.max(initial=0.0):
            inner, outer = crossed[crossed < 0.0].max(), crossed[crossed > 0.0].min()
            out[name] = (axis, 0.5 * float(inner + outer))
    return out


def line_crossings(triangles: Float, origin: Float, direction: Float) -> Float:
    """Places (m along the unit direction) where a line meets triangles (F, 3, 3); Möller and Trumbore 1997."""
    a, e, f = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    across = np.cross(direction, f)
    volume = np.sum(e * across, axis=1)
    scale = 1.0 / np.where(np.abs(volume) > 1e-12, volume, np.inf)
    start = origin - a
    u, turned = scale * np.sum(start * across, axis=1), np.cross(start, e)
    v = scale * (turned @ direction)
    inside = (scale != 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    return (scale * np.sum(f * turned, axis=1))[inside]


def joint_distances(body: Body) -> dict[str, float]:
    """Distance (m) from a segment's joint to that of its child, for segments with one child."""
    out, origins = dict[str, float](), body.joint_origins
    for s, name in enumerate(body.segment_names):
        children = np.flatnonzero(body.segment_parent == s)
        if body.segment_joint[s] >= 0 and len(children) == 1:
            out[name] = float(np.linalg.norm(origins[children[0]] - origins[s]))
    return out
