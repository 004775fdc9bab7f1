"""Limbs of the two sides, each put where the other one is.

Legs that have been taken for each other cannot be set right one by one: each covers what the other one should.
"""

from __future__ import annotations

import numpy as np

from twistcap.arrays import Bool
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import limb_parts, limbs
from twistcap.body.model import partners

_STEPS, _DAMPING, _FARTHEST = 12, 0.05, 0.6  # of Gauss–Newton; m; rad in one step
_REACHED = 0.2  # m from its place within which each segment of both limbs must come


def exchanged(body: Body, pose: Pose) -> list[Pose]:
    """The pose with each pair of limbs exchanged that can be, segment for segment."""
    return [other for both in _pairs(body) if (other := _exchanged(body, pose, both)) is not None]


def _pairs(body: Body) -> list[Bool]:
    """Masks (6 + J,) of the coordinates of each limb and of the other side's."""
    other = np.append(np.arange(6), 6 + np.array(partners(body.coordinate_names), int))
    one_of_each = (limb for limb in limbs(body) if np.flatnonzero(limb)[0] < np.flatnonzero(limb[other])[0])
    return [limb | limb[other] for limb in one_of_each]


def _exchanged(body: Body, pose: Pose, both: Bool) -> Pose | None:
    """With a pair of limbs exchanged by damped least squares; None where one of them does not come there."""
    parts, joints = np.flatnonzero(limb_parts(body, both)).astype(np.int32), np.flatnonzero(both)
    segments, weights, middles = parts[:, None], np.ones((len(parts), 1)), body.segment_middles[parts]
    target = Posed(body, pose).segment_middles[np.array(partners(body.segment_names))[parts]]
    damping = _DAMPING**2 * np.eye(len(joints))
    for _ in range(_STEPS):
        posed, step = Posed(body, pose), np.zeros(body.dof)
        away = (target - posed.points(segments, weights, middles)).ravel()
        J = posed.point_jacobian(segments, weights, middles).reshape(len(away), -1)[:, joints]
        step[joints] = np.clip(np.linalg.solve(J.T @ J + damping, J.T @ away), -_FARTHEST, _FARTHEST)
        pose = pose.retract(step).within(body.limits)
    gaps = np.linalg.norm(target - Posed(body, pose).points(segments, weights, middles), axis=1)
    return pose if gaps.max() < _REACHED else None
