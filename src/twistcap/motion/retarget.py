"""From a skeleton's motion to the coordinates of a body, by the anatomical frames of the segments.

In every frame each segment of the source has an orientation in the world: that of its anatomical axes (`motion.table`). The
body's coordinates are those whose segments come nearest to these orientations in the sense of least squares; the pelvis
takes its orientation exactly. Joints with fewer axes than the source's, or with oblique ones, find the best compromise,
and a long axis counts more than the turn about it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap import se3
from twistcap._typing import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.shape import joint_origin
from twistcap.errors import InputError
from twistcap.motion.clip import MotionClip
from twistcap.motion.skeleton import SkeletonMotion
from twistcap.motion.table import Calibration, SkeletonTable, calibrated, table_for

# How much the directions of a segment's forward, left and up axes count. The long axis is what one sees; a foot's is the
# first. Feet and hands count little: their joints cannot follow every turn, and limbs shall not bend aside for them.
_WEIGHTS = {"foot": (0.2, 0.1, 0.1), "hand": (0.2, 0.1, 0.2)}
_USUAL = (0.5, 0.5, 1.0)
_REST = 1e-3  # pull to zero of what no target determines: a rad of it counts like a milliradian of direction
_LIMITS = 0.05  # a rad beyond a limit counts like 0.05 rad of direction
_SWEEPS, _STEPS, _TOLERANCE = 40, 30, 1e-7


@dataclass(frozen=True)
class Targets:
    """What M segments of a body shall look like in N frames.

    Attributes:
        segments: (M,) of the body.
        rotations: (N, M, 3, 3) from the rest pose to the world.
        weights: (M, 3) of the directions of their three axes.
    """

    segments: Int
    rotations: Float
    weights: Float


def retarget(
    motion: SkeletonMotion, body: Body, table: SkeletonTable | None = None, scale: float | None = None
) -> MotionClip:
    """The motion in a body's coordinates.

    Args:
        motion: of a skeleton.
        body: with our segment names (`motion.table.SEGMENTS`).
        table: of the skeleton; None takes the shipped one that fits.
        scale: of the root's path; None takes the ratio of the lengths of the legs, so that feet neither slide nor float.

    Raises:
        InputError: for a skeleton that no shipped table fits or that lacks a joint of the table, or a body without our
            segments.
    """
    known = calibrated(motion, table or table_for(motion))
    turned = _world_turn(motion, known)
    targets = _targets(motion, body, known, turned)
    pelvis = turned @ motion.rotations[:, known.joints["pelvis"]] @ known.axes["pelvis"]
    factor = leg_length(body) / _source_leg(motion, known) if scale is None else scale
    hips = [motion.positions[:, known.joints[f"femur_{side}"]] for side in "rl"]
    place = factor * 0.5 * (hips[0] + hips[1]) @ turned.T
    roots = se3.transform(pelvis, place - pelvis @ _mid_hip(body))
    return MotionClip(motion.name, body.coordinate_names, motion.rate, roots, fitted_angles(body, roots, targets))


def leg_length(body: Body) -> float:
    """Thigh and shank of a body's rest pose, mean of both sides, m."""
    return float(np.mean([_path([_origin(body, f"{p}_{s}") for p in ("femur", "tibia", "foot")]) for s in "rl"]))


def _source_leg(motion: SkeletonMotion, known: Calibration) -> float:
    """As `leg_length`; a skeleton without feet counts with a shank as long as its thigh."""
    rest, lengths = motion.rest_positions(), list[float]()
    for side in "rl":
        joints = [known.joints.get(f"{part}_{side}") for part in ("femur", "tibia", "foot")]
        points = [rest[j] for j in joints if j is not None]
        lengths.append(_path(points) * 2.0 / (len(points) - 1))
    if not min(lengths) > 0:
        raise InputError(f"motion {motion.name!r}: its legs have no length, so that its path cannot be scaled.")
    return float(np.mean(lengths))


def _path(points: list[Float]) -> float:
    return float(sum(np.linalg.norm(b - a) for a, b in zip(points, points[1:], strict=False)))


def _origin(body: Body, segment: str) -> Float:
    if segment not in body.segment_names:
        raise InputError(f"body {body.name!r} has no segment {segment!r}, onto which a motion could be brought.")
    return joint_origin(body, body.segment(segment))


def _mid_hip(body: Body) -> Float:
    return 0.5 * (_origin(body, "femur_r") + _origin(body, "femur_l"))


def _world_turn(motion: SkeletonMotion, known: Calibration) -> Float:
    """(3, 3) from the file's axes to our world: z up, and the rest pose facing +x."""
    up = np.eye(3)["xyz".index(motion.up)]
    forward = known.axes["pelvis"][:, 0] - up * (up @ known.axes["pelvis"][:, 0])
    if np.linalg.norm(forward) < 1e-3:  # a rest pose that lies on its back or front
        forward = known.axes["pelvis"][:, 2] - up * (up @ known.axes["pelvis"][:, 2])
    forward = forward / np.linalg.norm(forward)
    return np.stack([forward, np.cross(up, forward), up])


