"""The first pose from nothing: hypotheses from what stands out, fitted by the tracker, mended limb by limb, compared.

What stands out places them, the contour fits them, and what stands out decides: a wrong pose that a contour has
settled on leaves much of the person uncovered.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from twistcap import se3
from twistcap.adjust.unaided.hull import places
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.limbs import limbs
from twistcap.estimate import Frame
from twistcap.ranges import Checked, Count, Range
from twistcap.search.beside import agreement
from twistcap.search.evidence import Evidence
from twistcap.search.limb import LimbRule, placed
from twistcap.search.placing import Hypothesis, Placing, PlacingRule, Stance, headings
from twistcap.search.stances import bundled, turned_round
from twistcap.track.align import FrameProblem
from twistcap.track.model import Model
from twistcap.track.step import posed_problem, predicted


@dataclass(frozen=True)
class UnaidedRule(Checked):
    """How widely a first pose is looked for, and when it is believed.

    Attributes:
        placing: how places, headings and draws are spread.
        reach: m about the middle of the cameras' sight.
        near: m, spacing of the places tried about each.
        fitted: hypotheses that the tracker fits.
        mended: of those, hypotheses that are mended limb by limb, in each round.
        limb: how a limb of theirs is looked for.
        margin: m about a hypothesis within which images are looked at.
        different: m between landmarks from which on two poses are different.
    """

    placing: PlacingRule = field(default_factory=lambda: PlacingRule(turns=16, places=3, modes=30, draws=12))
    reach: Annotated[float, Range(0.1, 50.0)] = 4.0
    near: float = 0.12
    fitted: Count = 30
    mended: tuple[Count, ...] = (6, 3)
    limb: LimbRule = field(default_factory=LimbRule)
    margin: Annotated[float, Range(0.0, 2.0)] = 0.3
    different: float = 0.15


@dataclass(frozen=True)
class Candidate:
    """A pose that may be the first one.

    Attributes:
        pose: as fitted.
        nats: for it, of what stands out.
        agreement: fraction of all contour points that agree with the images.
    """

    pose: Pose
    nats: float
    agreement: float

    @property
    def score(self) -> float:
        """Nats, of as much as the contour agrees with."""
        return self.nats * self.agreement


@dataclass(frozen=True)
class Instant:
    """The search in one frame.

    Attributes:
        rule: of the search.
        model: of the tracker.
        frame: with its images.
        evidence: what stands out in them.
    """

    rule: UnaidedRule
    model: Model
    frame: Frame
    evidence: Evidence

    def candidates(self, centre: Float, floor: float, known: Sequence[Stance] = ()) -> list[Candidate]:
        """Different poses, the best first; none where nothing stands out.

        Args:
            centre: (2,) m, about which places are looked for.
            floor: height of the floor, m.
            known: stances beside the bundled ones.
        """
        found = places(self.evidence, centre, self.rule.reach, floor, self.rule.placing.places)
        modes = self._placing.distinct(self._standing([*bundled(self.model.body), *known], found))
        best = self.different([self.fitted(h.pose) for h in modes[: self.rule.fitted]])
        for k, count in enumerate(self.rule.mended):
            more = [self.mended(c, [other.pose for other in best], k) for c in best[:count]]
            turned = [self.fitted(turned_round(self.model.body, c.pose)) for c in more[:2]]
            best = self.different([*best, *more, *turned])
        return best

    @property
    def _placing(self) -> Placing:
        return Placing(self.evidence, self.rule.placing)

    def _standing(self, stances: Sequence[Stance], found: Float) -> list[Hypothesis]:
        """The roughly best of all stances in all headings, each with its middle at some places (P, 3)."""
        placing, steps = self._placing, self.rule.near * np.array([-1.0, 0.0, 1.0])
        about = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
        best = list[tuple[float, Pose]]()
        for stance in stances:
            for heading in headings(self.rule.placing.turns):
                pose = stance.facing(heading)
                points = placing.points(pose)
                for place in found:
                    offsets = place - points.mean(axis=0) + about
                    values = placing.rough(points, offsets)
                    k = int(np.argmax(values))
                    root = se3.transform(pose.root[:3, :3], pose.root[:3, 3] + offsets[k])
                    best.append((float(values[k]), Pose(root, pose.q)))
        best.sort(key=lambda item: -item[0])
        return [placing.hypothesis(pose) for _, pose in best[: 4 * self.rule.placing.modes]]

    def fitted(self, pose: Pose) -> Candidate:
        """A pose as the tracker fits it."""
        fit = self._problem(pose).afresh(pose, self.rule.margin)
        return Candidate(fit.pose, self.evidence.of(fit.pose), agreement(fit))

    def measured(self, pose: Pose) -> Candidate:
        """A pose as it is."""
        return Candidate(pose, self.evidence.of(pose), agreement(self._problem(pose).measured(pose)))

    def mended(self, candidate: Candidate, others: Sequence[Pose], seed: int) -> Candidate:
        """A candidate with the limbs of others, or drawn anew, and fitted, where that has more evidence."""
        pose, nats, rng = candidate.pose, candidate.nats, np.random.default_rng(seed)
        for limb in limbs(self.model.body):
            pose, nats = placed(self.rule.limb, [other.q for other in others], self.evidence, limb, rng, pose, nats)
        h = Hypothesis(pose, nats)
        h = Placing(self.evidence, replace(self.rule.placing, seed=seed)).refined(h)
        other = self.fitted(h.pose)
        return max(candidate, other, key=lambda c: c.score)

    def different(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """The best first, without those that are nearly the same as a better one."""
        kept = list[Candidate]()
        for c in sorted(candidates, key=lambda c: -c.score):
            if all(self.apart(c.pose, other.pose) > self.rule.different for other in kept):
                kept.append(c)
        return kept

    def apart(self, one: Pose, other: Pose) -> float:
        """Greatest distance of a landmark, or of a segment's middle where there are none, between two poses, m."""
        a, b = Posed(self.model.body, one), Posed(self.model.body, other)
        points = (a.landmarks, b.landmarks) if len(a.landmarks) else (a.segment_middles, b.segment_middles)
        return float(np.linalg.norm(points[0] - points[1], axis=1).max())

    def _problem(self, pose: Pose) -> FrameProblem:
        prediction, state = predicted(self.model.start(pose, self.frame.time), self.frame, self.model)
        return posed_problem(state, self.frame, self.model, prediction)
