"""The first pose may be given beside the person, or with a limb elsewhere: others are tried by how well contours agree.

Nothing has been learnt of the recording yet, but a contour that lies on a body agrees nearly everywhere, and one beside
it hardly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Pose
from twistcap.body.limbs import limbs
from twistcap.body.model import partners
from twistcap.cues.observation import Fit
from twistcap.ranges import Checked, Count, Range, Share, Signed
from twistcap.search import Problem
from twistcap.search.draws import about, anywhere

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
        limb_poor, limb_good: agreement of a limb's own contour below which it is looked for, and from which on it is
            found.
        points: of a limb's contour, below which nothing is said of it.
        draws, near: poses of a limb that are tried about the best so far in each round, and rad, their standard
            deviations; twice as many anywhere before.
    """

    good: Share = 0.75
    better: Share = 0.1
    rings: tuple[float, ...] = (0.15, 0.3)
    turns: tuple[Signed, ...] = (-45.0, 45.0)
    rounds: Count = 4
    margin: Annotated[float, Range(0.0, 2.0)] = 0.3
    limb_poor: Share = 0.6
    limb_good: Share = 0.85
    points: Count = 8
    draws: Count = 16
    near: tuple[float, ...] = (0.7, 0.5, 0.25)


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


def limbs_beside(rule: BesideRule, problem: Problem, fit: Fit, groups: Bool) -> Fit:
    """The fit with limbs elsewhere where their contours agree much better; `groups` (G, S) are their segments."""
    for limb, group in zip(limbs(problem.body), groups[:-1], strict=True):
        shown = fit.agreement.points[group].sum() >= rule.points
        if shown and _agreement_of(fit, group, rule.points) < rule.limb_poor:
            other = _limb_placed(rule, problem, fit, limb, group)
            good = _agreement_of(other, group, rule.points) >= rule.limb_good
            fit = other if good and agreement(other) > agreement(fit) else fit
    return fit


def _limb_placed(rule: BesideRule, problem: Problem, fit: Fit, limb: Bool, group: Bool) -> Fit:
    """The fit whose limb and whole body agree best, of draws and of the limb as that of the other side is; the rest of
    the body starts from where it was.
    """
    rng, body, here = np.random.default_rng(0), problem.body, fit.pose
    as_other = Pose(here.root, here.q[partners(body.coordinate_names)]).minus(here)

    def score(other: Fit) -> float:
        return _agreement_of(other, group, rule.points) + agreement(other)

    steps = np.vstack([np.where(limb, as_other, 0.0), anywhere(rng, limb, here, body, 2 * rule.draws)])
    best, moved = fit, np.zeros(len(limb))
    for near in (*rule.near, 0.0):
        poses = [here.retract(step).within(body.limits) for step in steps]
        best = max([best, *(problem.afresh(pose, rule.margin) for pose in poses)], key=score)
        moved = np.where(limb, best.pose.minus(here), 0.0)
        steps = moved + about(rng, limb, near, rule.draws)
    return problem.align(here.retract(moved))


def _agreement_of(fit: Fit, group: Bool, fewest: int) -> float:
    """Fraction of the contour points of a limb (S,) that agree; 0 of too few."""
    points = float(fit.agreement.points[group].sum())
    return float(fit.agreement.agreeing[group].sum()) / points if points >= fewest else 0.0


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
