"""Finding the body again after a gap: limb by limb, from the trunk outward, the images judge where it might be.

A contour pulls a limb from a hand's breadth away. Without images a limb strays farther, by as much as the prediction's
covariance says: poses are drawn from that covariance, one branch of the body after the other, and then more narrowly
about the best (partitioned sampling, MacCormick and Isard, ECCV 2000; annealing, Deutscher and Reid, IJCV 2005,
doi:10.1023/B:VISI.0000043757.18370.9c).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from twistcap.arrays import Bool, Float
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import branches
from twistcap.camera import Rig
from twistcap.cues.observation import Fit
from twistcap.errors import InputError
from twistcap.predict.history import Past
from twistcap.ranges import Checked, Count
from twistcap.search import Problem, Revision
from twistcap.search.judge import Judge, best_of
from twistcap.stages import stage


@dataclass(frozen=True)
class AfterGap(Checked):
    """When and how the body is searched for after frames without images.

    Attributes:
        after: s without images from which on it is.
        passes: over all branches; of each, the factors on the standard deviation with which poses are drawn, one round
            after the other.
        draws: poses in each round of each branch.
        gain: nats by which the images must favour what is found; else the body is where it was expected.
        reach: m about the expected body within which it is looked for.
        widest: rad, most by which one coordinate is thought to have moved away (standard deviation).
        seed: of the draws, which are the same in every run.
    """

    after: float = 0.1
    passes: tuple[tuple[float, ...], ...] = ((1.0, 0.5, 0.25), (0.5, 0.25))
    draws: Count = 40
    gain: float = 40.0
    reach: float = 0.5
    widest: float = 0.6
    seed: int = 0
    name: str = field(default="after a gap", init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.passes or not all(self.passes):
            raise InputError("search after a gap: passes must name one layer each.")

    def start(self, body: Body, rig: Rig) -> None:
        """It remembers nothing."""

    def wanted_margin(self, past: Past, time: float) -> float | None:
        """As far as the search reaches, after a gap."""
        return self.reach if self._due(past, time) else None

    def begin(self, memory: None, problem: Problem) -> Pose | None:
        """Where the images show the body."""
        if not self._due(problem.past, problem.frame.time) or not problem.views:
            return None
        seen = [moment.pose for moment in problem.past.seen][-1:]
        with stage("search"):
            judge = problem.judge(Posed(problem.body, problem.start))
            return self.found(judge, problem.start, problem.spread, seen)

    def revise(self, memory: None, problem: Problem, fit: Fit) -> tuple[Revision | None, None]:
        """Nothing after the fit."""
        return None, None

    def _due(self, past: Past, time: float) -> bool:
        """Whether images have been missing for longer than they do at the recording's own rate."""
        usual = past.moments[-1].time - past.moments[-2].time if past.moving else 0.0
        return past.started and time - past.seen_time > max(self.after, 1.5 * usual)

    def found(self, judge: Judge, start: Pose, covariance: Float, others: Sequence[Pose] = ()) -> Pose:
        """The pose that the images favour.

        Args:
            judge: of the images, relative to one pose.
            start: from which the search begins.
            covariance: (6 + J, 6 + J) of the step from it to the true pose.
            others: more poses of which each branch may be taken over.
        """
        rng, covariance = np.random.default_rng(self.seed), _narrowed(covariance, self.widest)
        best, most = start, 0.0
        for layers in self.passes:
            for branch in branches(judge.body):
                steps = [np.where(branch, other.minus(best), 0.0) for other in others]
                for layer in layers:
                    steps.extend(layer * self._drawn(rng, covariance, branch))
                    best, most = best_of(judge, best, most, steps)
                    steps = []
        return best if most > self.gain else start

    def _drawn(self, rng: np.random.Generator, covariance: Float, branch: Bool) -> Float:
        """(draws, 6 + J) steps of one branch alone."""
        values, vectors = np.linalg.eigh(covariance[np.ix_(branch, branch)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        steps = np.zeros((self.draws, len(branch)))
        steps[:, branch] = rng.standard_normal((self.draws, len(root))) @ root.T
        return steps


def _narrowed(covariance: Float, widest: float) -> Float:
    """The covariance (6 + J, 6 + J) with joints that stray less than `widest`, rad."""
    shares = np.ones(len(covariance))
    sd = np.sqrt(np.diag(covariance)[6:])
    shares[6:] = np.minimum(1.0, widest / np.maximum(sd, 1e-12))
    return covariance * np.outer(shares, shares)
