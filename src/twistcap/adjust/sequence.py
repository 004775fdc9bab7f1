"""What problems of a whole sequence share: what is known of the motion without images, and how contours err."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from twistcap.adjust.refine.problem import accelerations
from twistcap.arrays import Float
from twistcap.body import Body, Posed
from twistcap.predict import MotionNoise
from twistcap.predict.inertia import INFLATION
from twistcap.priors.standing import RestPose
from twistcap.solve import Arrow
from twistcap.solve.blocks import PoseTrack
from twistcap.terms import LimitTerm, PointTerm, RestTerm


@dataclass(frozen=True)
class SmoothMotion:
    """Limits and a weak rest pose of each pose of a body, and small accelerations."""

    body: Body

    @property
    def priors(self) -> tuple[LimitTerm, RestTerm]:
        """Of each pose."""
        return LimitTerm(), RestTerm(float(np.deg2rad(RestPose().sigma_deg)))

    def energies(self, track: PoseTrack) -> dict[str, float]:
        """By term."""
        posed = [Posed(self.body, pose) for pose in track.poses]
        standing = {prior.name: sum(prior.energy(p) for p in posed) for prior in self.priors}
        return {**standing, "motion": accelerations(track.poses, track.times.tolist(), MotionNoise())}

    def add_to(self, arrow: Arrow, track: PoseTrack) -> None:
        """Add the quadratics of the poses' steps."""
        for t, pose in enumerate(track.poses):
            for prior in self.priors:
                quadratic = prior.linearize(Posed(self.body, pose))
                arrow.value += quadratic.value
                arrow.add_pose(t, quadratic.gradient, quadratic.hessian)
        arrow.value += accelerations(track.poses, track.times.tolist(), MotionNoise(), arrow)


def design_effect(sights: Iterable[tuple[PointTerm, Posed]]) -> float:
    """Factor by which the contours' information is overcounted, 1 or more: points of one part err together.

    See `twistcap.adjust.refine.measure.design_effect`; each image is by itself here.
    """
    squares, information = 0.0, 0.0
    for term, posed in sights:
        _, points, rows = term.rows(posed)
        group = np.resize(points.part, len(rows.residual)) * 8 + (rows.gradient > 0.0) @ [1, 2, 4]
        squares += float(np.sum(np.bincount(group, rows.weight * rows.residual) ** 2))
        information += float(rows.weight.sum())
    return max(1.0, squares / max(information, 1e-12) / INFLATION**2)


def claimed_sigma(arrow: Arrow, effect: float) -> Float:
    """(K,) standard deviations of the shared parameters, inflated as those of poses are."""
    return INFLATION * np.sqrt(effect * np.diagonal(arrow.marginals().shared))
