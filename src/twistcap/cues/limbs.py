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

ROOT = 6  # coordinates of the root, which come first
Tallies = Sequence[tuple[Float, Int]]


@dataclass(frozen=True)
class LimbRule:
    """When and how a limb is sought.

    Attributes:
        drop: share of its usual agreement with the images below which a limb is sought.
        memory: share that the usual agreement keeps from frame to frame where the present one is worse: what is sought
            without success is sought again, and what is seldom seen well is let alone after a while.
        recent: share that the mean agreement of late keeps from frame to frame; the usual one is no less.
        least_points: contour points of a limb, over all views, below which it is not judged.
        near: rad, standard deviations of the draws about the best, one round after the other.
        draws: poses of each limb in each round, and as many anywhere within its limits.
        gain: nats by which the images must favour each limb where it is found.
        better: share of its contour points that must come to agree beside, in the mean of the limbs found.
        margin: m about the body within which images are looked at.
        seed: of the draws, which are the same in every run.
    """

    drop: float = 0.8
    memory: float = 0.99
    recent: float = 0.8
    least_points: int = 12
    near: tuple[float, ...] = (0.5, 0.25, 0.125)
    draws: int = 64
    gain: float = 40.0
    better: float = 0.1
    margin: float = 0.6
    seed: int = 0

    def __post_init__(self) -> None:
        if self.draws < 1 or self.least_points < 1 or self.seed < 0 or not self.near:
            raise InputError("limbs: draws and least_points must be 1 or more, seed 0 or more, near name a deviation.")
        if not all(0.0 <= share <= 1.0 for share in (self.drop, self.memory, self.recent, self.better)):
            raise InputError("limbs: drop, memory, recent and better must be from 0 to 1.")
        if not all(0.0 <= value < np.inf for value in (*self.near, self.gain, self.margin)):
            raise InputError("limbs: near, gain and margin must be 0 or more, and finite.")


class LimbSearch:
    """Remembers how well the contour of each limb agrees with the images, and seeks those that agree no more."""

    def __init__(self, body: Body, rule: LimbRule) -> None:
        self.rule, self._body, self._limbs = rule, body, limbs(body)
        self._parts = [body.chain[:, limb[ROOT:]].any(axis=1) for limb in self._limbs]
        self._mean = np.full(len(self._limbs), np.nan)  # share of agreeing points of late; NaN where never judged
        self._usual = np.zeros(len(self._limbs))
        self._before: list[int] = []  # limbs that had slipped in the frame before
        self._slipped: list[int] = []
        self._searches = 0

    def slipped(self, tallies: Tallies) -> list[int]:
        """The limbs that agree much less than they used to. To be asked in every frame that shows the body.

        Args:
            tallies: agreeing points and all points of each part, by view (`part_tally`).
        """
        rule, shares = self.rule, self._shares(tallies)
        self._usual = np.fmax(self._mean, rule.memory * self._usual)
        self._before = self._slipped
        self._slipped = [int(i) for i in np.flatnonzero(shares < rule.drop * self._usual)]
        mean = np.where(np.isnan(self._mean), shares, rule.recent * self._mean + (1.0 - rule.recent) * shares)
        self._mean = np.where(np.isnan(shares), self._mean, mean)
        return self._slipped

    def sought(self, judge: Judge, start: Pose, others: Sequence[Pose]) -> tuple[Pose, list[int]]:
        """The pose with limbs that slipped where the images clearly favour them, and those limbs.

        Args:
            judge: of the images, relative to `start`.
            start: the body as it was fitted.
            others: more poses of which each limb may be taken over.
        """
        rng = np.random.default_rng((self.rule.seed, self._searches))
        self._searches += 1
        pose, evidence, found = start, 0.0, list[int]()
        for i in self._slipped:
            best, most = self._placed(judge, rng, self._limbs[i], pose, evidence, others)
            if most > evidence + self.rule.gain:
                pose, evidence = best, most
                found.append(i)
        return pose, found

    def borne_out(self, judge: Judge, found: Sequence[int], before: Fit, after: Fit) -> bool:
        """Whether images favour a fit clearly, and the contours of the limbs found agree better than before it."""
        if judge.evidence(after.result.x.pose) <= self.rule.gain:
            return False
        better = np.nan_to_num(self._shares(after.tallies)) - np.nan_to_num(self._shares(before.tallies))
        return float(better[list(found)].mean()) > self.rule.better

    def regained(self, found: Sequence[int]) -> Bool:
        """(J,) coordinates of limbs found that had slipped before: the way to where they are now was no motion."""
        out = np.zeros(self._body.dof - ROOT, np.bool_)
        for i in set(found) & set(self._before):
            out |= self._limbs[i][ROOT:]
        return out

    def _shares(self, tallies: Tallies) -> Float:
        """(L,) share of the points of each limb that agree; NaN where it shows too few."""
        good, seen = summed(tallies, len(self._body.segment_names))
        points = np.array([seen[parts].sum() for parts in self._parts])
        agree = np.array([good[parts].sum() for parts in self._parts])
        return np.where(points >= self.rule.least_points, agree / np.maximum(points, 1.0), np.nan)

    def _placed(
        self, judge: Judge, rng: np.random.Generator, limb: Bool, best: Pose, most: float, others: Sequence[Pose]
    ) -> tuple[Pose, float]:
        """The pose that is judged best with one limb elsewhere, and its evidence."""
        steps = [np.where(limb, other.minus(best), 0.0) for other in others]
        steps.extend(self._anywhere(rng, limb, best))
        for sd in self.rule.near:
            steps.extend(_outward(limb, sd * rng.standard_normal((self.rule.draws, int(limb.sum())))))
            best, most = judged_best(judge, best, most, steps)
            steps = []
        return best, most

    def _anywhere(self, rng: np.random.Generator, limb: Bool, pose: Pose) -> Float:
        """(draws, 6 + J) steps to places anywhere within the limits of a limb's joints, half a turn where none are."""
        joints = np.flatnonzero(limb) - ROOT
        limits, here = self._body.limits[joints], pose.q[joints, None]
        low, high = np.where(np.isfinite(limits), limits, here + np.array([-np.pi, np.pi])).T
        return _outward(limb, rng.uniform(low, high, (self.rule.draws, len(joints))) - pose.q[joints])


def _outward(limb: Bool, drawn: Float) -> Float:
    """(N, 6 + J) steps from those (N, K) of a limb's coordinates: of the whole limb, and of its outer ends alone.

    A forearm that folded over while the upper arm was right would seldom be found by turning both.
    """
    K = drawn.shape[1]
    steps = np.zeros((len(drawn), len(limb)))
    steps[:, limb] = np.where(np.arange(K) < (np.arange(len(drawn)) % K)[:, None], 0.0, drawn)
    return steps
