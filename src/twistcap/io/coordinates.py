"""The coordinates of an export: one definition for each name, in every file of the run, with standard deviations.

"opensim": pelvis and joints as OpenSim's Rajagopal model has them (`io.angles`). "isb": the joint angles of the
International Society of Biomechanics, whose names begin with ``isb_``; the pelvis is OpenSim's there too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.errors import check_choice
from twistcap.io import angles as convert
from twistcap.io.isb import IsbJoint, isb_joints
from twistcap.io.markers import TO_FILE, WorldAxes

Angles = Literal["opensim", "isb"]
ANGLES: tuple[Angles, ...] = ("opensim", "isb")
_UNDEFINED = np.pi  # rad; the standard deviation of an angle at its gimbal lock


@dataclass(frozen=True)
class Coordinates:
    """C named coordinates over T frames: `values` and `sigmas` (T, C) in rad, m where not `turning` (C,)."""

    names: tuple[str, ...]
    turning: Bool
    values: Float
    sigmas: Float

    @property
    def units(self) -> tuple[str, ...]:
        """C units of `in_degrees`."""
        return tuple("deg" if turns else "m" for turns in self.turning)

    @property
    def in_degrees(self) -> tuple[Float, Float]:
        """Values and standard deviations (T, C), angles in degrees."""
        scale = np.where(self.turning, np.degrees(1.0), 1.0)
        return self.values * scale, self.sigmas * scale


def coordinates_of(
    body: Body, poses: Sequence[Pose], covariances: Float | None = None, angles: Angles = "opensim",
    axes: WorldAxes = "opensim", known: Bool | None = None,
) -> Coordinates:  # fmt: skip
    """The coordinates of T poses; without covariances (T, 6 + J, 6 + J) of the pose step their sigmas are 0.

    Angles are continuous over all frames, or over the `known` (T,) ones: a lost pose that turns leaves no whole turn.

    `axes` are those of the file, see `io.markers`. Standard deviations are carried to first order, by the rates of the
    angles; at a gimbal lock, where an angle is not defined, they are 180°. Raises InputError for unknown angles, axes.
    """
    check_choice("angles", angles, ANGLES)
    check_choice("axes", axes, TO_FILE)
    roots = np.array([pose.root for pose in poses]).reshape(-1, 4, 4)
    pelvis = _pelvis(body, roots, TO_FILE[axes])
    joints = _opensim(body, poses) if angles == "opensim" else _isb(body, poses)
    values, turning = np.hstack([pelvis.values, joints.values]), np.concatenate([pelvis.turning, joints.turning])
    if known is not None and not known.all():
        values[known] = coordinates_of(
            body, [pose for pose, use in zip(poses, known, strict=True) if use], None, angles, axes
        ).values
    sigmas = np.zeros_like(values)
    if covariances is not None:
        by_step = np.concatenate([pelvis.by_step, joints.by_step], axis=1)
        variances = np.einsum("tci,tij,tcj->tc", by_step, covariances, by_step, optimize=True)
        sigmas = np.sqrt(np.maximum(variances, 0.0))
        sigmas[:, turning] = np.minimum(sigmas[:, turning], _UNDEFINED)
    return Coordinates((*pelvis.names, *joints.names), turning, values, sigmas)


def opensim_angles(body: Body, names: Sequence[str], angles: Float) -> Float:
    """Angles (N, C) rad of some of the body's own coordinates, by name, as OpenSim defines them.

    A shoulder of which a name is missing, and frames in which it is NaN, stay as they are.
    """
    out = angles.copy()
    for ours, opensim in convert.shoulders_of(body):
        trio = [body.coordinate_names[k] for k in ours]
        if set(trio) <= set(names):
            columns = [names.index(name) for name in trio]
            known = np.isfinite(angles[:, columns]).all(axis=1)
            q = np.zeros((int(known.sum()), len(body.coordinate_names)))
            q[:, ours] = angles[known][:, columns]
            out[np.flatnonzero(known)[:, None], columns] = convert.reordered(body, q, ours, opensim)[:, ours]
    zeros = dict(zip(body.coordinate_names, convert.zeros_of(body), strict=True))
    return out + np.array([zeros.get(name, 0.0) for name in names])


@dataclass(frozen=True)
class _Part:
    """Some of the coordinates, and their derivatives (T, C, 6 + J) by the pose step."""

    names: tuple[str, ...]
    turning: Bool
    values: Float
    by_step: Float


def _pelvis(body: Body, roots: Float, to_file: Float) -> _Part:
    point = convert.pelvis_point(body)
    turns, place = convert.pelvis_coordinates(roots, point, to_file)
    by_step = np.zeros((len(roots), 6, body.dof))
    by_step[:, :3, :3] = convert.rates(turns, convert.PELVIS_AXES) @ to_file
    by_step[:, 3:, :3] = to_file @ -se3.hat(se3.apply(roots, point[None])[:, 0])
    by_step[:, 3:, 3:6] = to_file
    names = (*convert.PELVIS_ANGLES, *convert.PELVIS_PLACE)
    return _Part(names, np.arange(6) < 3, np.hstack([turns, place]), by_step)


def _opensim(body: Body, poses: Sequence[Pose]) -> _Part:
    """The body's own coordinates, each shoulder in OpenSim's order and with OpenSim's zeros."""
    q = np.array([pose.q for pose in poses]).reshape(len(poses), body.dof - 6)
    by_step = np.tile(np.eye(body.dof)[6:], (len(q), 1, 1))
    out, axes = opensim_angles(body, body.coordinate_names, q), body.twists[:, :3]
    for ours, opensim in convert.shoulders_of(body):
        block = convert.rates(out[:, opensim], axes[opensim]) @ convert.spins(q[:, ours], axes[ours])
        by_step[:, np.array(opensim)[:, None], 6 + np.array(ours)] = block
    return _Part(body.coordinate_names, np.any(body.twists[:, :3] != 0, axis=1), out, by_step)


def _isb(body: Body, poses: Sequence[Pose]) -> _Part:
    joints = isb_joints(body)
    posed = [Posed(body, pose) for pose in poses]
    motions = np.array([p.segment_transforms[:, :3, :3] for p in posed]).reshape(len(posed), -1, 3, 3)
    turns = np.array([p.projector.reshape(-1, 6, body.dof)[:, :3] for p in posed])
    turns = turns.reshape(len(posed), -1, 3, body.dof)
    angles, by_step = np.zeros((len(posed), 0)), np.zeros((len(posed), 0, body.dof))
    for joint in joints:
        own, rate = _isb_angles(joint, motions, turns)
        angles, by_step = np.hstack([angles, own]), np.concatenate([by_step, rate], axis=1)
    names = tuple(name for joint in joints for name in joint.names)
    return _Part(names, np.ones(len(names), bool), angles, by_step)


def _isb_angles(joint: IsbJoint, motions: Float, turns: Float) -> tuple[Float, Float]:
    """Angles (T, 3) of a joint and their derivatives (T, 3, 6 + J), of the rotations (T, S, 3, 3) of the segments and
    their rates (T, S, 3, 6 + J) by the step, in the world."""
    above, below = joint.above, joint.below
    base = motions[:, above.segment] @ above.frame[:3, :3]
    rotations = base.swapaxes(1, 2) @ motions[:, below.segment] @ below.frame[:3, :3]
    moved = base.swapaxes(1, 2) @ (turns[:, below.segment] - turns[:, above.segment])
    return joint.angles(rotations), joint.rates(rotations) @ moved
