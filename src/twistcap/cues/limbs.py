"""Limbs that the images no longer bear out are sought elsewhere, in the same frame.

A contour pulls a limb from a hand's breadth away, and an arm in a somersault goes farther than that between two frames.
Its contour stops agreeing with the images at once, so poses of that limb alone are drawn, anywhere within its joints'
limits and about the best, and judged by the pixels that change hands (annealed search of one branch of the body:
Deutscher and Reid, IJCV 2005, doi:10.1023/B:VISI.0000043757.18370.9c).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twistcap._typing import Bool, Float, Int
from twistcap.body import Body, Pose
from twistcap.cues.reacquire import judged_best, limbs
from twistcap.cues.rivals import Judge
from twistcap.cues.sight import Fit
from twistcap.cues.support import summed
from twistcap.errors import InputError


@dataclass(frozen=True)
class LimbRule:
    """When and how a limb is sought.

    Attributes:
        drop: share of its usual agreement with the images below which a limb is sought.
        memory: share that the usual agreement keeps from frame to frame where the present one is worse: what is sought
            without success is sought again, and what is seldom seen well is let alone after a while.
        least_points: contour points of a limb, over all views, below which it is not judged.
        near: rad, standard deviations of the draws about the best, one round after the other.
        draws: poses of each limb in each round, and as many anywhere within its limits.
        gain: nats by which the images must favour what is found.
        better: share of a limb's contour points that must come to agree beside.
        margin: m about the body within which it is sought.
        seed: of the draws, which are the same in every run.
    """

    drop: float = 0.8
    memory: float = 0.99
    least_points: int = 12
    near: tuple[float, ...] = (0.5, 0.25, 0.125)
    draws: int = 64
    gain: float = 40.0
    better: float = 0.1
    margin: float = 0.6
    seed: int = 0

    def __post_init__(self) -> None:
        if self.draws < 1 or not 0.0 <= self.memory <= 1.0:
            raise InputError("limbs: draws must be 1 or more, and memory from 0 to 1.")


class LimbSearch:
    """Remembers how well the contour of each limb agrees with the images, and seeks those that agree no more."""

    def __init__(self, body: Body, rule: LimbRule) -> None:
        self._body, self._rule = body, rule
        self._limbs = limbs(body)
        self._parts = [body.chain[:, limb[6:]].any(axis=1) for limb in self._limbs]
        self._usual = np.zeros(len(body.segment_names))
        self._searches = 0
        self.margin = rule.margin

    def slipped(self, tallies: Sequence[tuple[Float, Int]], support: Float) -> list[int]:
        """The limbs that agree much less than they used to. To be asked in every frame.

        Args:
            tallies: agreeing points and all points of each part, by view (`part_tally`).
            support: (S,) running share of agreeing points of each part, before this frame.
        """
        rule = self._rule
        self._usual = np.maximum(support, rule.memory * self._usual)
        good, seen = summed(tallies, len(support))
        used = [float(self._usual[parts] @ seen[parts]) for parts in self._parts]
        now = [(float(good[parts].sum()), float(seen[parts].sum())) for parts in self._parts]
        return [
            i
            for i, (usual, (agree, points)) in enumerate(zip(used, now, strict=True))
            if points >= rule.least_points and agree < rule.drop * usual
        ]

    def sought(self, judge: Judge, start: Pose, others: Sequence[Pose], slipped: Sequence[int]) -> Pose | None:
        """The pose that the images clearly favour over `start`, with limbs elsewhere; None where there is none.

        Args:
            judge: of the images, relative to `start`.
            start: the body as it was fitted.
            others: more poses of which each limb may be taken over.
            slipped: limbs that are sought, one after the other.
        """
        rng = np.random.default_rng((self._rule.seed, self._searches))
        self._searches += 1
        best, most = start, 0.0
        for limb in (self._limbs[i] for i in slipped):
            steps = [np.where(limb, other.minus(best), 0.0) for other in others]
            steps.extend(self._anywhere(rng, limb, best))
            for sd in self._rule.near:
                steps.extend(self._outward(limb, sd * rng.standard_normal((self._rule.draws, int(limb.sum())))))
                best, most = judged_best(judge, best, most, steps)
                steps = []
        return best if most > self._rule.gain else None

    def borne_out(self, judge: Judge, slipped: Sequence[int], before: Fit, after: Fit) -> bool:
        """Whether images favour a fit clearly, and the contours of limbs that slipped agree better than before it."""
        if judge.evidence(after.result.pose) <= self._rule.gain:
            return False
        better = self._shares(slipped, after.tallies) - self._shares(slipped, before.tallies)
        return better > self._rule.better * len(slipped)

    def _shares(self, slipped: Sequence[int], tallies: Sequence[tuple[Float, Int]]) -> float:
        """Sum over limbs of their shares of agreeing points."""
        good, seen = summed(tallies, len(self._usual))
        return sum(good[self._parts[i]].sum() / max(seen[self._parts[i]].sum(), 1.0) for i in slipped)

    def _anywhere(self, rng: np.random.Generator, limb: Bool, pose: Pose) -> Float:
        """(draws, 6 + J) steps to places anywhere within the limits of a limb's joints."""
        joints = np.flatnonzero(limb) - 6
        low, high = np.clip(self._body.limits[joints], -np.pi, np.pi).T
        drawn = rng.uniform(low, high, (self._rule.draws, len(joints)))
        return self._outward(limb, drawn - pose.q[joints])

    def _outward(self, limb: Bool, drawn: Float) -> Float:
        """(N, 6 + J) steps from those (N, K) of a limb's coordinates: of the whole limb, and of its outer ends alone.

        A forearm that folded over while the upper arm was right would seldom be found by turning both.
        """
        K = drawn.shape[1]
        drawn = np.where(np.arange(K) < (np.arange(len(drawn)) % K)[:, None], 0.0, drawn)
        steps = np.zeros((len(drawn), len(limb)))
        steps[:, limb] = drawn
        return steps
