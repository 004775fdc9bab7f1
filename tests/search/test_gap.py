"""Finding the body again after frames without images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from support.oracle import BODY, Oracle
from twistcap.body import Pose, Posed
from twistcap.body.limbs import branches
from twistcap.build import build
from twistcap.errors import InputError
from twistcap.search.gap import AfterGap
from twistcap.search.judge import JudgeRule
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import Model, track

GAP = range(6, 21)


def _raised(pose: Pose) -> Pose:
    """The pose with its right arm elsewhere."""
    q = pose.q.copy()
    q[BODY.coordinate("arm_flex_r")] += 0.9
    q[BODY.coordinate("elbow_flex_r")] += 0.6
    return Pose(pose.root, q)


def test_a_rule_that_draws_nothing_is_told() -> None:
    for draws, passes in ((0, ((1.0,),)), (9, ()), (9, ((),))):
        with pytest.raises(InputError, match=r"draws is|passes must name"):
            AfterGap(draws=draws, passes=passes)


def _arm_off(scene: Capture, model: Model) -> float:
    """m by which the right hand is off, two frames after a gap in which the arm was raised."""
    blind = [replace(f, images=tuple(None for _ in f.images)) if f.index in GAP else f for f in scene.frames()]
    last = list(track(blind, model, scene.first_pose))[-1]
    off = Posed(BODY, last.pose).segment_middles - Posed(BODY, scene.true_poses[last.index]).segment_middles
    return float(np.linalg.norm(off[BODY.chain[:, BODY.coordinate("elbow_flex_r")]][-1]))


def test_an_arm_that_moved_unseen_is_found_again() -> None:
    still = capture(StudioConfig(seed=0, views=3, frames=1), BODY).first_pose
    poses = [_raised(still) if k > GAP[0] else still for k in range(GAP[-1] + 3)]
    scene = capture(StudioConfig(seed=0, views=3, frames=len(poses)), BODY, poses)
    model = build(scene.body, scene.rig)
    fitted, found = _arm_off(scene, replace(model, searches=())), _arm_off(scene, model)
    assert fitted > 0.08
    assert found < 0.03


def test_branches_part_the_coordinates_from_the_trunk_outward() -> None:
    found = branches(BODY)
    np.testing.assert_array_equal(np.sum(found, axis=0), np.ones(BODY.dof))
    np.testing.assert_array_equal(np.flatnonzero(found[0]), np.arange(6))
    arm = next(branch for branch in found if branch[6 + BODY.coordinate("elbow_flex_r")])
    assert arm[6 + BODY.coordinate("arm_flex_r")]
    assert not arm[6 + BODY.coordinate("elbow_flex_l")]
    order = [next(i for i, b in enumerate(found) if b[6 + BODY.coordinate(n)]) for n in ("lumbar_bending", "arm_rot_l")]
    assert order[0] < order[1]


def test_the_search_comes_near_what_the_judge_favours_and_keeps_limits() -> None:
    start = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    truth = _raised(start)
    covariance = np.diag(np.concatenate([np.full(6, 1e-6), np.full(BODY.dof - 6, 4.0)]))  # wider than anything
    judge = Oracle(JudgeRule(), BODY, (), start, truth)
    found = AfterGap(draws=60).found(judge, start, covariance)
    assert judge.evidence(found) > 0.9 * judge.evidence(truth)
    assert np.all((found.q >= BODY.limits[:, 0]) & (found.q <= BODY.limits[:, 1]))
    taken = AfterGap(draws=1, passes=((0.0,),)).found(judge, start, covariance, [truth])
    np.testing.assert_allclose(taken.q, truth.q, atol=1e-9)


def test_little_gain_moves_nothing() -> None:
    start = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    judge = Oracle(JudgeRule(), BODY, (), start, _raised(start))
    rule = AfterGap(gain=2.0 * judge.evidence(judge.truth))
    assert rule.found(judge, start, np.eye(BODY.dof), [judge.truth]) is start
