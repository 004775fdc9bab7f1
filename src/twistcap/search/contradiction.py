"""A camera that contradicts the others is left out, and taken back when it agrees with them again.

It may have been bumped, show an old picture, another camera's, or one of another moment (`out_of_step`). Where its
background is no longer what it was, and that of another one is, that decides; else the others say where the body is, if
they are two or more, and what the one shows there decides. Where the others have lost the body, all are believed again.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Float
from twistcap.ranges import Checked, Count
from twistcap.search import Problem
from twistcap.search.out_of_step import OutOfStep, OutOfStepRule
from twistcap.search.recollection import Check, Judged, Recollection, fitted
from twistcap.search.surroundings import Surroundings


@dataclass(frozen=True)
class ContradictionRule(Checked):
    """When a camera is left out. Evidence is a ratio to what is usual for this body in this camera.

    Attributes:
        clear: nats for each pixel that are clear evidence. Where a body usually has less, the evidence that it lacks is
            divided by this, not by what is usual: a little more or less of little says nothing.
        suspect: evidence in a camera below which the others are asked.
        agreeing: evidence in the others, fitted without it, from which on they are believed.
        wrong: evidence in it, at the place where they see the body, below which it is left out.
        right: evidence there, or in all cameras where they are fitted together, from which on it is taken back; or the
            fraction of the background, if that has decided.
        believed: evidence in the others below which they have lost the body, and all cameras are taken back.
        background: fraction of the background that fits, over what is usual, below which a camera has moved.
        steady: the same, from which on another camera has not: noise and light are no motion of cameras; and the
            fraction of a whole picture that fits, from which on a camera stands as it did.
        every: frames between looks at a camera that is left out, or between suspicions.
        twice: looks in turn that must agree before it is taken back.
        steps: when a camera shows another moment than the others.
    """

    clear: float = 1.5
    suspect: float = 0.75
    agreeing: float = 0.85
    wrong: float = 0.6
    right: float = 0.8
    believed: float = 0.5
    background: float = 0.75
    steady: float = 0.9
    every: Count = 3
    twice: Count = 2
    steps: OutOfStepRule = field(default_factory=OutOfStepRule)


@dataclass(frozen=True)
class Suspicion:
    """What is remembered.

    Attributes:
        agreed: looks in turn at which each camera that is left out has agreed again.
        moved: those of them whose background told it.
        waiting: frames until one is suspected again.
        steps: what is known of cameras that show another moment; None before the first look.
    """

    agreed: Mapping[int, int]
    moved: tuple[int, ...] = ()
    waiting: int = 0
    steps: OutOfStep | None = None

    def of(self, cameras: Set[int]) -> Suspicion:
        """With nothing against all but these cameras."""
        agreed = {camera: times for camera, times in self.agreed.items() if camera in cameras}
        steps = None if self.steps is None else self.steps.of(cameras)
        return replace(self, agreed=agreed, moved=tuple(c for c in self.moved if c in cameras), steps=steps)

    def begun_anew(self) -> Suspicion:
        """For another track through the same recording."""
        return self if self.steps is None else replace(self, steps=self.steps.begun_anew())

    @property
    def out_of_step(self) -> tuple[int, ...]:
        """Cameras that show another moment."""
        return () if self.steps is None else self.steps.cameras


def judged(rule: ContradictionRule, memory: Suspicion, known: Recollection, now: Judged) -> tuple[Judged, Suspicion]:
    """The frame without the cameras that are left out from now on, and what is remembered."""
    memory = memory.of(now.problem.left_out)
    steps = memory.steps or OutOfStep.none(len(known.backdrops))
    now, steps = rule.steps.judged(steps, known, now, rule.agreeing)
    memory = replace(memory, steps=steps)
    if memory.waiting:
        return now, replace(memory, waiting=memory.waiting - 1)
    if now.problem.left_out:
        left_out, memory = _taken_back(rule, memory, known, now)
        now = replace(now, problem=now.problem.excluding(left_out))
        memory = replace(memory, waiting=rule.every - 1)
    each = known.ratios(now.check, rule.clear)
    if np.nan_to_num(each, nan=1.0).min() >= rule.suspect:
        return now, memory
    memory = replace(memory, waiting=rule.every - 1)
    if moved := _moved(rule, known, now.check, each):
        return _without(moved, known, now.problem), replace(memory, moved=(*memory.moved, *sorted(moved)))
    return _without_contradicting(rule, known, each, now) or now, memory


def _moved(rule: ContradictionRule, known: Recollection, check: Check, each: Float) -> frozenset[int]:
    """Suspect cameras whose background is no longer what it was, if that of another one is."""
    fitting = check.fitting / known.fitting  # comparisons with NaN are false
    bad = (fitting < rule.background) & (each < rule.suspect)
    return frozenset(np.flatnonzero(bad).tolist()) if np.any(fitting >= rule.steady) else frozenset()


def _without_contradicting(rule: ContradictionRule, known: Recollection, each: Float, now: Judged) -> Judged | None:
    """The frame without a camera that contradicts at least two others; None where there is none."""
    cameras = [int(c) for c in np.flatnonzero(~np.isnan(each))]
    for camera in sorted(cameras, key=lambda c: each[c])[: 2 if len(cameras) > 2 else 0]:
        if each[camera] >= rule.suspect:
            break
        other = _without({camera}, known, now.problem)
        there = known.ratios(_there(known, camera, other), rule.clear)[camera]  # NaN where it is not in its picture
        if known.ratio(other.check) >= rule.agreeing and not there >= rule.wrong:
            return other
    return None


def _without(cameras: Set[int], known: Recollection, problem: Problem) -> Judged:
    """The frame fitted without some cameras."""
    return fitted(known, problem.excluding(problem.left_out | cameras))


def _there(known: Recollection, camera: int, others: Judged) -> Check:
    """How a camera's picture agrees with the body where the others see it."""
    sight = others.problem.look(camera, others.fit.posed)
    return known.check(others.fit.posed, [] if sight is None else [sight], others.problem)


