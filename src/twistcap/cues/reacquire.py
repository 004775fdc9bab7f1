"""Finding the body again after a gap: limb by limb, from the trunk outward, the images judge where it might be.

A contour pulls a limb from a hand's breadth away. Without images a limb strays farther, by as much as the prediction's
covariance says: poses are drawn from that covariance, one branch of the body after the other, and then more narrowly
about the best (partitioned sampling, MacCormick and Isard, ECCV 2000; annealing, Deutscher and Reid, IJCV 2005,
doi:10.1023/B:VISI.0000043757.18370.9c).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap._typing import Bool, Float
from twistcap.body import Body, Pose
from twistcap.cues.rivals import Judge
from twistcap.errors import InputError


@dataclass(frozen=True)
class ReacquireRule:
    """When and how the body is sought.

    Attributes:
        after: s without images from which on it is.
        passes: over all branches; of each, the shares of the standard deviation with which poses are drawn, one round
            after the other.
        draws: poses in each round of each branch.
        gain: nats by which the images must favour what is found; else the body is where it was expected.
        margin: m about the expected body within which it is sought.
        widest: rad, most by which one coordinate is thought to have strayed (standard deviation).
        seed: of the draws, which are the same in every run.
    """

    after: float = 0.1
    passes: tuple[tuple[float, ...], ...] = ((1.0, 0.5, 0.25), (0.5, 0.25))
    draws: int = 40
    gain: float = 40.0
    margin: float = 0.5
    widest: float = 0.6
    seed: int = 0

    def __post_init__(self) -> None:
        if self.draws < 1 or not self.passes or not all(self.passes):
            raise InputError("reacquire: draws must be 1 or more, and passes must name at least one layer each.")

    def sought(self, judge: Judge, start: Pose, covariance: Float, others: Sequence[Pose] = ()) -> Pose:
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
                    best, most = judged_best(judge, best, most, steps)
                    steps = []
        return best if most > self.gain else start

    def _drawn(self, rng: np.random.Generator, covariance: Float, branch: Bool) -> Float:
        """(draws, 6 + J) steps of one branch alone."""
        values, vectors = np.linalg.eigh(covariance[np.ix_(branch, branch)])
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        steps = np.zeros((self.draws, len(branch)))
        steps[:, branch] = rng.standard_normal((self.draws, len(root))) @ root.T
        return steps


def judged_best(judge: Judge, best: Pose, most: float, steps: Sequence[Float]) -> tuple[Pose, float]:
    """The best of a pose of evidence `most` and of those that steps (6 + J,) lead to from it, and its evidence."""
    poses = [best.retract(step).within(judge.body.limits) for step in steps]
    evidence = [judge.evidence(pose) for pose in poses]
    k = int(np.argmax(evidence))
    return (poses[k], evidence[k]) if evidence[k] > most else (best, most)


def branches(body: Body) -> list[Bool]:
    """Masks (6 + J,) of coordinates that carry the same ends of the body: the root's, then those of most ends first."""
    root = np.arange(body.dof) < 6
    return [root, *(mask for _, mask in _by_ends(body))]


def limbs(body: Body) -> list[Bool]:
    """Masks (6 + J,) of the coordinates of each limb: those that carry one and the same end of the body alone.

    A hand whose fingers are jointed has many ends: then the fingers are the limbs, and the arm is none.
    """
    return [mask for ends, mask in _by_ends(body) if ends == 1]


def _by_ends(body: Body) -> list[tuple[int, Bool]]:
    """How many ends of the body each of its branches carries, and its mask (6 + J,); those of most ends first."""
    carries = body.chain
    ends = [s for s in range(len(carries)) if not any(_beyond(carries[t], carries[s]) for t in range(len(carries)))]
    groups: dict[bytes, list[int]] = {}
    for j, carried in enumerate(carries[ends].T):
        groups.setdefault(carried.tobytes(), []).append(j)
    return [(sum(key), np.isin(np.arange(body.dof) - 6, groups[key])) for key in sorted(groups, key=lambda k: -sum(k))]


def _narrowed(covariance: Float, widest: float) -> Float:
    """The covariance (6 + J, 6 + J) with joints that stray less than `widest`, rad."""
    shares = np.ones(len(covariance))
    sd = np.sqrt(np.diag(covariance)[6:])
    shares[6:] = np.minimum(1.0, widest / np.maximum(sd, 1e-12))
    return covariance * np.outer(shares, shares)


def _beyond(one: Bool, other: Bool) -> bool:
    """Whether a segment hangs on another: all that moves the other moves it, and more."""
    return bool(np.all(other <= one) and np.any(one & ~other))
