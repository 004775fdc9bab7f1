"""The whole body is looked for: where it may stand, in what stance, and then limb by limb until that gains nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np

from twistcap import se3
from twistcap.arrays import Bool, Float
from twistcap.body import Pose
from twistcap.body.limbs import limbs
from twistcap.camera import Camera
from twistcap.camera.projection import projected
from twistcap.predict.history import Moment, Past
from twistcap.ranges import Checked, Count, Range, Share
from twistcap.search import Problem
from twistcap.search.evidence import Evidence
from twistcap.search.exchange import exchanged
from twistcap.search.limb import LimbRule, placed
from twistcap.search.placing import Hypothesis, Placing, PlacingRule, away
from twistcap.search.recollection import Covered, Recollection
from twistcap.search.stances import bundled, lowest, turned_round
from twistcap.threads import in_parallel


@dataclass(frozen=True)
class BodyRule(Checked):
    """How the whole body is looked for. Evidence is a ratio to what is usual for this body.

    Attributes:
        accepted: evidence from which on a found body is believed.
        better: by how much its evidence must exceed that of another place, as a fraction of what is usual.
        in_picture: fraction of the body's surface in a picture, below which that camera does not show it.
        worth: evidence from which on a hypothesis is fitted, and from which on the best one is looked at more closely.
        reach, speed, farthest: m, m/s and m: how far away it is looked for, with the time since it was seen.
        turned, turning: rad and rad/s: how far it may have turned, with the time; one rad farther costs `better`.
        margin: m about a hypothesis within which images are looked at.
        limbed: hypotheses whose limbs are looked for one after the other; they may be as they never were before.
        rounds, little: of draws about the best one, and of looking for its limbs, as long as a round gains more than
            this fraction of what is usual.
        close: how much less evidence than the best one a body with exchanged limbs, or one that faces the other way,
            may have, and be tried.
        placing: of the hypotheses.
    """

    accepted: float = 0.8
    better: float = 0.1
    in_picture: Share = 0.4
    worth: float = 0.35
    reach: float = 1.0
    speed: float = 2.5
    farthest: Annotated[float, Range(0.0, 50.0)] = 4.0
    turned: float = 0.5
    turning: float = 3.0
    margin: float = 0.3
    limbed: Count = 2
    rounds: Count = 3
    little: Share = 0.005
    close: Share = 0.1
    placing: PlacingRule = field(default_factory=PlacingRule)

    def too_fast(self, pose: Pose, last: Moment, time: float) -> float:
        """Fraction of the usual evidence that a pose pays for having turned faster than people do."""
        turn = float(np.linalg.norm(se3.log_rotation(pose.root[:3, :3] @ last.pose.root[:3, :3].T)))
        return self.better * float(np.clip(turn - self.turned - self.turning * (time - last.time), 0.0, 1.0))


@dataclass(frozen=True)
class BodySearch:
    """A look for the body in one frame.

    Attributes:
        rule, limb: how it, and each of its limbs, is looked for.
        known: what the recording has taught.
        problem, evidence: of the frame.
        surely: when and where the body was last without doubt; None for where it was seen last.
        proposed: more poses to judge.
    """

    rule: BodyRule
    limb: LimbRule
    known: Recollection
    problem: Problem
    evidence: Evidence
    surely: Moment | None = None
    proposed: Sequence[Pose] = ()

    def found(self, least: float | None = None) -> Pose | None:
        """The pose that the images show; None where they show no body clearly enough, or none with as much evidence as
        a fit has that it is to replace.
        """
        fitted = sorted(in_parallel(self._fitted, self._worth()), key=self._standing, reverse=True)
        limbed = [*fitted[: self.rule.limbed], *self._placing.apart(fitted)[1:2]]
        fitted += in_parallel(lambda h: self._fitted(self._with_limbs_placed(h)), limbed)
        first = self._believed(fitted)
        if self._ratio(first) < self.rule.worth:
            return None
        starts = [first, *self._beside(first, fitted)] if least is not None else [first]
        best = max(in_parallel(self._settled, starts), key=self._rank)
        body = self.problem.body
        others = [*exchanged(body, best.pose), turned_round(body, best.pose)]
        for other in in_parallel(self._fitted_twice, others):
            if other.nats > best.nats - self.rule.close * self._usual:
                best = max(best, self._settled(other), key=self._rank)
        return best.pose if self._ratio(best) >= self.rule.accepted and (least is None or best.nats >= least) else None

    @cached_property
    def _placing(self) -> Placing:
        rule = self.rule.placing
        return Placing(self.evidence, replace(rule, seed=rule.seed + self.problem.frame.index))

    @cached_property
    def _last(self) -> Moment:
        return last_seen(self.problem.past)

    @cached_property
    def _usual(self) -> float:
        return float(self.known.nats_in(self.evidence).sum())

    @cached_property
    def _witnesses(self) -> int:
        """How many cameras must show the body: two, if as many of those that have a picture now would show it where it
        was last without doubt. One alone hardly tells how far away it is.
        """
        return min(2, self._showing((self.surely or self._last).pose))

    def _showing(self, pose: Pose) -> int:
        """Cameras in whose pictures enough of the body is."""
        points = self._placing.points(pose)
        return sum(float(_in_picture(v.camera, points).mean()) >= self.rule.in_picture for v in self.evidence.views)

    def _worth(self) -> list[Hypothesis]:
        """What is worth a fit; and where the body is expected, and was seen last."""
        near = [self._placing.hypothesis(pose) for pose in (self.problem.start, self._last.pose)]
        return [*(h for h in self._modes() if self._ratio(h) >= self.rule.worth), *near]

    def _modes(self) -> list[Hypothesis]:
        """Where the body was, is expected or proposed, and where stances fit the pictures: those that it has shown,
        their mirror images, and those that bodies take.
        """
        rule, problem, placing, last = self.rule, self.problem, self._placing, self.surely or self._last
        shown, floor = self.known.stances, lowest(problem.body, self.known.stances)
        raised = (replace(stance, height=stance.height + floor) for stance in bundled(problem.body))
        stances = [*shown, *(stance.mirrored(problem.body) for stance in shown)]
        reach = min(rule.reach + rule.speed * (problem.frame.time - last.time), rule.farthest)
        places = placing.places(stances[:: max(1, len(stances) // 3)], last.pose.root[:2, 3], reach)
        poses = (problem.start, problem.past.last, last.pose, *self.proposed)
        return placing.distinct([*placing.standing([*stances, *raised], places), *map(placing.hypothesis, poses)])

    def _believed(self, hypotheses: Sequence[Hypothesis]) -> Hypothesis:
        """The best; if it is elsewhere than where the body was seen, the best of those nearer that are as clear."""
        best, seen = max(hypotheses, key=self._rank), (self.surely or self._last).pose
        clear = max(self.rule.accepted, self._ratio(best) - self.rule.better)
        nearer = [h for h in self._placing.nearer(hypotheses, best, seen) if self._ratio(h) >= clear]
        return max(nearer or [best], key=self._standing)

    def _beside(self, best: Hypothesis, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The best other pose of a body that stands there. One that is fitted already would hide it."""
        there = (h for h in self._placing.distinct(hypotheses) if away(h.pose, best.pose) <= self.rule.placing.apart)
        return [h for h in there if h is not best][:1]

    def _settled(self, h: Hypothesis) -> Hypothesis:
        """The best that draws about it and its limbs elsewhere lead to."""
        for k in range(self.rule.rounds):
            before = h.nats
            h = self._better(h, self._placing.refined(h, k))
            if k < self.rule.rounds - 1:
                h = self._better(h, self._with_limbs_placed(h, k))
            if h.nats <= before + self.rule.little * self._usual:
                break
        return h

    def _better(self, h: Hypothesis, moved: Hypothesis) -> Hypothesis:
        """The better of a hypothesis and of what moving it leads to."""
        return h if moved.nats <= h.nats else max(h, self._fitted(moved), key=self._standing)

    def _fitted(self, h: Hypothesis) -> Hypothesis:
        pose = self.problem.afresh(h.pose, self.rule.margin).pose
        value = self.evidence.of(pose)
        return Hypothesis(pose, value) if value > h.nats else h

    def _fitted_twice(self, pose: Pose) -> Hypothesis:
        """As a pose needs that is up to 0.2 m off."""
        once = self._fitted(put := self._placing.hypothesis(pose))
        return once if once is put else self._fitted(once)

    def _with_limbs_placed(self, h: Hypothesis, turn: int = 0) -> Hypothesis:
        """With each limb where the evidence is greatest; other draws in each turn."""
        rng, pose, nats = np.random.default_rng((self._placing.rule.seed, turn)), h.pose, h.nats
        for limb in limbs(self.problem.body):
            pose, nats = placed(self.limb, self.known.angles, self.evidence, limb, rng, pose, nats)
        return Hypothesis(pose, nats)

    def _standing(self, h: Hypothesis) -> float:
        """Its evidence, less what its turn costs."""
        return h.nats - self._usual * self.rule.too_fast(h.pose, self._last, self.problem.frame.time)

    def _rank(self, h: Hypothesis) -> tuple[bool, float]:
        """What can be believed comes first, then what stands better."""
        return self._ratio(h) >= self.rule.accepted, self._standing(h)

    def _ratio(self, h: Hypothesis) -> float:
        """Evidence over what is usual for a body that is seen like that; none where too few cameras show it."""
        if self._showing(h.pose) < self._witnesses:
            return 0.0
        each = np.zeros((2, *self.known.nats.shape))
        each[:, [view.index for view in self.evidence.views]] = self.evidence.by_part(h.pose)
        return float(np.nan_to_num(self.known.ratio(Covered(each[0], each[1]))))


def _in_picture(camera: Camera, points: Float) -> Bool:
    """(N,) which points (N, 3) lie in a camera's picture."""
    pixels, nearness = projected(camera, points)
    return np.asarray((nearness > 0.0) & np.all((pixels >= 0.0) & (pixels < camera.size), axis=1), np.bool_)


def last_seen(past: Past) -> Moment:
    """When and where images showed the body last."""
    return replace((past.seen or past.moments)[-1], time=past.seen_time)
