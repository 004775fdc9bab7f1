"""A camera that contradicts the others is left out, and taken back when it agrees with them again.

It may have been bumped, show an old picture, another camera's, or one of another moment. With three cameras or more
the others say where the body is, and what the one shows there decides; of two, that one is left out whose background
is no longer what it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.cues.observation import Fit
from twistcap.ranges import Checked, Count
from twistcap.search import Problem
from twistcap.search.recollection import Check, Recollection


@dataclass(frozen=True)
class ContradictionRule(Checked):
    """When a camera is left out. Evidence is a ratio to what is usual for this body in this camera.

    Attributes:
        suspect: evidence in a camera below which the others are asked.
        agreeing: evidence in the others, fitted without it, from which on they are believed.
        wrong: evidence in it, at the place where they see the body, below which it is left out.
        right: evidence there from which on it is taken back.
        background: fraction of the background that fits, over what is usual, below which a camera has moved.
        every: frames between looks at a camera that is left out, or between suspicions.
        twice: looks in turn that must agree before it is taken back.
    """

    suspect: float = 0.75
    agreeing: float = 0.85
    wrong: float = 0.6
    right: float = 0.8
    background: float = 0.5
    every: Count = 3
    twice: Count = 2


@dataclass(frozen=True)
class Suspicion:
    """What is remembered.

    Attributes:
        agreed: looks in turn at which each camera that is left out has agreed again.
        waiting: frames until one is suspected again.
    """

    agreed: Mapping[int, int]
    waiting: int = 0


def judged(
    rule: ContradictionRule, memory: Suspicion, known: Recollection, fit: Fit, problem: Problem
) -> tuple[frozenset[int], Suspicion, Fit]:
    """The cameras that are left out from now on, what is remembered, and the fit without them."""
    if memory.waiting:
        return problem.left_out, replace(memory, waiting=memory.waiting - 1), fit
    if problem.left_out:
        left_out, memory = _taken_back(rule, memory, known, fit, problem)
        problem, memory = problem.excluding(left_out), replace(memory, waiting=rule.every - 1)
    each = known.ratios(*_pair(known.check(fit.posed, fit.sights, problem)))
    if np.nan_to_num(each, nan=1.0).min() >= rule.suspect:
        return problem.left_out, memory, fit
    found = _contradicting(rule, known, each, fit, problem)
    memory = replace(memory, waiting=rule.every - 1)
    return (problem.left_out, memory, fit) if found is None else (problem.left_out | {found[0]}, memory, found[1])


def _contradicting(
    rule: ContradictionRule, known: Recollection, each: Float, fit: Fit, problem: Problem
) -> tuple[int, Fit] | None:
    """A camera that contradicts all others, and the fit without it; None where there is none."""
    cameras = [int(c) for c in np.flatnonzero(~np.isnan(each))]
    if len(cameras) == 2:
        moved = _moved(rule, known, known.check(fit.posed, fit.sights, problem), cameras)
        return None if moved is None else (moved, problem.without(moved).align(problem.start))
    for camera in sorted(cameras, key=lambda c: each[c])[: 2 if len(cameras) > 2 else 0]:
        if each[camera] >= rule.suspect:
            break
        other = problem.without(camera).align(problem.start)
        here = known.ratio(*_pair(known.check(other.posed, other.sights, problem)))
        if here >= rule.agreeing and _there(known, camera, other, problem) < rule.wrong:
            return camera, other
    return None


def _there(known: Recollection, camera: int, fit: Fit, problem: Problem) -> float:
    """Evidence in a camera where the others see the body; 0 where it is not in its picture."""
    sight = problem.look(camera, fit.posed)
    check = known.check(fit.posed, [] if sight is None else [sight], problem)
    return float(np.nan_to_num(known.ratios(*_pair(check))[camera]))


def _pair(check: Check) -> tuple[Float, Float]:
    return check.nats, check.pixels


def _moved(rule: ContradictionRule, known: Recollection, check: Check, cameras: Sequence[int]) -> int | None:
    """The one of two cameras whose background alone is no longer what it was."""
    fitting = np.nan_to_num(check.fitting / known.fitting, nan=1.0)
    bad = [camera for camera in cameras if fitting[camera] < rule.background]
    return bad[0] if len(bad) == 1 else None


def _taken_back(
    rule: ContradictionRule, memory: Suspicion, known: Recollection, fit: Fit, problem: Problem
) -> tuple[frozenset[int], Suspicion]:
    """Cameras that are still left out, after a look at what each shows where the others see the body."""
    agreed = {camera: memory.agreed.get(camera, 0) for camera in problem.left_out}
    for camera in problem.left_out:
        if problem.frame.images[camera] is not None:
            agrees = _there(known, camera, fit, problem) >= rule.right
            agreed[camera] = agreed[camera] + 1 if agrees else 0
    return frozenset(c for c in agreed if agreed[c] < rule.twice), replace(memory, agreed=agreed)
