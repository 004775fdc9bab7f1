"""Limbs of the two sides, each put where the other one is."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from support.faulty_walk import tracked_walk, walk
from support.finite_differences import check_jacobian, numeric_jacobian
from twistcap import se3
from twistcap.arrays import Float
from twistcap.body import Pose, Posed
from twistcap.body.humanoid import humanoid
from twistcap.body.model import partners
from twistcap.predict import Prediction
from twistcap.search import body as whole_body
from twistcap.search.body import BodyRule, BodySearch
from twistcap.search.exchange import MiddlesTerm, exchanged
from twistcap.search.limb import LimbRule
from twistcap.search.placing import Hypothesis, PlacingRule
from twistcap.search.stances import turned_round
from twistcap.track.step import posed_problem

FRAME = 12
LEG = ("femur", "tibia", "foot")


def test_legs_take_each_others_places() -> None:
    """Of somebody who strides; arms that are spread cannot reach each other's place."""
    body = humanoid()
    stride = {"hip_flexion_r": 25, "hip_flexion_l": -20, "knee_angle_l": 30, "arm_add_r": -80, "arm_add_l": -80}
    q = np.array([np.deg2rad(stride.get(name, 0.0)) for name in body.coordinate_names])
    pose = Pose(np.eye(4), q)
    (other,) = exchanged(body, pose)
    before, after = Posed(body, pose).segment_middles, Posed(body, other).segment_middles
    legs = np.array([name.split("_")[0] in LEG for name in body.segment_names])
    missed = np.linalg.norm(after - before[partners(body.segment_names)], axis=1)
    assert missed[legs].max() < 0.2 < 0.3 < np.linalg.norm(after - before, axis=1)[legs].max()
    assert np.array_equal(before[~legs], after[~legs])
    assert np.array_equal(other.within(body.limits).q, other.q)


def test_legs_of_all_poses_of_a_walk_can_be_exchanged() -> None:
    """Also where knees are stretched to their limits."""
    scene, _ = walk()
    legs = np.array([name.split("_")[0] in LEG for name in scene.body.segment_names])
    for pose in scene.true_poses:
        there = Posed(scene.body, pose).segment_middles[partners(scene.body.segment_names)]
        found = np.array([Posed(scene.body, other).segment_middles for other in exchanged(scene.body, pose)])
        assert len(found) and np.linalg.norm(found - there, axis=2)[:, legs].max(axis=1).min() < 0.2


def test_a_body_without_sides_has_nothing_to_exchange() -> None:
    body = humanoid()
    names = {
        f"{kind}_names": tuple(f"{name}x" for name in getattr(body, f"{kind}_names"))
        for kind in ("coordinate", "segment")
    }
    assert exchanged(replace(body, **names), Pose.rest(body)) == []


def test_middles_against_differences() -> None:
    body, rng, segments = humanoid(), np.random.default_rng(2), np.array([2, 5, 9], np.int32)
    pose = Pose(np.eye(4), rng.normal(scale=0.4, size=len(body.coordinate_names)))
    term = MiddlesTerm(segments, Posed(body, pose).segment_middles[segments] + rng.normal(size=(3, 3)), 0.05)
    still, found = np.zeros(body.dof), term.linearize(Posed(body, pose))

    def middles(step: Float) -> Float:
        return Posed(body, pose.retract(step)).segment_middles[segments].ravel() / term.sigma

    check_jacobian(lambda step: np.array(term.energy(Posed(body, pose.retract(step)))), found.gradient, still)
    by_step = numeric_jacobian(middles, still)
    np.testing.assert_allclose(found.hessian, by_step.T @ by_step, atol=1e-5)
    assert found.value == term.energy(Posed(body, pose))


def _off_from(wrong: Pose, monkeypatch: pytest.MonkeyPatch) -> float:
    """m by which landmarks are off at most after a search that tries nothing else than a pose."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), FRAME)
    none = np.zeros((scene.body.dof,) * 2)
    problem = posed_problem(tracker.state, frames[FRAME], tracker.model, Prediction(wrong, "hold", none, none))
    known = tracker.state.searches["lost body"].known
    monkeypatch.setattr(BodySearch, "_worth", lambda self: [self._placing.hypothesis(wrong)])
    monkeypatch.setattr(BodySearch, "_with_limbs_placed", lambda self, h, turn=0: h)
    rule = BodyRule(accepted=0.0, rounds=1, placing=PlacingRule(draws=1))
    found = BodySearch(rule, LimbRule(), known, problem, known.evidence(problem)).found()
    assert found is not None
    return float(np.linalg.norm(Posed(scene.body, found).landmarks - scene.landmarks[FRAME], axis=1).max())


@pytest.mark.parametrize("exchanging", [True, False])
def test_legs_that_have_been_taken_for_each_other_are_set_right(
    exchanging: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, _ = walk()
    wrong = exchanged(scene.body, scene.true_poses[FRAME])[-1]
    if not exchanging:
        monkeypatch.setattr(whole_body, "exchanged", lambda body, pose: [])
    assert (_off_from(wrong, monkeypatch) < 0.05) == exchanging


@pytest.mark.parametrize("turning", [True, False])
def test_a_body_that_faces_the_wrong_way_is_turned_round(turning: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, _ = walk()
    wrong = turned_round(scene.body, scene.true_poses[FRAME])
    if not turning:
        monkeypatch.setattr(whole_body, "turned_round", lambda body, pose: pose)
    assert (_off_from(wrong, monkeypatch) < 0.05) == turning


def test_a_look_again_sets_out_from_the_best_other_pose_of_the_body_there_as_well() -> None:
    """From exchanged legs, not from those that are much the same, nor from another body."""
    scene, frames = walk()
    *_, (_, tracker) = islice(tracked_walk(lambda frame: frame), FRAME)
    truth, none = scene.true_poses[FRAME], np.zeros((scene.body.dof,) * 2)
    problem = posed_problem(tracker.state, frames[FRAME], tracker.model, Prediction(truth, "hold", none, none))
    known = tracker.state.searches["lost body"].known
    search = BodySearch(BodyRule(), LimbRule(), known, problem, known.evidence(problem))
    alike = truth.retract(np.r_[0.0, 0.0, 0.0, 0.02, np.zeros(scene.body.dof - 4)])
    away = Pose(se3.transform(np.eye(3), np.array([2.0, 0.0, 0.0])) @ truth.root, truth.q)
    nats = {"best": 9.0, "alike": 8.0, "away": 7.0, "legs": 5.0, "worse legs": 4.0}
    poses = (truth, alike, away, exchanged(scene.body, truth)[-1], exchanged(scene.body, alike)[-1])
    best, *others = (Hypothesis(pose, n) for pose, n in zip(poses, nats.values(), strict=True))
    assert search._beside(best, [best, *others]) == [others[2]]
    assert search._beside(best, [best, *others[:2]]) == []
