"""Limbs whose contour suddenly no longer agrees with the images are searched for, in the same frame.

A contour pulls a limb from a hand's breadth away, and an arm in a somersault goes farther than that between two frames.
Its contour stops agreeing with the images at once, so poses of that limb alone are drawn, anywhere within its joints'
limits and about the best, and judged by the pixels that change hands (annealed search of one branch of the body:
Deutscher and Reid, IJCV 2005, doi:10.1023/B:VISI.0000043757.18370.9c).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose
from twistcap.body.limbs import limb_parts, limbs
from twistcap.camera import Rig
from twistcap.cues.observation import Agreement, Fit
from twistcap.errors import InputError
from twistcap.predict.history import Past, rested
from twistcap.ranges import Checked, Count, Share
from twistcap.search import Problem, Revision
from twistcap.search.draws import about, anywhere
from twistcap.search.judge import Judge, best_of
from twistcap.stages import stage

ROOT = 6  # coordinates of the root, which come first


@dataclass(frozen=True)
class LimbAgreement:
    """How well the contour of each of L limbs agrees with the images.

    Attributes:
        parts: (L, S) the segments of each limb.
        mean: (L,) fraction of agreeing points of late; NaN where it was never judged.
        usual: (L,) what is usual.
        slipped: limbs that agree much less than usual, in the last frame.
        searches: that there have been.
    """

    parts: Bool
    mean: Float
    usual: Float
    slipped: tuple[int, ...] = ()
    searches: int = 0


@dataclass(frozen=True)
class SlippedLimbs(Checked):
    """When and how a limb is searched for.

    Attributes:
        drop: fraction of its usual agreement with the images below which a limb is searched for.
        memory: fraction that the usual agreement keeps from frame to frame where the present one is worse: what is not
            found is searched for again, and what is seldom seen well is left alone after a while.
        recent: fraction that the mean agreement of late keeps from frame to frame; the usual one is no less.
        least_points: contour points of a limb, over all views, below which it is not judged.
        hardly: fraction of all contour points that agree below which the body is lost as a whole.
        near: rad, standard deviations of the draws about the best, one round after the other.
        draws: poses of each limb in each round, and as many anywhere within its limits.
        gain: nats by which the images must favour each limb where it is found.
        better: fraction of its contour points that must come to agree beside, in the mean of the limbs found.
        reach: m about the body within which images are looked at.
        seed: of the draws, which are the same in every run.
    """

    drop: Share = 0.8
    memory: Share = 0.99
    recent: Share = 0.8
    least_points: Count = 12
    hardly: Share = 0.25
    near: tuple[float, ...] = (0.5, 0.25, 0.125)
    draws: Count = 64
    gain: float = 40.0
    better: Share = 0.1
    reach: float = 0.6
    seed: int = 0
    name: str = field(default="slipped limbs", init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.near:
            raise InputError("limb search: near is empty; give one reach or more, m.")

    def start(self, body: Body, rig: Rig) -> LimbAgreement:
        """No limb has been judged."""
        parts = np.array([limb_parts(body, limb) for limb in limbs(body)]).reshape(-1, len(body.segment_names))
        return LimbAgreement(parts, np.full(len(parts), np.nan), np.zeros(len(parts)))

    def wanted_margin(self, past: Past, time: float) -> float | None:
        """It looks for nothing before the fit."""

    def begin(self, memory: LimbAgreement, problem: Problem) -> tuple[None, LimbAgreement]:
        """The fit starts where it is expected."""
        return None, memory

    def revise(self, memory: LimbAgreement, problem: Problem, fit: Fit) -> tuple[Revision | None, LimbAgreement]:
        """A fit with the slipped limbs elsewhere, where their contours agree better."""
        if not problem.past.started or not problem.views or not problem.trusted:
            return None, memory
        before, memory = memory.slipped, self.judged(memory, fit.agreement)
        hardly = fit.agreement.agreeing.sum() < self.hardly * fit.agreement.points.sum()  # the body is lost as a whole
        if not memory.slipped or hardly:
            return None, memory
        with stage("search"):
            judge = problem.judge(fit.posed, self.reach)
            others = (problem.start, problem.past.last)
            pose, found = self.found(memory, judge, fit.pose, others)
            memory = replace(memory, searches=memory.searches + 1)
            if not found:
                return None, memory
            other = problem.align(pose, crop=True)
        if not self.improves(memory, judge, found, fit, other):
            return None, memory
        regained = self._coordinates(problem.body, [i for i in found if i in before])
        return Revision(other, rested(problem.past.moments[-1], other.pose, regained)), memory

    def judged(self, memory: LimbAgreement, agreement: Agreement) -> LimbAgreement:
        """The memory with the limbs that agree much less than they used to; asked in every frame with images."""
        now = self._fractions(memory.parts, agreement)
        usual = np.fmax(memory.mean, self.memory * memory.usual)
        slipped = tuple(int(i) for i in np.flatnonzero(now < self.drop * usual))
        mean = np.where(np.isnan(memory.mean), now, self.recent * memory.mean + (1.0 - self.recent) * now)
        return replace(memory, mean=np.where(np.isnan(now), memory.mean, mean), usual=usual, slipped=slipped)

    def found(self, memory: LimbAgreement, judge: Judge, start: Pose, others: Sequence[Pose]) -> tuple[Pose, list[int]]:
        """The pose with slipped limbs where the images clearly favour them, and those limbs.

        Args:
            memory: says which limbs have slipped.
            judge: of the images, against `start`.
            start: the body as it was fitted.
            others: more poses of which each limb may be taken over.
        """
        rng = np.random.default_rng((self.seed, memory.searches))
        pose, evidence, found, masks = start, 0.0, list[int](), limbs(judge.body)
        for i in memory.slipped:
            best, most = self._placed(judge, rng, masks[i], pose, evidence, others)
            if most > evidence + self.gain:
                pose, evidence = best, most
                found.append(i)
        return pose, found

    def improves(self, memory: LimbAgreement, judge: Judge, found: Sequence[int], before: Fit, after: Fit) -> bool:
        """Whether images favour a fit clearly, and the contours of the limbs found agree better than before it.

        They must favour where the limbs are now by itself: one that something hides would be favoured anywhere else.
        """
        parts = np.asarray(memory.parts[list(found)].any(axis=0), np.bool_)
        if judge.evidence(after.pose) <= self.gain or judge.evidence(after.pose, parts) <= self.gain:
            return False
        now, was = (np.nan_to_num(self._fractions(memory.parts, fit.agreement)) for fit in (after, before))
        return float((now - was)[list(found)].mean()) > self.better

    def _coordinates(self, body: Body, which: Sequence[int]) -> Bool:
        """(J,) coordinates of some limbs."""
        out, masks = np.zeros(body.dof - ROOT, np.bool_), limbs(body)
        for i in which:
            out |= masks[i][ROOT:]
        return out

    def _fractions(self, parts: Bool, agreement: Agreement) -> Float:
        """(L,) fraction of the points of each limb that agree; NaN where it shows too few."""
        points, agree = parts @ agreement.points, parts @ agreement.agreeing
        return np.where(points >= self.least_points, agree / np.maximum(points, 1.0), np.nan)

    def _placed(
        self, judge: Judge, rng: np.random.Generator, limb: Bool, best: Pose, most: float, others: Sequence[Pose]
    ) -> tuple[Pose, float]:
        """The pose that is judged best with one limb elsewhere, and its evidence."""
        steps = [np.where(limb, other.minus(best), 0.0) for other in others]
        steps.extend(anywhere(rng, limb, best, judge.body, self.draws))
        for sd in self.near:
            steps.extend(about(rng, limb, sd, self.draws))
            best, most = best_of(judge, best, most, steps)
            steps = []
        return best, most
