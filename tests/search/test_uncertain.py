"""Uncertain limbs: the covariance that proposes hypotheses, and the two frames that must prefer one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twistcap.body import Body, Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.camera import Rig
from twistcap.cues.observation import Fit, Visibility
from twistcap.predict.history import Moment, MotionNoise, MotionSpread, Past
from twistcap.search.uncertain import UncertainLimbs, Uncertainty, segment_deviations, uncertain_limbs

BODY = humanoid("full")
NO_RIG = Rig(())


def random_covariance(seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(BODY.dof, BODY.dof)) * 0.02
    return A @ A.T


def bent(seed: int) -> Posed:
    q = np.random.default_rng(seed).uniform(-0.4, 0.4, len(BODY.coordinate_names))
    return Posed(BODY, Pose(np.eye(4), q))


def test_a_segments_doubt_is_the_spread_of_its_middle() -> None:
    posed, covariance = bent(1), random_covariance(2)
    sd, directions = segment_deviations(posed, covariance)
    small = 1e-3
    steps = np.random.default_rng(3).multivariate_normal(np.zeros(BODY.dof), small**2 * covariance, size=2000)
    middles = np.array([Posed(BODY, posed.pose.retract(step)).segment_middles for step in steps])
    for s in range(len(BODY.segment_names)):
        widest = np.linalg.eigvalsh(np.cov(middles[:, s].T))[-1]
        assert np.sqrt(widest) == pytest.approx(small * sd[s], rel=0.1)
        moved = Posed(BODY, posed.pose.retract(1e-6 * directions[s])).segment_middles[s] - posed.segment_middles[s]
        assert np.linalg.norm(moved) == pytest.approx(1e-6 * sd[s], rel=1e-3)


def test_limbs_in_doubt_are_named_once() -> None:
    doubt = np.full(len(BODY.segment_names), 0.001)
    for name, value in (("radius_r", 0.08), ("ulna_r", 0.05), ("humerus_r", 0.04), ("radius_l", 0.06)):
        doubt[BODY.segment(name)] = value
    names = [BODY.segment_names[s] for s in uncertain_limbs(BODY, doubt, 0.03)]
    assert names == ["radius_r", "radius_l"]


@dataclass(frozen=True)
class Scripted:
    """A frame problem whose judge says what the test wants, and whose fits stay where they start."""

    covariance_: np.ndarray
    evidence: float = 0.0
    start: Pose = field(default_factory=lambda: Pose.rest(BODY))
    body: Body = BODY
    views: Mapping[int, Any] = field(default_factory=lambda: {0: None})
    trusted: bool = True

    @property
    def past(self) -> Past:
        return Past((Moment(0.0, self.start),), 0.0, True, MotionSpread.usual(MotionNoise()))

    def judge(self, posed: Posed, margin: float | None = None) -> Any:
        return SimpleNamespace(body=BODY, evidence=lambda pose: self.evidence)

    def align(self, pose: Pose, crop: bool = False) -> Fit:
        return fit_at(pose)

    def measured(self, pose: Pose) -> Fit:
        return fit_at(pose)

    def covariance(self, fit: Fit) -> np.ndarray:
        return self.covariance_

    def in_sight(self, fit: Fit) -> np.ndarray:
        return np.ones(len(BODY.segment_names))


def fit_at(pose: Pose) -> Fit:
    return Fit.started(Posed(BODY, pose), Visibility.full(len(BODY.segment_names)))


UNSURE, SURE = np.eye(BODY.dof) * 0.2**2, np.eye(BODY.dof) * 1e-4**2


def test_uncertainty_outlives_a_sudden_certainty() -> None:
    search, fit = UncertainLimbs(every=1, memory=0.9), fit_at(bent(4).pose)
    first, memory = search.hypotheses(search.start(BODY, NO_RIG), Scripted(UNSURE), fit)
    assert first
    later, _ = search.hypotheses(memory, Scripted(SURE), fit)
    assert later and not search.hypotheses(search.start(BODY, NO_RIG), Scripted(SURE), fit)[0]
    reach = np.linalg.norm(Posed(BODY, later[0]).segment_middles - fit.posed.segment_middles, axis=1).max()
    assert reach > 0.03  # as far as what is remembered, not as what is claimed now


def test_a_hypothesis_takes_over_when_two_frames_in_turn_prefer_it() -> None:
    search, fit, clear = UncertainLimbs(every=1), fit_at(bent(4).pose), Scripted(UNSURE, evidence=41.0)
    revision, memory = search.revise(search.start(BODY, NO_RIG), clear, fit)
    assert revision is None and memory.preferred is not None
    later = fit_at(bent(5).pose)
    (again,), _ = search.hypotheses(memory, clear, later)  # as far off the later pose as it was off the first
    np.testing.assert_allclose(again.minus(later.pose), memory.preferred, atol=1e-9)
    revision, memory = search.revise(memory, clear, later)
    assert revision is not None and revision.jumped and memory.preferred is None
    np.testing.assert_allclose(revision.fit.pose.q, again.q)


def test_what_is_not_clear_or_what_the_second_frame_refuses_changes_nothing() -> None:
    search, fit = UncertainLimbs(every=1), fit_at(bent(4).pose)
    start = search.start(BODY, NO_RIG)
    revision, memory = search.revise(start, Scripted(UNSURE, evidence=search.margin), fit)
    assert revision is None and memory.preferred is None
    _, preferred = search.revise(start, Scripted(UNSURE, evidence=41.0), fit)
    revision, refused = search.revise(preferred, Scripted(UNSURE, evidence=0.0), fit)
    assert revision is None and refused.preferred is None  # it must win twice anew


def test_limbs_are_tried_in_turn_every_few_frames() -> None:
    search, fit = UncertainLimbs(every=3), fit_at(bent(4).pose)
    memory: Uncertainty = search.start(BODY, NO_RIG)
    tried = []
    for _ in range(6):
        poses, memory = search.hypotheses(memory, Scripted(UNSURE), fit)
        tried.append(len(poses))
    assert tried == [0, 0, 8, 0, 0, 8]
