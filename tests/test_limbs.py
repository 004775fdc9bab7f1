"""Limbs that slip off the images are sought in the same frame."""

from __future__ import annotations

import numpy as np
import pytest

from test_reacquire import BODY, Oracle
from twistcap._typing import Bool
from twistcap.body import Pose, Posed
from twistcap.cues.limbs import LimbRule, LimbSearch
from twistcap.cues.reacquire import limbs
from twistcap.cues.rivals import RivalRule
from twistcap.errors import InputError
from twistcap.settings import TrackerConfig
from twistcap.studio import Capture, StudioConfig, capture
from twistcap.track import track

PARTS = len(BODY.segment_names)
ARM = ("arm_flex_r", "elbow_flex_r")


def _arm(limb: Bool) -> bool:
    return bool(limb[6 + BODY.coordinate(ARM[0])])


def test_limbs_are_branches_that_end_in_one_place() -> None:
    found = limbs(BODY)
    assert len(found) == 5  # head, arms and legs; the trunk carries more than one end
    assert not any(limb[:6].any() or limb[6 + BODY.coordinate("lumbar_bending")] for limb in found)
    assert [limb[6 + BODY.coordinate("elbow_flex_r")] for limb in found if _arm(limb)] == [True]


def test_a_limb_slips_when_it_agrees_much_less_than_usual() -> None:
    search, support, seen = LimbSearch(BODY, LimbRule()), np.full(PARTS, 0.9), np.full(PARTS, 20)
    good = 0.9 * seen
    arm = BODY.chain[:, BODY.coordinate("arm_flex_r")]
    assert search.slipped([(good, seen)], support) == []
    slipped = np.where(arm, 0.5, 0.9) * seen
    (i,) = search.slipped([(slipped, seen)], support)
    assert _arm(limbs(BODY)[i])
    support[arm] = 0.5  # the running share has come down meanwhile: the usual one has not
    assert search.slipped([(slipped, seen)], support) == [i]
    for _ in range(100):
        search.slipped([(slipped, seen)], support)
    assert search.slipped([(slipped, seen)], support) == []
    few = np.where(arm, 1, 20)
    assert search.slipped([(0.0 * few, few)], support) == [k for k in range(5) if k != i]


def test_a_forearm_that_folded_over_is_found_with_any_draws() -> None:
    truth = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    q = truth.q.copy()
    q[BODY.coordinate("elbow_flex_r")] = np.deg2rad(145.0)
    folded = Pose(truth.root, q)
    arm = next(i for i, limb in enumerate(limbs(BODY)) if _arm(limb))
    for seed in range(8):
        judge = Oracle(RivalRule(), BODY, (), folded, truth)
        found = LimbSearch(BODY, LimbRule(seed=seed)).sought(judge, folded, [folded], [arm])
        assert found is not None
        assert judge.evidence(found) > 0.9 * judge.evidence(truth)
        others = ~limbs(BODY)[arm][6:]
        np.testing.assert_array_equal(found.q[others], folded.q[others])
        assert np.all((found.q >= BODY.limits[:, 0]) & (found.q <= BODY.limits[:, 1]))


def test_little_gain_finds_nothing() -> None:
    truth = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    judge = Oracle(RivalRule(), BODY, (), truth, truth)
    assert LimbSearch(BODY, LimbRule(draws=8)).sought(judge, truth, [truth], [0, 1]) is None


def test_a_rule_that_draws_nothing_is_told() -> None:
    with pytest.raises(InputError, match="limbs: draws must be 1 or more"):
        LimbRule(draws=0)
    with pytest.raises(InputError, match="memory from 0 to 1"):
        LimbRule(memory=1.5)


def _swung() -> Capture:
    """A body at rest whose right arm is thrown forward, 35° from frame to frame, elbow bent on the way."""
    still = capture(StudioConfig(seed=0, views=3, frames=1), BODY).first_pose
    poses = []
    for k in range(12):
        q = still.q.copy()
        turned = np.clip(k - 5, 0, 4)
        q[BODY.coordinate("arm_flex_r")] += np.deg2rad(35.0) * turned
        q[BODY.coordinate("elbow_flex_r")] += np.deg2rad(15.0) * turned
        poses.append(Pose(still.root, q))
    return capture(StudioConfig(seed=0, views=3, frames=len(poses)), BODY, poses)


def test_an_arm_thrown_faster_than_a_contour_reaches_is_kept() -> None:
    scene = _swung()

    def off(rule: LimbRule | None) -> float:
        """m by which the right hand is off at the end."""
        last = list(track(scene.frames(), scene.body, scene.rig, scene.first_pose, TrackerConfig(limbs=rule)))[-1]
        middles = [Posed(BODY, pose).segment_middles for pose in (last.pose, scene.true_poses[last.index])]
        return float(np.linalg.norm(np.subtract(*middles)[BODY.chain[:, BODY.coordinate(ARM[1])]][-1]))

    assert off(None) > 0.15
    assert [off(LimbRule(seed=seed)) < 0.03 for seed in range(3)] == [True] * 3
