"""Limbs of the two sides, each put where the other one is.

Legs that have been taken for each other cannot be set right one by one: each covers what the other one should.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twistcap.arrays import Bool, Float, Int
from twistcap.body import Body, Pose, Posed
from twistcap.body.limbs import limb_parts, limbs
from twistcap.body.model import partners
from twistcap.solve import PoseProblem, minimise
from twistcap.terms import GaussianTerm, LimitTerm, Quadratic

_STEPS = 12
_SIGMA = 0.05  # m; a segment so far beside its place costs as much as a joint that turns by 1 rad
_BEYOND = 0.1  # rad beyond a joint's limit that cost as much; in the end joints are put back to their limits
_REACHED = 0.2  # m from its place within which each segment of both limbs must come


def exchanged(body: Body, pose: Pose) -> list[Pose]:
    """The pose with each pair of limbs exchanged that can be, segment for segment."""
    return [other for both in _pairs(body) if (other := _exchanged(body, pose, both)) is not None]


def _pairs(body: Body) -> list[Bool]:
    """Masks (6 + J,) of the coordinates of each limb and of the other side's."""
    other = np.append(np.arange(6), 6 + np.array(partners(body.coordinate_names), int))
    one_of_each = (limb for limb in limbs(body) if np.flatnonzero(limb)[0] < np.flatnonzero(limb[other])[0])
    return [limb | limb[other] for limb in one_of_each]


def _exchanged(body: Body, pose: Pose, both: Bool) -> Pose | None:
    """With a pair of limbs exchanged, by some steps; None where one of them does not come there."""
    posed, parts = Posed(body, pose), np.flatnonzero(limb_parts(body, both)).astype(np.int32)
    there = MiddlesTerm(parts, posed.segment_middles[np.array(partners(body.segment_names))[parts]], _SIGMA)
    near = GaussianTerm(pose, np.eye(body.dof))
    problem = PoseProblem([there, near, LimitTerm(_BEYOND)], fixed=~both)
    other = minimise(problem, posed, _STEPS).x.pose.within(body.limits)
    return other if there.away(Posed(body, other)).max() < _REACHED else None


@dataclass(frozen=True)
class MiddlesTerm:
    """Gaussians of `sigma` m about where the middles (M, 3) of M segments shall be."""

    segments: Int
    wanted: Float
    sigma: float
    name: str = "middles"

    def away(self, posed: Posed) -> Float:
        """(M,) m from there."""
        return np.linalg.norm(posed.segment_middles[self.segments] - self.wanted, axis=1)

    def energy(self, posed: Posed) -> float:
        return 0.5 * float(np.sum(self.away(posed) ** 2)) / self.sigma**2

    def linearize(self, posed: Posed) -> Quadratic:
        ones, middles = np.ones((len(self.segments), 1)), posed.body.segment_middles[self.segments]
        J = posed.point_jacobian(self.segments[:, None], ones, middles).reshape(-1, posed.body.dof) / self.sigma
        residual = (posed.segment_middles[self.segments] - self.wanted).ravel() / self.sigma
        return Quadratic(self.energy(posed), J.T @ residual, J.T @ J)
