"""Limbs that slip off the images are sought in the same frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from support.oracle import BODY, Oracle
from twistcap._typing import Bool, Float, Int
from twistcap.body import Pose, Posed
from twistcap.cues.limbs import LimbRule, LimbSearch
from twistcap.cues.reacquire import limbs
from twistcap.cues.rivals import RivalRule
from twistcap.errors import InputError
from twistcap.predict import Moment, rested
from twistcap.track.settings import TrackerConfig
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


def _tallies(share: float, arm: float, points: int = 20) -> list[tuple[Float, Int]]:
    """One view in which these shares of the points of the right arm and of all else agree."""
    seen = np.full(PARTS, points)
    moved = BODY.chain[:, BODY.coordinate("arm_flex_r")]
    return [(np.where(moved, arm, share) * seen, seen)]


def test_a_limb_slips_when_it_agrees_much_less_than_usual() -> None:
    search = LimbSearch(BODY, LimbRule())
    for _ in range(30):  # one that never agreed better than by six tenths has not slipped
        assert search.slipped(_tallies(0.9, 0.6)) == []
    for _ in range(10):  # what is not found is sought again
        (i,) = search.slipped(_tallies(0.9, 0.3))
        assert _arm(limbs(BODY)[i])
    for _ in range(100):
        search.slipped(_tallies(0.9, 0.3))
    assert search.slipped(_tallies(0.9, 0.3)) == []
    assert len(search.slipped(_tallies(0.0, 0.3))) == 4
    assert search.slipped(_tallies(0.0, 0.0, points=1)) == []


def _slipped(rule: LimbRule) -> LimbSearch:
    """A search whose right arm has just slipped."""
    search = LimbSearch(BODY, rule)
    search.slipped(_tallies(0.9, 0.9))
    search.slipped(_tallies(0.9, 0.9))
    search.slipped(_tallies(0.9, 0.1))
    return search


def test_a_forearm_that_folded_over_is_found_with_any_draws() -> None:
    truth = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    q = truth.q.copy()
    q[BODY.coordinate("elbow_flex_r")] = np.deg2rad(145.0)
    folded = Pose(truth.root, q)
    for seed in range(8):
        judge = Oracle(RivalRule(), BODY, (), folded, truth)
        found, (arm,) = _slipped(LimbRule(seed=seed)).sought(judge, folded, [folded])
        assert judge.evidence(found) > 0.9 * judge.evidence(truth)
        others = ~limbs(BODY)[arm][6:]
        np.testing.assert_array_equal(found.q[others], folded.q[others])
        assert np.all((found.q >= BODY.limits[:, 0]) & (found.q <= BODY.limits[:, 1]))


def test_little_gain_finds_nothing() -> None:
    truth = Pose(np.eye(4), np.clip(np.zeros(BODY.dof - 6), *BODY.limits.T))
    judge = Oracle(RivalRule(), BODY, (), truth, truth)
    assert _slipped(LimbRule(draws=8)).sought(judge, truth, [truth]) == (truth, [])


def test_a_limb_that_was_lost_before_comes_back_without_a_velocity() -> None:
    search = _slipped(LimbRule())
    (arm,) = search.slipped(_tallies(0.9, 0.1))
    np.testing.assert_array_equal(search.regained([arm]), limbs(BODY)[arm][6:])
    assert not _slipped(LimbRule()).regained([arm]).any()  # one that has just slipped has moved
    pose = Pose.rest(BODY)
    turned = Pose(pose.root, pose.q + 1.0)
    q = rested(Moment(0.0, pose), turned, search.regained([arm])).pose.q
    np.testing.assert_array_equal(q, np.where(limbs(BODY)[arm][6:], 1.0, 0.0))


def test_joints_without_limits_are_drawn_within_half_a_turn() -> None:
    free = replace(BODY, limits=np.full_like(BODY.limits, np.inf) * [-1.0, 1.0])
    start = Pose(np.eye(4), np.full(BODY.dof - 6, 10.0))
    judge = Oracle(RivalRule(), free, (), start, Pose(start.root, start.q + 0.8))
    search = LimbSearch(free, LimbRule(near=(0.1,)))
    for share in (0.9, 0.9, 0.1):
        search.slipped(_tallies(0.9, share))
    pose, found = search.sought(judge, start, [start])
    assert len(found) == 1
    assert np.all(np.abs(pose.q - start.q) < np.pi + 1.0)


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        (lambda: LimbRule(draws=0), "draws and least_points must be 1 or more"),
        (lambda: LimbRule(near=()), "near name a deviation"),
        (lambda: LimbRule(memory=1.5), "memory, recent and better must be from 0 to 1"),
        (lambda: LimbRule(gain=float("nan")), "near, gain and margin must be 0 or more, and finite"),
    ],
)
def test_rules_that_cannot_be_are_told(wrong: Callable[[], LimbRule], told: str) -> None:
    with pytest.raises(InputError, match=told):
        wrong()


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
