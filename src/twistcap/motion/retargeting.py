"""From a skeleton's motion to the coordinates of a body, by the anatomical frames of the segments.

In every frame each segment of the source has the orientation of its anatomical axes (`motion.table`). The body's
coordinates are the least-squares fit of its segments to these orientations; the pelvis takes its orientation exactly.
A long axis has more weight than the turn about it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap import se3
from twistcap.arrays import Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.shape import joint_origin
from twistcap.errors import InputError, check
from twistcap.motion.branches import within_limits
from twistcap.motion.clip import MotionClip
from twistcap.motion.skeleton import SkeletonMotion
from twistcap.motion.table import Calibration, SkeletonTable, calibrated, table_for
from twistcap.solve import PoseProblem, minimise
from twistcap.terms import LimitTerm, Quadratic, RestTerm, Term

# Weights of the directions of a segment's forward, left and up axes. The long axis has most; a foot's is the first.
# Feet and hands have little: their joints cannot follow every turn, and limbs must not bend for them.
_WEIGHTS = {"foot": (0.2, 0.1, 0.1), "hand": (0.2, 0.1, 0.2)}
_USUAL = (0.5, 0.5, 1.0)
_REST = 1e-4  # weight of a rad against a rad of direction, for angles that no target determines
_LIMITS = 0.15  # weight of a rad beyond a limit against a rad of direction
_SWEEPS, _NEAR = 40, 0.02  # and the rad by which the last of them may still turn a joint
_STEPS, _GAIN = 30, 1e-6


@dataclass(frozen=True)
class Targets:
    """Wanted orientations (N, M, 3, 3), from the rest pose to the world, of M segments of a body in N frames. `weights`
    (M, 3) are those of the directions of their three axes."""

    segments: Int
    rotations: Float
    weights: Float


def retarget(
    motion: SkeletonMotion, body: Body, table: SkeletonTable | None = None, scale: float | None = None
) -> MotionClip:
    """The motion in the coordinates of a body with our segment names (`motion.table.SEGMENTS`).

    The skeleton's table is by default the shipped one that fits, the scale of the root's path the ratio of the leg
    lengths, so that feet do not slide. Raises InputError for a skeleton without a table, or that lacks a joint of it,
    or a body without our segments.
    """
    known = calibrated(motion, table or table_for(motion))
    turned = _world_turn(motion, known)
    mid_hip = 0.5 * (_origin(body, "femur_r") + _origin(body, "femur_l"))
    targets = _targets(motion, body, known, turned)
    pelvis = turned @ motion.rotations[:, known.joints["pelvis"]] @ known.axes["pelvis"]
    factor = leg_length(body) / _source_leg(motion, known) if scale is None else scale
    hips = [motion.positions[:, known.joints[f"femur_{side}"]] for side in "rl"]
    place = factor * 0.5 * (hips[0] + hips[1]) @ turned.T
    roots = se3.transform(pelvis, place - pelvis @ mid_hip)
    angles = _fitted_angles(body, roots, targets, motion.rate)
    return MotionClip(motion.name, body.coordinate_names, motion.rate, roots, angles)


def leg_length(body: Body) -> float:
    """Thigh and shank of a body's rest pose, mean of both sides, m."""
    return float(np.mean([_path([_origin(body, f"{p}_{s}") for p in ("femur", "tibia", "foot")]) for s in "rl"]))


def _source_leg(motion: SkeletonMotion, known: Calibration) -> float:
    """As `leg_length`; without feet the shank is taken to be as long as the thigh."""
    rest, lengths = motion.rest_positions(), list[float]()
    for side in "rl":
        joints = [known.joints.get(f"{part}_{side}") for part in ("femur", "tibia", "foot")]
        points = [rest[j] for j in joints if j is not None]
        lengths.append(_path(points) * 2.0 / (len(points) - 1))
    check(f"motion {motion.name!r}", min(lengths) > 0, "its legs have no length, so that its path cannot be scaled")
    return float(np.mean(lengths))


def _path(points: list[Float]) -> float:
    return float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))


def _origin(body: Body, segment: str) -> Float:
    if segment not in body.segment_names:
        raise InputError(f"body {body.name!r} has no segment {segment!r}, onto which a motion could be brought.")
    return joint_origin(body, body.segment(segment))


def _world_turn(motion: SkeletonMotion, known: Calibration) -> Float:
    """(3, 3) from the file's axes to our world: z up, and the rest pose facing +x."""
    up = np.eye(3)["xyz".index(motion.up)]
    forward = known.axes["pelvis"][:, 0] - up * (up @ known.axes["pelvis"][:, 0])
    if np.linalg.norm(forward) < 1e-3:  # a lying rest pose
        forward = known.axes["pelvis"][:, 2] - up * (up @ known.axes["pelvis"][:, 2])
    forward = forward / np.linalg.norm(forward)
    return np.stack([forward, np.cross(up, forward), up])