def _taken_back(
    rule: ContradictionRule, memory: Suspicion, known: Recollection, now: Judged
) -> tuple[frozenset[int], Suspicion]:
    """Cameras that are still left out, after a look at what each shows where the others see the body; none if they do
    not see it.
    """
    if known.ratio(now.check) < rule.believed:
        return frozenset(), memory
    agreed = {camera: memory.agreed.get(camera, 0) for camera in now.problem.left_out}
    for camera in agreed:
        if camera in memory.out_of_step and camera not in memory.moved:
            agreed[camera] = 0
        elif now.problem.frame.images[camera] is not None:
            agreed[camera] = agreed[camera] + 1 if _agrees(rule, memory, known, camera, now) else 0
    return frozenset(c for c in agreed if agreed[c] < rule.twice), replace(memory, agreed=agreed)


def _agrees(rule: ContradictionRule, memory: Suspicion, known: Recollection, camera: int, others: Judged) -> bool:
    """Whether a camera that is left out agrees with the others by now: where they see the body, or all together."""
    check = _there(known, camera, others)
    if camera not in memory.moved:
        return bool(known.ratios(check, rule.clear)[camera] >= rule.right) or _together(rule, known, camera, others)
    return bool(check.fitting[camera] >= rule.right * known.fitting[camera]) or _still(rule, known, camera, others)


def _together(rule: ContradictionRule, known: Recollection, camera: int, others: Judged) -> bool:
    """Whether all cameras agree in a fit with one that is left out. Few others hardly say where all of a body is."""
    again = fitted(known, others.problem.excluding(others.problem.left_out - {camera}))
    each = known.ratios(again.check, rule.clear)
    return bool(each[camera] >= rule.right and np.nanmin(each) >= rule.right)  # NaN is no agreement


def _still(rule: ContradictionRule, known: Recollection, camera: int, others: Judged) -> bool:
    """Whether nearly all of a camera's picture is as it was, wherever the others think that the body is."""
    view = Surroundings.of(camera, known.backdrops[camera], others.fit.posed, others.problem)
    return view is not None and view.fitting(np.zeros(3))[0] >= rule.steady
