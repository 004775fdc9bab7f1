"""The first pose may be given beside the person: then places about it are tried, by how well the contour agrees there.

Nothing has been learnt of the recording yet, but a contour that lies on a body agrees nearly everywhere, and one beside
it hardly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose
from twistcap.cues.observation import Fit
from twistcap.ranges import Checked, Count, Range, Share, Signed
from twistcap.search import Problem

_UP = np.array([0.0, 0.0, 1.0])
_RING = np.exp(2j * np.pi * np.arange(8) / 8)


@dataclass(frozen=True)
class BesideRule(Checked):
    """When and how widely the first place is looked for. Agreement is a fraction of all contour points.

    Attributes:
        good: agreement from which on the pose is taken as it is.
        better: agreement that must be gained.
        rings: m, radii of the places that are tried about the best so far.
        turns: degrees by which the body is turned there.
        rounds: of this, at most.
        margin: m about a place within which images are looked at.
    """

    good: Share = 0.75
    better: Share = 0.1
    rings: tuple[float, ...] = (0.15, 0.3)
    turns: tuple[Signed, ...] = (-45.0, 45.0)
    rounds: Count = 4
    margin: Annotated[float, Range(0.0, 2.0)] = 0.3


def beside(rule: BesideRule, problem: Problem, fit: Fit) -> Fit:
    """The fit of a pose beside the given one, where the contour agrees much better; else the fit itself."""
    best, most = fit, agreement(fit)
    for _ in range(rule.rounds):
        if most >= rule.good:
            break
        before = most
        for pose in _about(rule, best.pose):
            other = problem.afresh(pose, rule.margin)
            if agreement(other) > most:
                best, most = other, agreement(other)
        if most <= before:
            break
    return best if most > agreement(fit) + rule.better else fit


def agreement(fit: Fit) -> float:
    """Fraction of all contour points that agree with the images."""
    return float(fit.agreement.agreeing.sum() / max(fit.agreement.points.sum(), 1.0))


def _about(rule: BesideRule, pose: Pose) -> Sequence[Pose]:
    """Poses in rings about one, and turned."""
    shifts = [np.array([radius * p.real, radius * p.imag, 0.0]) for radius in rule.rings for p in _RING]
    turns = [se3.exp_rotation(np.deg2rad(turn) * _UP) for turn in rule.turns]
    moved = [_moved(pose, np.eye(3), shift) for shift in shifts]
    return [*moved, *(_moved(pose, turn, np.zeros(3)) for turn in turns)]


def _moved(pose: Pose, turn: Float, shift: Float) -> Pose:
    """A pose turned about its own root, and shifted."""
    return Pose(se3.transform(turn @ pose.root[:3, :3], pose.root[:3, 3] + shift), pose.q)