def _targets(motion: SkeletonMotion, body: Body, known: Calibration, turned: Float) -> Targets:
    names = {name: name for name in known.joints if name in body.segment_names}
    if "thorax" in known.joints and "thorax" not in names and "torso" in body.segment_names:
        names["thorax"] = "torso"  # the one trunk segment carries head and arms
    rotations = [turned @ motion.rotations[:, known.joints[source]] @ known.axes[source] for source in names]
    weights = [_WEIGHTS.get(own.partition("_")[0], _USUAL) for own in names.values()]
    segments = np.array([body.segment(own) for own in names.values()], dtype=np.int32)
    return Targets(segments, np.stack(rotations, axis=1), np.array(weights))


def _fitted_angles(body: Body, roots: Float, targets: Targets, rate: float) -> Float:
    """(N, J) coordinates that fit the segments to their targets, each frame starting from the one before."""
    out = np.zeros((len(roots), len(body.coordinate_names)))
    q = _swept(body, Pose(roots[0], out[0]), targets)
    for n, root in enumerate(roots):
        q = out[n] = _refined(body, Pose(root, q), targets, n)
    out, bridged = within_limits(body, out, rate)
    for n in np.flatnonzero(~bridged):
        out[n] = _refined(body, Pose(roots[n], out[n]), targets, int(n), [LimitTerm(1.0 / _LIMITS)])
    return out


def _swept(body: Body, pose: Pose, targets: Targets) -> Float:
    """A start for the first frame, by coordinate descent. With all others fixed Σ w t·(R e) is A cos δ + B sin δ of a
    coordinate's change δ, greatest at atan2(B, A)."""
    moves, q = body.chain[targets.segments], pose.q.copy()
    want = np.swapaxes(targets.rotations[0], 1, 2) * targets.weights[:, :, None] ** 2  # (M, axis, xyz)
    for _ in range(_SWEEPS):
        last = q.copy()
        for k in range(len(q)):
            posed = Posed(body, Pose(pose.root, q))
            have = np.swapaxes(posed.segment_transforms[targets.segments, :3, :3], 1, 2)[moves[:, k]]
            w, aim = posed.world_twists[k, :3], want[moves[:, k]]
            a = np.sum(aim * (have - (have @ w)[..., None] * w))
            b = np.sum(aim * np.cross(w, have))
            if np.hypot(a, b) > 1e-9:
                q[k] += np.arctan2(b, a)
        if np.abs(q - last).max() < _NEAR:
            break
    return q - 2 * np.pi * np.round((q - body.limits.mean(axis=1)) / (2 * np.pi))


def _refined(body: Body, pose: Pose, targets: Targets, n: int, limits: Sequence[Term] = ()) -> Float:
    """The coordinates that fit frame n best, from some on, with a weak term towards zero and one of the limits."""
    root = np.arange(body.dof) < 6
    directions = DirectionTerm(targets.segments, targets.rotations[n], targets.weights**2)
    problem = PoseProblem([directions, RestTerm(1.0 / _REST), *limits], fixed=root)
    return minimise(problem, Posed(body, pose), _STEPS, damping=1e-6, gain=_GAIN).x.pose.q


@dataclass(frozen=True)
class DirectionTerm:
    """``½ Σ w² |h − t|²`` of the axes h of M segments about their targets t: the columns of `rotations` (M, 3, 3).

    `squares` (M, 3) are the w². For the axis h and a coordinate that turns about ω, the derivative of h is ω × h: the
    gradient is ``Σ w² ω·(t × h)``, and the curvature of two coordinates ``Σ w² ω·(I − h hᵀ) ω'``.
    """

    segments: Int
    rotations: Float
    squares: Float
    name: str = "directions"

    def energy(self, posed: Posed) -> float:
        have = posed.segment_transforms[self.segments, :3, :3]
        return 0.5 * float(np.sum(self.squares[:, None] * (have - self.rotations) ** 2))

    def linearize(self, posed: Posed) -> Quadratic:
        have = posed.segment_transforms[self.segments, :3, :3]
        weighted = self.squares[:, None, :] * have
        product = weighted @ self.rotations.mT  # Σ w² h tᵀ, whose antisymmetric part is Σ w² t × h
        by_turn = (product - product.mT)[:, [2, 0, 1], [1, 2, 0]]
        spread = np.sum(self.squares, axis=1)[:, None, None] * np.eye(3) - weighted @ have.mT
        moves = np.hstack([np.ones((len(have), 6)), posed.body.chain[self.segments]])
        turns = moves[..., None] * np.vstack([np.eye(6, 3), posed.world_twists[:, :3]])  # (M, 6 + J, 3)
        gradient = np.einsum("mji,mi->j", turns, by_turn)
        return Quadratic(self.energy(posed), gradient, np.sum(turns @ spread @ turns.mT, axis=0))


def grounded(clip: MotionClip, body: Body) -> MotionClip:
    """The clip moved up or down as a whole, so that the 5 % percentile of its lowest points is on the floor z = 0.
    After retargeting feet may be too high or low, since their thickness differs from the source's."""
    every = max(1, len(clip) // 60)
    lowest = [Posed(body, pose).vertices[:, 2].min() for pose in clip.poses()[::every]]
    roots = clip.roots.copy()
    roots[:, 2, 3] -= np.percentile(lowest, 5)
    return replace(clip, roots=roots)