def _targets(motion: SkeletonMotion, body: Body, known: Calibration, turned: Float) -> Targets:
    names = {name: name for name in known.joints if name in body.segment_names}
    if "thorax" in known.joints and "thorax" not in body.segment_names:
        names["thorax"] = "torso"  # the one trunk segment carries head and arms
    names = {source: own for source, own in names.items() if own in body.segment_names}
    rotations = [turned @ motion.rotations[:, known.joints[source]] @ known.axes[source] for source in names]
    weights = [_WEIGHTS.get(own.partition("_")[0], _USUAL) for own in names.values()]
    segments = np.array([body.segment(own) for own in names.values()], dtype=np.int32)
    return Targets(segments, np.stack(rotations, axis=1), np.array(weights))


def fitted_angles(body: Body, roots: Float, targets: Targets) -> Float:
    """(N, J) coordinates whose segments come nearest to their targets, each frame followed from the one before.

    Args:
        body: with J coordinates.
        roots: (N, 4, 4) root motions.
        targets: in the world.
    """
    out = np.zeros((len(roots), len(body.coordinate_names)))
    q = _swept(body, Pose(roots[0], out[0]), targets)
    for n, root in enumerate(roots):
        q = _refined(body, Pose(root, q), targets, n)
        out[n] = q
    for joint in _square_joints(body):
        out[:, joint] = _nearest_branch(out[:, joint], body.limits[joint])
    return out


def _square_joints(body: Body) -> list[list[int]]:
    """Coordinates of the joints of three axes square to each other, whose rotations have two sets of angles each."""
    chains = [[int(body.parent[int(body.parent[k])]), int(body.parent[k]), k] for k in range(2, len(body.parent))]
    chains = [c for c in chains if min(c) >= 0]
    ends = {int(k) for k in body.segment_joint}
    whole = [c for c in chains if c[2] in ends and c[0] not in ends and c[1] not in ends]
    return [c for c in whole if np.allclose(body.twists[c, :3] @ body.twists[c, :3].T, np.eye(3), atol=1e-6)]


def _nearest_branch(angles: Float, limits: Float) -> Float:
    """Of the two sets (N, 3) that are the same rotations, each up to whole turns, the one that keeps the limits best."""
    flipped = angles * [1.0, -1.0, 1.0] + np.pi
    both = [a - 2 * np.pi * np.round((a.mean(axis=0) - limits.mean(axis=1)) / (2 * np.pi)) for a in (angles, flipped)]
    beyond = [np.sum(np.abs(a - np.clip(a, limits[:, 0], limits[:, 1]))) for a in both]
    return both[int(np.argmin(beyond))]


def _swept(body: Body, pose: Pose, targets: Targets) -> Float:
    """A start from afar, for the first frame: one coordinate after the other takes its best angle, several times over.

    With all others fixed the sum of Σ w t·(R e) is A cos δ + B sin δ, whose greatest value is at atan2(B, A).
    """
    moves, q = body.chain[targets.segments], pose.q.copy()
    want = np.swapaxes(targets.rotations[0], 1, 2) * targets.weights[:, :, None] ** 2  # (M, axis, xyz)
    for _ in range(_SWEEPS):
        for k in range(len(q)):
            posed = Posed(body, Pose(pose.root, q))
            R = posed.segment_transforms[targets.segments, :3, :3]
            w, m = posed.world_twists[k, :3], moves[:, k]
            have = np.swapaxes(R, 1, 2)[m]
            along = have @ w
            a = np.sum(want[m] * (have - along[..., None] * w))
            b = np.sum(want[m] * np.cross(w, have))
            if np.hypot(a, b) > 1e-9:
                q[k] += np.arctan2(b, a)
    return q - 2 * np.pi * np.round((q - body.limits.mean(axis=1)) / (2 * np.pi))


def _refined(body: Body, pose: Pose, targets: Targets, n: int) -> Float:
    """Levenberg-Marquardt on the differences of directions, with weak pulls to zero and into the limits."""
    q, damping = pose.q, 1e-4
    value, gradient, curvature = _normal_equations(body, pose, targets, n)
    for _ in range(_STEPS):
        step = -np.linalg.solve(curvature + damping * np.eye(len(q)), gradient)
        tried = _normal_equations(body, Pose(pose.root, q + step), targets, n)
        if tried[0] > value:
            damping = 10.0 * damping
        else:
            q, (value, gradient, curvature), damping = q + step, tried, 0.1 * damping
        if np.abs(step).max() < _TOLERANCE or damping > 1e6:
            break
    return q


def _normal_equations(body: Body, pose: Pose, targets: Targets, n: int) -> tuple[float, Float, Float]:
    """Half the sum of squares, its gradient (J,) and its Gauss-Newton curvature (J, J)."""
    posed = Posed(body, pose)
    have = posed.segment_transforms[targets.segments, :3, :3]  # columns are the axes
    weights = np.repeat(targets.weights[:, None, :], 3, axis=1)
    r = (weights * (have - targets.rotations[n])).reshape(-1)
    by_turn = se3.hat(posed.world_twists[:, :3])  # (J, 3, 3)
    moved = weights[..., None] * np.einsum("kij,mja->miak", by_turn, have) * body.chain[targets.segments][:, None, None]
    J = moved.reshape(len(r), -1)
    q, limits = pose.q, body.limits
    outside = _LIMITS * (q - np.clip(q, limits[:, 0], limits[:, 1]))
    value = 0.5 * float(r @ r + outside @ outside + _REST**2 * (q @ q))
    gradient = J.T @ r + _LIMITS * outside + _REST**2 * q
    return value, gradient, J.T @ J + np.diag(_LIMITS**2 * (outside != 0) + _REST**2)
